"""How much an image shows of each annotated instance, as BOP defines it: silhouettes, pixel counts and boxes.

The definitions are those of the benchmark's own scripts for masks and `scene_gt_info.json`. The model is rendered at
the annotated pose, pixel (c, r) sampled at (c + 0.5, r + 0.5), also beyond the image, on a canvas of three times its
width and height. It is visible where it is at most delta behind the measured surface or where nothing was measured
(thesis eq. visibility_gt); distances from the camera centre are compared, not depths.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.bop.vsd import DELTA, vsd
from pipeline.rendering import Rendering, SceneRendering, render, render_scene
from pipeline.scene import Camera, Model

BoundingBox = tuple[int, int, int, int]
"""x, y of the first column and row, and the differences to the last ones, as BOP counts them (one less than a width)."""

NO_BOX: BoundingBox = (-1, -1, -1, -1)
"""What stands for a box where nothing is visible."""


@dataclass(frozen=True)
class GtInfo:
    """An annotation's entry in `scene_gt_info.json`; pixels, names and order of the fields are BOP's."""

    bbox_obj: BoundingBox
    """Of the whole silhouette, also outside the image; NO_BOX where nothing of it is visible."""
    bbox_visib: BoundingBox
    """Of the visible silhouette."""
    px_count_all: int
    """Pixels of the whole silhouette, on the canvas that reaches beyond the image."""
    px_count_valid: int
    """Pixels of the silhouette inside the image where depth was measured."""
    px_count_visib: int
    """Pixels of the visible silhouette."""
    visib_fract: float
    """px_count_visib / px_count_all, 0 where there is no silhouette."""


@dataclass(frozen=True, eq=False)
class InstanceView:
    """One annotated instance in one image."""

    info: GtInfo
    rendering: Rendering
    """The silhouette inside the image, as if nothing stood before it."""
    visible_crop: Bool[np.ndarray, "h w"]
    """What is visible of it, cut to the box of the rendering."""

    @property
    def mask(self) -> Bool[np.ndarray, "H W"]:
        """Full silhouette in the whole image (BOP `mask`)."""
        return self.rendering.mask

    @property
    def visible_mask(self) -> Bool[np.ndarray, "H W"]:
        """Visible silhouette in the whole image (BOP `mask_visib`)."""
        return self.rendering.expand(self.visible_crop)


def view_instances(
    models_and_poses: Sequence[tuple[Model, Float[np.ndarray, "4 4"]]],
    camera: Camera,
    depth: Float[np.ndarray, "H W"] | None,
    delta: float = DELTA,
) -> list[InstanceView]:
    """Measure all annotated instances of one image, given as models and poses `camera_from_model`, in their order.

    `depth` is the measured one (metres, 0 where not measured), `delta` the tolerance of the visibility test (metres).
    Without depth the rendering of all the instances stands in for it: at each pixel the nearest one is visible
    (delta 0, for a rendering has no noise), every pixel counts as measured, and what is not annotated hides nothing.
    Raises FormatError if the depth image is not of the camera's size.
    """
    scene = render_scene(models_and_poses, camera)
    if depth is None:
        depth, delta = scene.depth, 0.0
    pairs = zip(models_and_poses, scene.renderings, strict=True)
    return [_view(model, pose, camera, rendering, depth, delta) for (model, pose), rendering in pairs]


def exact_instances(
    models_and_poses: Sequence[tuple[Model, Float[np.ndarray, "4 4"]]],
    camera: Camera,
    scene: SceneRendering,
    depth: Float[np.ndarray, "H W"],
    pixel_center: float,
) -> list[InstanceView]:
    """Measure the instances of a synthetic image: what is visible is known, pixel by pixel.

    `scene` begins with the given instances and may go on with what else is there; it was rendered with this pixel
    centre. `depth` is the measured one (metres, 0 where not measured).
    """
    views = []
    for index, (posed, rendering) in enumerate(zip(models_and_poses, scene.renderings, strict=False)):
        visible = scene.instance_ids[rendering.box.slices] == index
        measured = depth[rendering.box.slices] > 0
        views.append(InstanceView(_info(posed, camera, rendering, visible, measured, pixel_center), rendering, visible))
    return views


class _Extent(NamedTuple):
    """Size and bounds of a silhouette or of a part of it; the last column and row are in it."""

    pixels: int
    left: int
    top: int
    right: int
    bottom: int


def _view(
    model: Model,
    pose: Float[np.ndarray, "4 4"],
    camera: Camera,
    rendering: Rendering,
    depth: Float[np.ndarray, "H W"],
    delta: float,
) -> InstanceView:
    compared = vsd(rendering, rendering, depth, camera.K, diameter=1.0, taus=(), delta=delta)
    visible = compared.visible_gt
    info = _info((model, pose), camera, rendering, visible, compared.distance_test > 0)
    return InstanceView(info, rendering, visible)


def _info(
    posed: tuple[Model, Float[np.ndarray, "4 4"]],
    camera: Camera,
    rendering: Rendering,
    visible: Bool[np.ndarray, "h w"],
    measured: Bool[np.ndarray, "h w"],
    pixel_center: float = 0.5,
) -> GtInfo:
    inside = _extent(rendering.mask_crop, rendering.box.x0, rendering.box.y0)
    parts = [*inside, *(_beyond(*posed, camera, pixel_center) if _may_reach_out(rendering) else ())]
    count, count_visible = sum(part.pixels for part in parts), int(np.count_nonzero(visible))
    return GtInfo(
        bbox_obj=_bounding_box(parts if count_visible else []),
        bbox_visib=_bounding_box(_extent(visible, rendering.box.x0, rendering.box.y0)),
        px_count_all=count,
        px_count_valid=int(np.count_nonzero(rendering.mask_crop & measured)),
        px_count_visib=count_visible,
        visib_fract=count_visible / count if count else 0.0,
    )


def _may_reach_out(rendering: Rendering) -> bool:
    """Whether something of the object may lie outside the image: the box around it touches the border, or is empty."""
    height, width = rendering.image_shape
    x0, y0, x1, y1 = rendering.box
    return not (0 < x0 < x1 < width and 0 < y0 < y1 < height)


def _beyond(model: Model, pose: Float[np.ndarray, "4 4"], camera: Camera, pixel_center: float) -> Iterator[_Extent]:
    """The silhouette in the eight neighbours of the image, which with it make up BOP's canvas; bounds from its corner.

    One after the other they take no more memory than the image, and the image itself is rendered as it always is.
    """
    for row in (-1, 0, 1):
        for column in (-1, 0, 1):
            if (row, column) != (0, 0):
                x, y = column * camera.width, row * camera.height
                shift = np.array([[1.0, 0, -x], [0, 1.0, -y], [0, 0, 1.0]])
                part = render(
                    model, Camera(shift @ camera.K, camera.width, camera.height), pose, pixel_center=pixel_center
                )
                yield from _extent(part.mask_crop, x + part.box.x0, y + part.box.y0)


def _extent(mask: Bool[np.ndarray, "h w"], x: int, y: int) -> list[_Extent]:
    """Size and bounds of a mask whose first pixel lies at (x, y); none if it is empty."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return []
    count = int(np.count_nonzero(mask))
    return [_Extent(count, x + int(columns[0]), y + int(rows[0]), x + int(columns[-1]), y + int(rows[-1]))]


def _bounding_box(parts: Sequence[_Extent]) -> BoundingBox:
    if not parts:
        return NO_BOX
    left, top = min(part.left for part in parts), min(part.top for part in parts)
    return left, top, max(part.right for part in parts) - left, max(part.bottom for part in parts) - top
