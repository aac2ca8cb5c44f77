"""How well each annotated instance of one image agrees with what was measured: depth and edges."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8

from annotate.edges import Outline, Shift, common_shift, edge_profiles, nearest_edges, outline
from annotate.quality.depth_difference import SURFACE, DepthDifferences
from pipeline.rendering import Rendering, SceneRendering, render_scene
from pipeline.scene import Camera, GroundTruth, ImageKey, Model

REACH_PX = 8
"""How far from a rendered contour its edge is looked for."""
FEWEST_POINTS = 30
"""Points of a contour that say something."""
PIXEL_CENTER = 0.5
"""Where in a pixel the models are sampled: as in BOP's renderer, with which masks and published figures are made."""


@dataclass(frozen=True)
class ContourDistance:
    """Rendered contour against the edges of the colour image, in pixels."""

    points: int
    """Points of the contour that were compared: its own, not where another object hides it."""
    median: float
    """Median distance to the nearest edge along the normal; 8 where there is none so near."""
    missing: float
    """Share of the points without an edge in reach."""
    shift: Shift | None
    """The displacement that would bring the contour onto the edges; None where too few of them tell it."""


@dataclass(frozen=True, eq=False)
class InstanceMeasures:
    """One annotated instance against its image."""

    key: ImageKey
    index: int
    """Position in the image's list of annotations."""
    obj_id: int
    visible: int
    """Pixels at which it is the nearest of the annotated objects."""
    depth: DepthDifferences | None
    """None where the image has no depth."""
    contour: ContourDistance | None
    """None where the image has no colour, or hardly any of the contour is to be seen."""


def measure_instances(
    key: ImageKey,
    truths: Sequence[GroundTruth],
    models: Mapping[int, Model],
    camera: Camera,
    rgb: UInt8[np.ndarray, "h w 3"] | None,
    depth: Float[np.ndarray, "h w"] | None,
) -> list[InstanceMeasures]:
    """Measure all annotated instances of an image whose object has a model; the others stand before nothing."""
    known = [truth for truth in truths if truth.obj_id in models]
    scene = render_scene([(models[truth.obj_id], truth.camera_from_model) for truth in known], camera, PIXEL_CENTER)
    found = []
    for position, (truth, rendering) in enumerate(zip(known, scene.renderings, strict=True)):
        visible = scene.instance_ids[rendering.box.slices] == position
        differences = None if depth is None else depth_differences(rendering, visible, depth)
        contour = None if rgb is None else contour_distance(scene, position, rgb, depth)
        count = int(np.count_nonzero(visible))
        found.append(InstanceMeasures(key, truth.index, truth.obj_id, count, differences, contour))
    return found


def depth_differences(
    rendering: Rendering, visible: Bool[np.ndarray, "h w"], depth: Float[np.ndarray, "H W"]
) -> DepthDifferences:
    """Measured minus rendered depth where an object is visible and depth was measured."""
    measured = depth[rendering.box.slices]
    both = visible & (measured > 0)
    return DepthDifferences.of((measured[both] - rendering.depth_crop[both]).astype(np.float64))


def contour_distance(
    scene: SceneRendering,
    position: int,
    rgb: UInt8[np.ndarray, "H W 3"],
    depth: Float[np.ndarray, "H W"] | None,
) -> ContourDistance | None:
    """Compare the contour of one object of a rendering with the edges of the image.

    Left out are points at which something nearer, rendered or measured, hides the object: there the edge is another's.
    """
    rendering = scene.renderings[position]
    box = rendering.box
    own = _own_rim(scene, position, depth)
    local = outline(rendering.mask_crop, own) if own.any() else None
    if local is None or len(local.points) < FEWEST_POINTS:
        return None
    image, offset = _window(rgb, box, REACH_PX + 4)
    found = Outline(local.points + offset + PIXEL_CENTER, local.normals)
    steps, strength = edge_profiles(image, found, REACH_PX)
    offsets = nearest_edges(steps, strength, np.zeros(len(found.points)))
    distance = np.where(np.abs(offsets) <= REACH_PX, np.abs(offsets), np.nan)
    shift = common_shift(found, steps, strength)
    missing = float(np.isnan(distance).mean())
    median = float(np.median(np.nan_to_num(distance, nan=REACH_PX)))
    return ContourDistance(len(distance), median, missing, shift)


def _own_rim(scene: SceneRendering, position: int, depth: Float[np.ndarray, "H W"] | None) -> Bool[np.ndarray, "h w"]:
    """Where an object ends by itself: it is visible there, and nothing nearer was measured on either side."""
    import cv2

    rendering = scene.renderings[position]
    around = np.ones((3, 3), np.uint8)
    kept = scene.instance_ids[rendering.box.slices] == position
    behind = np.where(rendering.mask_crop, rendering.depth_crop, np.float32(0))
    reach = cv2.dilate(behind, around)  # the object's depth, carried over its rim
    others = scene.depth[rendering.box.slices]
    hides = (others > 0) & (others < reach - SURFACE)
    if depth is not None:
        measured = depth[rendering.box.slices]
        hides |= (measured > 0) & (measured < reach - SURFACE)
    return kept & (cv2.dilate(hides.astype(np.uint8), around) == 0)


def _window(
    rgb: UInt8[np.ndarray, "H W 3"], box: tuple[int, int, int, int], margin: int
) -> tuple[UInt8[np.ndarray, "h w 3"], Float[np.ndarray, "2"]]:
    """The image about a box, and where the box begins in it."""
    x0, y0 = max(box[0] - margin, 0), max(box[1] - margin, 0)
    return rgb[y0 : box[3] + margin, x0 : box[2] + margin], np.array([box[0] - x0, box[1] - y0], float)
