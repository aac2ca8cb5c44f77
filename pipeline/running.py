"""Running an estimator over the images of a dataset into a run folder; what is finished is not done again.

Images may be done by other processes, on this machine or others. These write the recordings; the estimates come back
and are written by the one process that has the run folder open.
"""

import logging
import re
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from pipeline.bop.dataset import Dataset
from pipeline.estimator import Estimator
from pipeline.exceptions import InputError
from pipeline.explaining import Explain, explain_targets, explained
from pipeline.lazy_estimator import LazyEstimator
from pipeline.parallel import HERE, Workers
from pipeline.recording import BLUEPRINT_FILE, StageRecorder, save_blueprint
from pipeline.run import Run
from pipeline.scene import ImageKey, PoseEstimate, Target

log = logging.getLogger(__name__)

_UNFINISHED = re.compile(r"\..+\.(rrd|rbl)\.\d+.*")
"""Files that a process which was killed was writing."""


def run_estimator(
    estimator: Estimator,
    dataset: Dataset,
    run: Run,
    *,
    targets: Iterable[Target] | None = None,
    record: bool = True,
    progress: Callable[[float], None] = lambda _: None,
    workers: Workers = HERE,
) -> int:
    """Estimate all targets (by default those of the dataset) that the run has not finished yet.

    An image on which the estimator fails with an InputError, or that ends its worker process again and again, is kept
    as a failure with its reason; the others go on.

    Args:
        estimator: The method. For other workers than this process it must be fit to be pickled; what is large or
            cannot be pickled is left to a `LazyEstimator`.
        dataset: Where the images are.
        run: Where the estimates go, open for writing.
        targets: What to look for.
        record: Whether to write a recording of each image.
        progress: Called with the finished share of this call, 0..1; what it raises ends the run, to be gone on with.
        workers: Who does the images.

    Returns:
        The number of images of this call that failed.

    """
    by_image: dict[ImageKey, list[Target]] = defaultdict(list)
    for target in dataset.targets() if targets is None else targets:
        by_image[target.image].append(target)
    finished = set(run.finished_images())
    waiting = [(key, by_image[key]) for key in by_image if key not in finished]
    _prepare(run, record and bool(waiting))
    failures = 0
    progress(0.0 if waiting else 1.0)
    job = _Job(estimator, dataset, run, record)
    answers = workers.map_unordered(
        estimate_image,
        waiting,
        job,
        total=len(waiting),
        describe=_named,
        on_lost=lambda _, why: Found([], 0.0, str(why)),
    )
    with closing(answers):
        for done, (position, found) in enumerate(answers, start=1):
            failures += not _add(run, waiting[position][0], found)
            progress(done / len(waiting))
    return failures


class Found(NamedTuple):
    """What came out of an image."""

    estimates: list[PoseEstimate]
    seconds: float
    failure: str | None = None


@dataclass(frozen=True)
class _Job:
    """What the images of a run share."""

    estimator: Estimator
    dataset: Dataset
    run: Run
    record: bool

    def __reduce__(self) -> tuple[Any, ...]:
        return _reopened, (self.estimator, self.dataset, self.run.root.absolute(), self.record)


def _reopened(estimator: Estimator, dataset: Dataset, run: Path, record: bool) -> _Job:
    return _Job(estimator, dataset, Run.open(run), record)


def estimate_image(job: _Job, item: tuple[ImageKey, list[Target]]) -> Found:
    """Run the estimator on one image, in whatever process, and write its recording.

    What is recorded ends with why annotated instances were found or lost, where the method can say so; the time that
    this takes is not counted.
    """
    (key, targets), estimator = item, job.estimator
    if isinstance(estimator, LazyEstimator):
        estimator = estimator.made()  # where that fails, no image can be done
    begun, explaining = time.perf_counter(), 0.0
    try:
        image = job.dataset.image(key)
        with job.run.recorder(key, image.camera, enabled=job.record) as recorder:
            if recorder.enabled:
                if image.rgb is not None:
                    recorder.image("image/rgb", image.rgb)
                if image.depth is not None:
                    recorder.depth("image/depth", image.depth)
                recorder.poses("ground_truth", job.dataset.ground_truth(key))
            estimates, explain = explained(estimator, image, targets, recorder)
            recorder.poses("estimates", estimates)
            if recorder.enabled and explain is not None:
                explaining = _explain(job.dataset, key, targets, explain, recorder)
    except InputError as error:
        return Found([], time.perf_counter() - begun, str(error))
    return Found(estimates, time.perf_counter() - begun - explaining)


def _explain(
    dataset: Dataset, key: ImageKey, targets: Sequence[Target], explain: Explain, recorder: StageRecorder
) -> float:
    """Record why the instances of the targets were found or lost; how many seconds it took."""
    begun = time.perf_counter()
    explain_targets(explain, dataset.ground_truth(key), targets, dataset.model, recorder)
    return time.perf_counter() - begun


def _add(run: Run, key: ImageKey, found: Found) -> bool:
    """Add what was found to the run; whether the image did not fail."""
    failure, timings = found.failure, {"total": found.seconds}
    if failure is None:
        try:
            run.add(key, found.estimates, timings)
        except InputError as error:
            failure = str(error)
        else:
            return True
    log.warning("scene %d, image %d: %s", *key, failure)
    run.add(key, [], timings, failure=failure)  # a disk that is full fails here, too, and ends the run
    return False


def _prepare(run: Run, record: bool) -> None:
    """Clear up after processes that were killed, and write what several would write at the same time."""
    for path in run.recordings.glob(".*"):
        if _UNFINISHED.fullmatch(path.name):
            path.unlink(missing_ok=True)
    if record and not (run.recordings / BLUEPRINT_FILE).exists():
        save_blueprint(run.recordings / BLUEPRINT_FILE)


def _named(item: tuple[ImageKey, list[Target]]) -> str:
    return f"scene {item[0].scene_id}, image {item[0].im_id}"
