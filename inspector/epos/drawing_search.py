"""A hypothesis of the search in the picture: its pose as a contour, what it was optimized from, and its triplet."""

from collections.abc import Callable
from functools import partial

import cv2
import numpy as np
from jaxtyping import Float

from inspector.epos import colors
from inspector.epos.search import Hypothesis
from inspector.epos.sketch import WHITE, Color, Sketch, circle
from inspector.nodes import Mesh
from pipeline import geometry
from pipeline.rendering import Rendering, render

RING_PX = 5.0
"""Radius of the rings around the pixels of the triplet."""


def add_hypothesis(sketch: Sketch) -> None:
    """Add the hypothesis that is shown, if any."""
    shown = sketch.row.hypothesis
    if shown is None:
        return
    if shown.before is not None:
        _add_contour(sketch, "before", shown.before.camera_from_model, colors.BEFORE, 1.5)
        sketch.notes.append((f"before local optimization: quality {shown.before.quality:.3f}", colors.BEFORE))
    _add_contour(sketch, "hypothesis", shown.camera_from_model, colors.HYPOTHESIS, 3.0)
    text = f"hypothesis {shown.position + 1}: {shown.stage}, quality {shown.quality:.3f}"
    sketch.notes.append((text, colors.HYPOTHESIS))
    _add_triplet(sketch, shown)


def _add_triplet(sketch: Sketch, shown: Hypothesis) -> None:
    """Ring the three sampled pixels, and in 3D link them with their points on the copy."""
    links = sketch.row.recording.correspondences
    if shown.triplet is None or links is None:
        return
    pixels = links.pixels[shown.triplet].astype(np.float64)
    points = links.points_in_model[shown.triplet].astype(np.float64)
    if not (np.isfinite(pixels).all() and np.isfinite(points).all()):
        return
    sketch.lines("triplet/sides", sketch.at(np.stack([pixels, np.roll(pixels, -1, axis=0)], axis=1)), WHITE, 1.0)
    for number, color in enumerate(colors.TRIPLET):
        sketch.framed(f"triplet/{number}", circle(pixels[number], RING_PX), color, 3.0)
    if sketch.copy is not None:
        palette = np.array(colors.TRIPLET, np.uint8)
        segments = sketch.to_copy(pixels, points)
        sketch.lines("triplet/links", segments, palette, 4.0)
        sketch.points("triplet/points", segments[:, 1], palette, 0.03 * sketch.copy_size)


def _add_contour(sketch: Sketch, name: str, pose: Float[np.ndarray, "4 4"], color: Color, width: float) -> None:
    """Outline of the model at a pose over the image; in 3D the model itself, too."""
    model, frame = sketch.row.model, sketch.row.frame
    if model is None or not np.isfinite(pose).all():
        return
    pixels = outline(render(model, frame.fine_camera, pose, pixel_center=0.0), frame.fineness)
    sketch.lines(name, sketch.at(pixels), color, width)
    if sketch.in_3d:
        vertices: Callable = partial(geometry.transform_points, pose, model.vertices)
        sketch.nodes[f"epos/{name}_model"] = Mesh((model, pose.tobytes()), vertices, model.faces, color, 0.5)


def outline(rendering: Rendering, fineness: int) -> Float[np.ndarray, "n 2 2"]:
    """Segments around a silhouette in pixels of the image, of which those of the rendering are `fineness` times finer."""
    mask = np.pad(rendering.mask_crop.astype(np.uint8), 1)
    rings, _ = cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_TC89_L1)
    offset = np.array([rendering.box.x0, rendering.box.y0]) - 1
    in_image = [(ring[:, 0] + offset - (fineness - 1) / 2) / fineness for ring in rings]
    sides = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in in_image]
    return np.concatenate(sides) if sides else np.zeros((0, 2, 2))
