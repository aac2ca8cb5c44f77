"""VSD straight from the equations (thesis sec. bop_vsd), over whole images in float64; only the renderer is shared."""

from collections.abc import Sequence

import numpy as np

from pipeline.bop.dataset import Dataset
from pipeline.rendering import render
from pipeline.scene import Camera, ImageKey


def slow_vsd(
    dataset: Dataset,
    key: ImageKey,
    obj_id: int,
    estimate: np.ndarray,
    truth: np.ndarray,
    taus_m: Sequence[float],
    unmeasured_is_visible: bool,
) -> list[float]:
    """One error for each misalignment tolerance in metres; delta is 15 mm."""
    camera, model, measured = dataset.camera(key), dataset.model(obj_id), dataset.depth(key)
    assert measured is not None
    a, b = estimate[:3, 3], truth[:3, 3]
    apart = np.hypot(a[0] / a[2] - b[0] / b[2], a[1] / a[2] - b[1] / b[2])
    if apart >= model.diameter / 2 / a[2] + model.diameter / 2 / b[2]:
        return [1.0] * len(taus_m)
    at_estimate, at_truth = (_distances(camera, render(model, camera, pose).depth) for pose in (estimate, truth))
    in_image = _distances(camera, measured)
    unmeasured = (in_image == 0) & unmeasured_is_visible
    seen_truth = (at_truth > 0) & (((in_image > 0) & (at_truth - in_image <= 0.015)) | unmeasured)
    seen = (at_estimate > 0) & (((in_image > 0) & (at_estimate - in_image <= 0.015)) | unmeasured | seen_truth)
    either = seen | seen_truth
    if not either.any():
        return [1.0] * len(taus_m)
    difference = np.abs(at_estimate - at_truth)
    return [(either & ~(seen & seen_truth & (difference < tau))).sum() / either.sum() for tau in taus_m]


def _distances(camera: Camera, depth: np.ndarray) -> np.ndarray:
    z = depth.astype(float)
    v, u = np.mgrid[: camera.height, : camera.width]
    x, y = (u - camera.K[0, 2]) * z / camera.K[0, 0], (v - camera.K[1, 2]) * z / camera.K[1, 1]
    return np.sqrt(x**2 + y**2 + z**2)
