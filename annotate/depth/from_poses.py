"""Depth of annotated objects, measured and rendered: what depth is corrected by where there is no board."""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float

from annotate.depth.from_board import Collected, collected
from annotate.depth.samples import DepthSamples
from pipeline.bop.dataset import Dataset
from pipeline.exceptions import InputError
from pipeline.parallel import HERE, Workers
from pipeline.rendering import render_scene
from pipeline.scene import ImageKey

RIM_PX = 3
"""Pixels inside the outlines that are left out: poses are never right to the pixel."""
STEEPEST = 0.02
"""Share of its depth by which a rendered surface may change to the next pixel."""
FARTHEST = 0.05
"""Metres: what differs by more is not of the object (thesis sec. tless_gt_eval)."""
MOST_PER_IMAGE = 4000
"""Pixels; of more, some that are spread evenly."""


@dataclass(frozen=True, eq=False)
class _Looking:
    dataset: Dataset
    objects: frozenset[int]


def pose_samples(
    dataset: Dataset, keys: Sequence[ImageKey], objects: Sequence[int] = (), workers: Workers = HERE
) -> Collected:
    """Depth of the annotated instances in all images; of some objects only, if they are given.

    The poses must be right: their errors go into the correction. Raises InputError if no image has any.
    """
    looking = _Looking(dataset, frozenset(objects or dataset.models.obj_ids))
    found: dict[int, DepthSamples | str] = {}
    for position, samples in workers.map_unordered(_of_image, keys, looking, total=len(keys)):
        found[position] = samples
    return collected(keys, found, str(dataset.root))


def _of_image(looking: _Looking, key: ImageKey) -> DepthSamples | str:
    """What a worker does: samples of an image, or why there are none."""
    dataset = looking.dataset
    try:
        depth, camera = dataset.depth(key), dataset.camera(key)
        truths = [truth for truth in dataset.ground_truth(key) if truth.obj_id in set(dataset.models.obj_ids)]
        if depth is None or not truths:
            return f"has no {'depth image' if depth is None else 'annotated object with a model'}"
        if not (depth > 0).any():
            return "depth is 0 in all pixels"
        posed = [(dataset.model(truth.obj_id), truth.camera_from_model) for truth in truths]
        scene = render_scene(posed, camera, pixel_center=0.0)
        asked = [i for i, truth in enumerate(truths) if truth.obj_id in looking.objects]
        clear = _inside(scene.instance_ids, asked) & _gentle(scene.depth)
    except InputError as error:
        return str(error)
    usable = clear & (depth > 0) & (np.abs(depth - scene.depth) < FARTHEST)
    v, u = np.nonzero(usable)
    if not len(v):
        return f"nowhere on an object is depth measured within {100 * FARTHEST:g} cm of its pose"
    chosen = np.linspace(0, len(v) - 1, min(len(v), MOST_PER_IMAGE)).astype(int)
    v, u = v[chosen], u[chosen]
    measured, expected = depth[v, u].astype(float), scene.depth[v, u].astype(float)
    pixels = np.stack([u, v], axis=-1).astype(float)
    return DepthSamples(measured, expected, pixels, np.zeros(len(v), int), (), (camera.width, camera.height))


def _inside(instance_ids: np.ndarray, asked: Sequence[int]) -> Bool[np.ndarray, "h w"]:
    """Pixels of the asked instances, away from all outlines."""
    window = np.ones((2 * RIM_PX + 1, 2 * RIM_PX + 1), np.uint8)
    ids = instance_ids.astype(np.float32)
    alike = cv2.dilate(ids, window) == cv2.erode(ids, window)
    return alike & np.isin(instance_ids, list(asked))


def _gentle(rendered: Float[np.ndarray, "h w"]) -> Bool[np.ndarray, "h w"]:
    """Where the rendered surface is not seen at a flat angle."""
    slope = np.hypot(cv2.Scharr(rendered, cv2.CV_32F, 1, 0), cv2.Scharr(rendered, cv2.CV_32F, 0, 1)) / 32
    return (rendered > 0) & (slope < STEEPEST * rendered)
