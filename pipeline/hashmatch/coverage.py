"""Whether templates show objects as a dataset does: from below, upside down, turned in the image."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from jaxtyping import Float

from pipeline.bop.dataset import Dataset
from pipeline.exceptions import InputError
from pipeline.geometry import project, transform_points
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.poses import rotation_to_ray
from pipeline.hashmatch.templates import Templates
from pipeline.scene import GroundTruth, Model

_MOST_IMAGES = 100
"""Images that are looked at, evenly spread over all."""

_STEPS = 2.0
"""Steps between templates by which an instance has to be turned from every one to be beyond them."""

_TELL = 0.1
"""Share of instances beyond the templates that is told."""


def advice(
    dataset: Dataset, models: Mapping[int, Model], learned: Sequence[Templates], config: HashMatchConfig
) -> list[str]:
    """A line if many annotated instances are far from all templates; nothing where there are no annotations."""
    limit = _STEPS * config.angle_step_deg
    angles = [_nearest(own, models, truth, K) for own, truth, K in _instances(dataset, learned)]
    beyond = sum(angle > limit for angle in angles)
    if not angles or beyond <= _TELL * len(angles):
        return []
    whole = config.views == "sphere" and config.in_plane == "circle"
    fix = "give more views" if whole or config.templates else "add --views sphere --in-plane circle, which takes longer"
    return [f"{beyond} of {len(angles)} annotated instances are more than {limit:g} degrees from every template; {fix}"]


def _instances(
    dataset: Dataset, learned: Sequence[Templates]
) -> Iterator[tuple[Templates, GroundTruth, Float[np.ndarray, "3 3"]]]:
    """Annotated instances of some images, with the templates of their objects and K."""
    by_id, keys = {own.obj_id: own for own in learned}, list(dataset.images())
    for i in np.unique(np.linspace(0, len(keys) - 1, min(_MOST_IMAGES, len(keys))).astype(int)):
        try:
            truths = [truth for truth in dataset.ground_truth(keys[i]) if truth.obj_id in by_id]
            K = dataset.camera(keys[i]).K
        except InputError:  # the run will tell
            continue
        if np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0:
            yield from ((by_id[truth.obj_id], truth, K) for truth in truths)


def _nearest(own: Templates, models: Mapping[int, Model], truth: GroundTruth, K: Float[np.ndarray, "3 3"]) -> float:
    """Degrees from the orientation in which an instance is seen to that of the nearest template, up to symmetries."""
    pose = truth.camera_from_model
    R_a = rotation_to_ray(K, project(K, transform_points(pose, own.centroid)))
    seen = R_a.T @ pose[:3, :3] @ models[own.obj_id].symmetries[:, :3, :3]
    traces = own.rotations.reshape(-1, 9) @ seen.reshape(-1, 9).T
    return float(np.rad2deg(np.arccos(np.clip((traces.max() - 1) / 2, -1, 1))))
