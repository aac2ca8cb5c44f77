"""Of two poses of an object in an image, which one the measurements bear out."""

import numpy as np
from jaxtyping import Float

from annotate.quality.agreement import Agreement, Verdict
from annotate.quality.instances import contour_distance
from pipeline.bop.dataset import Dataset
from pipeline.exceptions import InputError
from pipeline.rendering import SceneRendering, render_scene

CLOSE = 0.01
"""Metres within which a measurement agrees with a pose."""
MARGIN = 0.15
"""Share of pixels by which one pose has to be better than the other."""
FEWEST_PIXELS = 100


def decide(dataset: Dataset, asked: Agreement) -> Verdict:
    """Of an annotation that is not where most other images have the object, which of the two poses is right.

    `moved` if the image bears out the annotation, `wrong` if it bears out the place known from other images.

    By depth where there is some, else by the edges of the image; undecided, the verdict stays as it was.
    """
    assert asked.expected is not None  # else there is nothing to decide
    try:
        camera, model = dataset.camera(asked.key), dataset.model(asked.obj_id)
        truth = dataset.ground_truth(asked.key)[asked.index]
        depth, rgb = dataset.depth(asked.key), dataset.rgb(asked.key)
    except InputError:
        return asked.verdict
    scenes = [render_scene([(model, pose)], camera) for pose in (truth.camera_from_model, asked.expected)]
    if depth is not None:
        own, other = (_agreeing(scene, depth) for scene in scenes)
    elif rgb is not None:
        own, other = (_on_edges(scene, rgb) for scene in scenes)
    else:
        return asked.verdict
    if own > other + MARGIN:
        return "moved"
    return "wrong" if other > own + MARGIN else asked.verdict


def _agreeing(scene: SceneRendering, depth: Float[np.ndarray, "h w"]) -> float:
    """Share of the object's pixels at which it is measured where it is rendered, of those where nothing is before it."""
    both = (scene.depth > 0) & (depth > 0)
    differences = depth[both] - scene.depth[both]
    seen = differences > -CLOSE
    return float((differences[seen] < CLOSE).mean()) if seen.sum() >= FEWEST_PIXELS else 0.0


def _on_edges(scene: SceneRendering, rgb: np.ndarray) -> float:
    """Nearness of the contour to edges, from 0 to 1."""
    found = contour_distance(scene, 0, rgb, None)
    return 0.0 if found is None else float(np.exp(-found.median / 2.0) * (1.0 - found.missing))
