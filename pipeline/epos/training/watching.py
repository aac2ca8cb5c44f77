"""Showing how training goes: curves of the losses, and what the network says of sample images, in a run folder.

The folder can be opened by the inspector like any run; its recordings are written anew each time.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float32

from pipeline.bop.dataset import Dataset
from pipeline.epos.checkpoint import TrainedNetwork
from pipeline.epos.config import CorrespondenceConfig, EposSettings
from pipeline.epos.estimator import EposEstimator
from pipeline.epos.showing import show_targets
from pipeline.epos.targets import make_targets
from pipeline.epos.training.images import labelled_image
from pipeline.epos.training.preparing import Prepared
from pipeline.exceptions import InputError
from pipeline.recording import StageRecorder
from pipeline.run import Run
from pipeline.scene import ImageKey, Target

CURVES = ("total", "objects", "fragments", "coordinates")
"""Names of the columns of losses."""

_POINTS = 500
"""Points of a curve; each is the mean over some steps."""


_SETTINGS = EposSettings(correspondences=CorrespondenceConfig(min_object_probability=0.3))
"""A network that knows little finds every object a little likely everywhere, which takes long and shows nothing."""


def sample_keys(dataset: Dataset, count: int) -> tuple[ImageKey, ...]:
    """Images spread over a dataset."""
    keys = list(dataset.images())
    places = np.unique(np.linspace(0, len(keys) - 1, min(count, len(keys))).round().astype(int)) if keys else []
    return tuple(keys[place] for place in places)


def record_progress(
    run: Run, prepared: Prepared, keys: Sequence[ImageKey], trained: TrainedNetwork, losses: Float32[np.ndarray, "s 4"]
) -> None:
    """Record each sample image as the network sees it now and as it should, with the curves so far."""
    dataset, estimator = prepared.dataset, EposEstimator(trained, _SETTINGS)
    for key in keys:
        image = dataset.image(key)
        if image.rgb is None:
            continue
        targets = [target for target in _targets(dataset, key) if target.obj_id in trained.obj_ids]
        with run.recorder(key, image.camera) as recorder:
            recorder.image("image/rgb", image.rgb)
            recorder.poses("ground_truth", dataset.ground_truth(key))
            recorder.text("log", f"after {len(losses)} steps of training")
            record_curves(recorder, losses)
            show_targets(make_targets(labelled_image(dataset, key), prepared.objects), prepared.objects, recorder)
            try:
                recorder.poses("estimates", estimator.estimate(image, targets, recorder))
            except InputError as error:  # diverged: the curves show it
                recorder.text("log", str(error), "ERROR")
        if key not in run.finished_images():
            run.add(key, [])


def record_curves(recorder: StageRecorder, losses: Float32[np.ndarray, "s 4"]) -> None:
    """Record the losses over steps, smoothed so that a curve has some hundred points."""
    window = max(len(losses) // _POINTS, 1)
    count = len(losses) // window
    means = losses[: count * window].reshape(count, window, 4).mean(axis=1)
    steps = (np.arange(count) + 1) * window
    for name, values in zip(CURVES, means.T, strict=True):
        recorder.scalars(f"epos/training/{name}", np.ascontiguousarray(values), steps)


def _targets(dataset: Dataset, key: ImageKey) -> list[Target]:
    """One target per object annotated in an image."""
    counts: dict[int, int] = {}
    for truth in dataset.ground_truth(key):
        counts[truth.obj_id] = counts.get(truth.obj_id, 0) + 1
    return [Target(*key, obj_id, count) for obj_id, count in counts.items()]
