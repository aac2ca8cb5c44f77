"""What all browsers share: the dataset, the methods' results held against it, and the work still going on."""

import logging
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from inspector.image_cache import ImageCache
from inspector.recordings import Recordings
from inspector.selection import RowKey, Selection
from pipeline.bop.assessment import Assessment, assess, with_adi, with_known, with_visibility, with_vsd
from pipeline.bop.dataset import Dataset
from pipeline.bop.results import Results, read_results
from pipeline.exceptions import InputError
from pipeline.run import Run
from pipeline.scene import PoseEstimate

if TYPE_CHECKING:
    from pipeline.bop.doctor import Finding

log = logging.getLogger(__name__)

TAU = 0.020
"""Metres; misalignment tolerance of the VSD in the table (BOP 2017)."""

RUN_POLL_SECONDS = 1.0
"""How often a run folder is looked at for new images."""


@dataclass(frozen=True)
class Method:
    """A results file to be inspected."""

    name: str
    results: Results
    path: Path


class Workspace:
    """The data behind all browsers; assessments appear as they are finished, and listeners are told.

    Everything here may be used from any thread.
    """

    def __init__(
        self, dataset: Dataset, methods: tuple[Method, ...] = (), run: Run | None = None, notes: tuple[str, ...] = ()
    ) -> None:
        """Hold a dataset and methods; of a run, the first method is its own results file. `notes` start `problems`."""
        self.dataset = dataset
        self.methods = methods
        self.run = run
        self.recordings = None if run is None else Recordings(run)
        self.images = ImageCache(dataset)
        self.jobs: dict[str, float] = {}
        """Work in progress: what it is and the finished share, 0..1."""
        self.problems = notes
        """What of the data could not be used, one line each."""
        self.findings: tuple[Finding, ...] | InputError | None = None
        """What the doctor said; None as long as it was not asked."""
        self.version = 0
        """Grows with every new assessment."""
        self._assessments: list[Assessment | None] = [None] * max(1, len(methods))
        self._generations = [0] * len(self._assessments)
        self._listeners: set[Callable[[], None]] = set()
        self._lock = threading.RLock()
        self._stopped = threading.Event()

    @property
    def method_names(self) -> tuple[str, ...]:
        """Names of the methods, made different where two files claim the same."""
        names = [method.name for method in self.methods]
        return tuple(
            f"{n} ({m.path.stem})" if names.count(n) > 1 else n for n, m in zip(names, self.methods, strict=True)
        )

    @property
    def delta(self) -> float:
        """Metres; visibility tolerance of VSD for this dataset."""
        return self.dataset.facts.vsd_delta

    def start(self) -> None:
        """Assess all methods in the background, and follow the run, if there is one, as it grows."""
        threading.Thread(target=self._work, name="assessment", daemon=True).start()

    def stop(self) -> None:
        """Stop following the run and serving its recordings."""
        self._stopped.set()
        if self.recordings is not None:
            self.recordings.stop()

    def assessment(self, method: int) -> Assessment | None:
        """Return the rows of a method; None as long as they are not ready."""
        return self._assessments[method] if method < len(self._assessments) else None

    def generation(self, method: int | None) -> int:
        """How often the estimates of a method were held against the ground truth anew; 0 as long as they were not."""
        return 0 if method is None else self._generations[method]

    def within(self, selection: Selection) -> Selection:
        """Return the selection with what this workspace does not have (methods, objects, scenes) as at the start."""
        count, wanted = max(len(self.methods), 1), selection.filter
        compare = selection.compare if selection.compare is not None and 0 <= selection.compare < count else None
        obj_id = wanted.obj_id if wanted.obj_id in self.dataset.obj_ids else None
        scene_id = wanted.scene_id if wanted.scene_id in self.dataset.scene_ids else None
        method = selection.method if 0 <= selection.method < count else 0
        here = replace(wanted, obj_id=obj_id, scene_id=scene_id)
        return replace(selection, method=method, compare=compare, filter=here)

    def add_method(self, method: Method) -> int:
        """Inspect one more results file, assessed in the background; returns its index, the old one if it is open."""
        with self._lock:
            paths = [known.path for known in self.methods]
            if method.path in paths:
                return paths.index(method.path)
            index = len(self.methods)
            self.methods = (*self.methods, method)
            if index == len(self._assessments):  # else the ground truth alone stands in the place of the first method
                self._assessments.append(None)
                self._generations.append(0)
        threading.Thread(target=self._assess_methods, args=([index],), name="assessment", daemon=True).start()
        self.changed()
        return index

    def estimate_of(self, method: int, row: RowKey) -> PoseEstimate | None:
        """Return the estimate of a method that is held against a row of the table."""
        if method >= len(self.methods):
            return None
        results = self.methods[method].results
        if row.gt_index < 0:
            return results.estimate(row.estimate) if 0 <= row.estimate < len(results) else None
        assessment = self.assessment(method)
        if assessment is None:
            return None
        place = find_row(assessment, row)
        return (
            None
            if place is None or assessment.estimate[place] < 0
            else results.estimate(int(assessment.estimate[place]))
        )

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Have `listener` called on every change, from any thread; returns what ends that."""
        with self._lock:
            self._listeners.add(listener)
        return lambda: self._listeners.discard(listener)

    def changed(self) -> None:
        """Tell all listeners; one that fails is reported and does not hinder the others."""
        with self._lock:
            listeners = tuple(self._listeners)
        for listener in listeners:
            try:
                listener()
            except Exception:
                log.exception("a browser could not be told of new data")

    @contextmanager
    def job(self, text: str) -> Iterator[Callable[[float], None]]:
        """Show a piece of work with its progress in all browsers while the block runs."""

        def progress(share: float) -> None:
            announce = int(share * 50) != int(self.jobs.get(text, 0.0) * 50)
            self.jobs[text] = share
            if announce:
                self.changed()

        self.jobs[text] = 0.0
        try:
            yield progress
        finally:
            self.jobs.pop(text, None)
            self.changed()

    def diagnose(self) -> None:
        """Ask the doctor about the dataset, in the background."""
        threading.Thread(target=self._diagnose, name="doctor", daemon=True).start()

    def _diagnose(self) -> None:
        from pipeline.bop.doctor import diagnose

        with self.job("doctor") as progress:
            try:
                paths = [method.path for method in self.methods]
                said = diagnose(
                    self.dataset.root,
                    self.dataset.split,
                    lambda done, all_, _: progress(done / all_),
                    results=paths,
                )
                self.findings = tuple(said)
            except InputError as error:
                self.findings = error

    def _work(self) -> None:
        """Assess everything, then the run again whenever it has finished more images."""
        watch = self.run.watch() if self.run is not None else None
        if watch is not None:
            self._guarded(watch.poll)
            self._guarded(self._reread_run)  # it may have grown since it was opened
        self._assess_methods(range(len(self._assessments)))
        while watch is not None and not self._stopped.wait(RUN_POLL_SECONDS):
            if self._guarded(watch.poll) and self._guarded(self._reread_run):
                self._assess_methods([0])

    def _assess_methods(self, indices: Iterable[int]) -> None:
        for stage in (self._assess, self._complete):
            for index in indices:
                self._guarded(partial(stage, index))

    def _guarded(self, work: Callable[[], Any]) -> Any:
        """Do a piece of work; if it fails, browsers are told why, the result is None, and the rest goes on."""
        try:
            return work()
        except InputError as error:
            self._report((str(error),))
        except Exception as error:
            log.exception("background work failed")
            self._report((f"background work failed: {error}",))
        self.changed()
        return None

    def _reread_run(self) -> bool:
        own = self.methods[0]
        self.methods = (Method(own.name, read_results(own.path), own.path), *self.methods[1:])
        return True

    def _assess(self, index: int) -> None:
        method = self.methods[index] if self.methods else None
        with self.job(f"comparing {method.name if method else 'ground truth'}") as progress:
            earlier, results = self._assessments[index], method.results if method else None
            if earlier is None:
                assessment = assess(self.dataset, results, progress, partial(self._publish, index))
            else:
                assessment = with_known(assess(self.dataset, results, progress), earlier)
            self._report(assessment.problems)
            self._generations[index] += 1
            self._publish(index, assessment)

    def _complete(self, index: int) -> None:
        """Add what takes longer: visible fractions where the dataset has none, VSD, and ADI, the slowest, last."""
        assessment = self._assessments[index]
        if assessment is None:
            return
        with self.job("visible fractions") as progress:
            assessment = with_visibility(self.dataset, assessment, progress)
            self._publish(index, assessment)
        if not self.methods:
            return
        results = self.methods[index].results
        with self.job("VSD") as progress:
            assessment = with_vsd(self.dataset, results, assessment, TAU, self.delta, progress)
            self._publish(index, assessment)
        with self.job("ADI") as progress:
            assessment = with_adi(self.dataset, results, assessment, progress)
            self._report(assessment.problems)
            self._publish(index, assessment)

    def _publish(self, index: int, assessment: Assessment) -> None:
        with self._lock:
            self._assessments[index] = assessment
            self.version += 1
        self.changed()

    def _report(self, problems: tuple[str, ...]) -> None:
        self.problems = tuple(dict.fromkeys((*self.problems, *problems)))


def find_row(assessment: Assessment, row: RowKey) -> int | None:
    """Return the position of a row in an assessment, None if it is not in it."""
    found = (
        (assessment.scene_id == row.scene_id)
        & (assessment.im_id == row.im_id)
        & (assessment.obj_id == row.obj_id)
        & (assessment.gt_index == row.gt_index)
    )
    if row.gt_index < 0:
        found &= assessment.estimate == row.estimate
    places = found.nonzero()[0]
    return int(places[0]) if len(places) else None
