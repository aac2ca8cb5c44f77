"""Evaluations of submissions in the background, one after the other, that outlive the process.

queue = EvaluationQueue(leaderboard)
queue.listen(redraw)
queue.start()                           # goes on with what an earlier process has left
job = queue.submit(submission, dataset)
queue.jobs()                            # states and progress, whenever wanted
"""

import atexit
import logging
import threading
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable

from inspector.announcer import Announcer
from inspector.evaluation_jobs import EndedError, Job, JobList, job_of
from pipeline.bop import dataset as bop_dataset
from pipeline.bop.dataset import Dataset
from pipeline.bop.evaluation import evaluate as bop_evaluate
from pipeline.bop.evaluation.evaluate import Evaluation
from pipeline.bop.evaluation.fingerprint import fingerprint
from pipeline.bop.leaderboard.jobs import JobStore
from pipeline.bop.leaderboard.records import Submission
from pipeline.bop.leaderboard.store import Leaderboard
from pipeline.bop.results import Results
from pipeline.exceptions import InputError

log = logging.getLogger(__name__)


@runtime_checkable  # for the checks of types in tests
class Evaluate(Protocol):
    """What evaluates: `pipeline.bop.evaluate.evaluate`, or a `functools.partial` of it with an `execution`."""

    def __call__(
        self, dataset: Dataset, results: Results, progress: Callable[[float], None], *, with_vsd: bool
    ) -> Evaluation:
        """Evaluate; what `progress` raises must come through."""
        ...


@runtime_checkable
class OpenDataset(Protocol):
    """What opens datasets: `pipeline.bop.dataset.open_dataset`."""

    def __call__(self, root: Path, split: str | None = None, sensor: str | None = None) -> Dataset:
        """Open a dataset."""
        ...


class EvaluationQueue:
    """One thread that evaluates submissions and keeps what comes out on the leaderboard.

    All methods may be called from any thread and return at once; those that take on or drop a job write it down first.
    """

    def __init__(
        self,
        leaderboard: Leaderboard,
        *,
        open_dataset: OpenDataset = bop_dataset.open_dataset,
        evaluate: Evaluate = bop_evaluate.evaluate,
    ) -> None:
        """Make a queue that does nothing before `start`.

        Datasets are opened anew here, as one that is open elsewhere may remember files that have changed since.
        """
        self._leaderboard = leaderboard
        self._open_dataset, self._evaluate = open_dataset, evaluate
        self._store = JobStore(leaderboard.folder)
        self._announcer = Announcer("evaluation news")
        self._jobs = JobList(self._announcer.changed)
        self._taking_on = threading.Lock()
        self._thread: threading.Thread | None = None
        self._held: _Held | None = None

    def start(self) -> None:
        """Take over the jobs that ended processes have left, and begin to work."""
        try:
            left = self._store.adopt()
        except InputError as error:  # of a folder that cannot be written: what is there can be looked at all the same
            log.warning("unfinished evaluations are left alone: %s", error)
            left = ()
        self._jobs.add(map(job_of, left))
        self._thread = threading.Thread(target=self._run, name="evaluations", daemon=True)
        self._thread.start()
        atexit.register(self.stop)  # a thread within native code must not meet the end of the interpreter

    def stop(self, wait_seconds: float = 1.0) -> None:
        """End the work, waiting no longer than that; what is not done is done after the next start."""
        atexit.unregister(self.stop)
        self._jobs.stop()
        self._announcer.stop()
        if self._thread is None:
            self._store.release()
        else:
            self._thread.join(wait_seconds)

    def submit(self, submission: Submission, dataset: Dataset, *, with_vsd: bool = True, again: bool = False) -> Job:
        """Have a submission evaluated; returns the job, the old one if the same is waiting or running already.

        What has been evaluated on the very same data is done at once, unless it is asked for `again`.

        Raises:
            InputError: The submission is for another dataset, the queue has been stopped, or nothing can be written.
            UnknownIdError: The submission has been removed.

        """
        of, given = (submission.dataset_name, submission.split), (dataset.name.lower(), dataset.split)
        if of != given:
            raise InputError(
                f"submission {submission.id} is for {'/'.join(of)}, not for {'/'.join(given)}; open that dataset"
            )
        return self._take_on(submission.id, dataset.root.absolute(), dataset.split, dataset._sensor, with_vsd, again)

    def retry(self, job_id: int) -> Job | None:
        """Have the same done once more in place of a failed or cancelled job; None if there is none of that id."""
        old = self.job(job_id)
        if old is None or old.is_open:
            return old
        new = self._take_on(old.submission_id, old.root, old.split, old.sensor, old.with_vsd, old.again)
        self.dismiss(job_id)
        return new

    def cancel(self, job_id: int) -> None:
        """Give up a job that waits or runs: it counts as cancelled at once, and its result is not kept."""
        if self._jobs.end(job_id, "cancelled"):
            self._written(self._store.remove, job_id)

    def dismiss(self, job_id: int) -> None:
        """Drop a job from the list, when it has come to its end."""
        if self._jobs.drop(job_id):
            self._written(self._store.remove, job_id)

    def jobs(self) -> tuple[Job, ...]:
        """All jobs of this process since its start and those taken over, oldest first."""
        return self._jobs.all()

    def job(self, job_id: int) -> Job | None:
        """One job as it stands; None if there is none (any more)."""
        return self._jobs.get(job_id)

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Have `listener` called after changes, four times a second at most, in a thread of the queue's own.

        Returns what ends that.
        """
        return self._announcer.listen(listener)

    def wait_idle(self, timeout: float) -> bool:
        """Wait until no job waits or runs; False if that takes longer than `timeout` seconds."""
        return self._jobs.wait_idle(timeout)

    def _take_on(
        self, submission_id: int, root: Path, split: str, sensor: str | None, with_vsd: bool, again: bool
    ) -> Job:
        wanted = (submission_id, root, split, sensor, with_vsd)
        with self._taking_on:
            for job in self.jobs():
                if job.is_open and (job.submission_id, job.root, job.split, job.sensor, job.with_vsd) == wanted:
                    return job
            if self._jobs.is_stopped:
                raise InputError("no evaluation is taken on any more, the program is ending; start it again")
            job = job_of(self._store.add(submission_id, root, split, sensor, with_vsd=with_vsd, again=again))
            self._jobs.add([job])
            return job

    def _run(self) -> None:
        while (job := self._jobs.take()) is not None:
            self._written(self._store.begin, job.id)
            try:
                self._work(job)
            except EndedError:
                if self._jobs.is_stopped:
                    self._written(self._store.put_back, job.id)
            except Exception as error:  # the next job shall be done whatever happens to this one
                self._failed(job, error)
            else:
                self._written(self._store.remove, job.id)
                self._jobs.end(job.id, "done")
            if self._jobs.is_idle:
                self._held = None  # a dataset needs memory
        self._store.release()

    def _work(self, job: Job) -> None:
        held = self._dataset(job)
        kept = self._leaderboard.evaluations(job.submission_id)
        if not job.again and any((e.fingerprint, e.with_vsd) == (held.fingerprint, job.with_vsd) for e in kept):
            return
        results = self._leaderboard.results(job.submission_id)
        progress = partial(self._jobs.progress, job.id)
        progress(0.0)
        evaluation = self._evaluate(held.dataset, results, progress, with_vsd=job.with_vsd)
        progress(1.0)
        if fingerprint(held.dataset) != held.fingerprint:
            raise InputError(f"{job.root}: was changed while it was evaluated; evaluate it again")
        self._leaderboard.keep(job.submission_id, evaluation, held.fingerprint, with_vsd=job.with_vsd)

    def _dataset(self, job: Job) -> "_Held":
        """The job's dataset as it lies on the disk now: one that was read from the very same files may be used again."""
        held, key = self._held, (job.root, job.split, job.sensor)
        if held is None or held.key != key or fingerprint(held.dataset) != held.fingerprint:
            self._held = None
            dataset = self._open_dataset(*key)
            self._held = held = _Held(key, dataset, fingerprint(dataset))  # before anything of it is read
        return held

    def _failed(self, job: Job, error: Exception) -> None:
        if isinstance(error, InputError):
            reason = str(error)
        else:
            log.error("submission %d could not be evaluated", job.submission_id, exc_info=error)
            reason = f"evaluation failed: {type(error).__name__}: {error}".splitlines()[0]
        if self._is_removed(job.submission_id):
            self._jobs.end(job.id, "cancelled", "the submission was removed")
        else:
            self._written(self._store.fail, job.id, reason)  # of one that was cancelled meanwhile there is nothing left
            self._jobs.end(job.id, "failed", reason)

    def _is_removed(self, submission_id: int) -> bool:
        try:
            return all(submission.id != submission_id for submission in self._leaderboard.submissions())
        except InputError:
            return False

    def _written(self, write: Callable[..., None], *values: object) -> None:
        """Write something down; if that fails, it is done again after the next start at worst."""
        try:
            write(*values)
        except Exception as error:
            log.warning("the state of an evaluation could not be written down: %s", error)


class _Held(NamedTuple):
    """A dataset with the fingerprint of the files that it was, or will be, read from."""

    key: tuple[Path, str, str | None]
    dataset: Dataset
    fingerprint: str
