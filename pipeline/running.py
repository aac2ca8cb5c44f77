"""Running an estimator over the images of a dataset into a run folder; what is finished is not done again."""

import logging
import time
from collections import defaultdict
from collections.abc import Callable, Iterable

from pipeline.bop.dataset import Dataset
from pipeline.estimator import Estimator
from pipeline.exceptions import InputError
from pipeline.run import Run
from pipeline.scene import ImageKey, Target

log = logging.getLogger(__name__)


def run_estimator(
    estimator: Estimator,
    dataset: Dataset,
    run: Run,
    *,
    targets: Iterable[Target] | None = None,
    record: bool = True,
    progress: Callable[[float], None] = lambda _: None,
) -> int:
    """Estimate all targets (by default those of the dataset) that the run has not finished yet.

    An image on which the estimator fails with an InputError is kept as a failure with its reason; the others go on.

    Returns:
        The number of images of this call that failed.

    """
    by_image: dict[ImageKey, list[Target]] = defaultdict(list)
    for target in dataset.targets() if targets is None else targets:
        by_image[target.image].append(target)
    finished = set(run.finished_images())
    waiting = [key for key in by_image if key not in finished]
    failures = 0
    for done, key in enumerate(waiting):
        progress(done / len(waiting))
        failures += not _run_image(estimator, dataset, run, key, by_image[key], record)
    progress(1.0)
    return failures


def _run_image(
    estimator: Estimator, dataset: Dataset, run: Run, key: ImageKey, targets: list[Target], record: bool
) -> bool:
    begun = time.perf_counter()
    try:
        image = dataset.image(key)
        with run.recorder(key, image.camera, enabled=record) as recorder:
            if recorder.enabled:
                if image.rgb is not None:
                    recorder.image("image/rgb", image.rgb)
                if image.depth is not None:
                    recorder.depth("image/depth", image.depth)
                recorder.poses("ground_truth", dataset.ground_truth(key))
            estimates = estimator.estimate(image, targets, recorder)
            recorder.poses("estimates", estimates)
        run.add(key, estimates, {"total": time.perf_counter() - begun})
    except InputError as error:
        log.warning("scene %d, image %d: %s", *key, error)
        # A disk that is full fails here, too, and ends the run.
        run.add(key, [], {"total": time.perf_counter() - begun}, failure=str(error))
        return False
    return True
