"""What all browsers share of the leaderboard: the store, the evaluations at work, and which methods are open."""

import logging
import threading
from collections.abc import Callable
from pathlib import Path

from inspector.evaluations import EvaluationQueue, Job
from inspector.workspace import Method, Workspace
from pipeline.bop.evaluation.evaluate import Evaluation
from pipeline.bop.evaluation.fingerprint import fingerprint
from pipeline.bop.leaderboard.records import Submission
from pipeline.bop.leaderboard.store import Leaderboard, default_folder
from pipeline.exceptions import InputError

log = logging.getLogger(__name__)


class LeaderboardService:
    """The leaderboard of a server; any thread may use it."""

    def __init__(self, folder: Path | None = None) -> None:
        """Use the leaderboard of a folder, by default the user's own; it is opened when somebody looks."""
        self._lock = threading.RLock()
        self._folder = folder or default_folder()
        self._store: Leaderboard | None = None
        self._queue: EvaluationQueue | None = None
        self.version = 0
        """Grows with everything new."""
        self.numbers = 0
        """Grows when a number may have changed."""
        self._methods: dict[tuple[Workspace, int], int] = {}
        self._offered: set[Workspace] = set()
        self._finished: frozenset[int] = frozenset()
        self._listeners: set[Callable[[], None]] = set()
        self._started = False

    @property
    def store(self) -> Leaderboard:
        """The leaderboard. Raises InputError if it is damaged or cannot be opened; all else works without it."""
        with self._lock:
            if self._store is None:
                self._store = Leaderboard(self._folder)
            return self._store

    @property
    def queue(self) -> EvaluationQueue:
        """The evaluations at work. Raises InputError as `store` does."""
        with self._lock:
            if self._queue is None:
                self._queue = EvaluationQueue(self.store)
            return self._queue

    def stop(self) -> None:
        """End the work; unfinished evaluations are taken up at the next start."""
        if self._queue is not None:
            self._queue.stop()

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Have `listener` called when something is new, from any thread; returns what ends that."""
        with self._lock:
            self._listeners.add(listener)
        return lambda: self._listeners.discard(listener)

    def changed(self) -> None:
        """Tell all listeners that the store has changed."""
        self.numbers += 1
        self._tell()

    def opened(self, workspace: Workspace) -> None:
        """Begin to work when somebody looks: take up what was left, and evaluate the methods that are served.

        Raises InputError if the leaderboard cannot be opened.
        """
        with self._lock:
            queue = self.queue
            if not self._started:
                self._started = True
                queue.listen(self._news)
                queue.start()
            if workspace in self._offered:
                return
            self._offered.add(workspace)
        threading.Thread(target=self._offer, args=(workspace,), name="leaderboard", daemon=True).start()

    def evaluate(self, submission: Submission, workspace: Workspace) -> None:
        """Evaluate a submission in the background. Raises InputError if it is for another dataset."""
        self.queue.submit(submission, workspace.dataset)

    def job(self, submission_id: int) -> Job | None:
        """The last job of a submission that waits, runs or has failed."""
        jobs = [job for job in self.queue.jobs() if job.submission_id == submission_id]
        return jobs[-1] if jobs and (jobs[-1].is_open or jobs[-1].state == "failed") else None

    def evaluation(self, submission_id: int, workspace: Workspace) -> Evaluation | None:
        """The evaluation of a submission on a workspace's data."""
        return self.store.evaluation(submission_id, fingerprint(workspace.dataset))

    def method_of(self, submission_id: int, workspace: Workspace) -> int:
        """Index of a submission among a workspace's methods; it is opened there if it is not yet.

        Raises InputError if its file cannot be read.
        """
        index = self._methods.get((workspace, submission_id))
        if index is None:
            submission = self.store.submission(submission_id)
            method = Method(submission.method, self.store.results(submission_id), submission.path)
            index = self._methods[workspace, submission_id] = workspace.add_method(method)
        return index

    def submission_of(self, method: int | None, workspace: Workspace) -> int | None:
        """Return the submission that a workspace's method is; None if it is not on the leaderboard."""
        found = (s for (where, s), index in list(self._methods.items()) if where is workspace and index == method)
        return next(found, None)

    def _offer(self, workspace: Workspace) -> None:
        """Take in the results files that are served; a run only when it is complete."""
        for index, method in enumerate(workspace.methods):
            if index == 0 and workspace.run is not None and not _is_complete(workspace):
                continue
            try:
                submission = self._known(method, workspace) or self._add(method, workspace)
                self._methods[workspace, submission.id] = index
                self.queue.submit(submission, workspace.dataset)
            except InputError as error:
                log.warning("%s is not on the leaderboard: %s", method.name, error)
            self.changed()

    def _add(self, method: Method, workspace: Workspace) -> Submission:
        dataset = workspace.dataset
        return self.store.add(
            method.path, method=method.name, dataset_name=dataset.name, split=dataset.split
        ).submission

    def _known(self, method: Method, workspace: Workspace) -> Submission | None:
        """The submission that a method was opened from."""
        return next((s for s in self.store.submissions(workspace.dataset.name) if s.path == method.path), None)

    def _news(self) -> None:
        finished = frozenset(job.id for job in self.queue.jobs() if not job.is_open)
        if finished != self._finished:
            self._finished = finished
            self.numbers += 1
        self._tell()

    def _tell(self) -> None:
        self.version += 1
        for listener in tuple(self._listeners):
            try:
                listener()
            except Exception:
                log.exception("a browser could not be told of the leaderboard")


def _is_complete(workspace: Workspace) -> bool:
    assert workspace.run is not None
    asked = {target.image for target in workspace.dataset.targets()}
    return asked <= set(workspace.run.finished_images())
