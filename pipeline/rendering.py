"""Depth, mask and instance id of models at given poses, by ray casting (Open3D's Embree).

Rays are cast in the model's own frame, so one acceleration structure per model serves all its poses, and only
through the projected bounding box of the object. A rendering is kept as that crop; `.depth` and `.mask` give
the full image.

Pixel (c, r) is sampled at (c + pixel_center, r + pixel_center): 0.5 is what BOP's renderer does and what evaluation
needs; 0.0 is right for overlays, since in a BOP image the centre of pixel (0, 0) is at (0, 0).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Float32, Int32

from pipeline.ray_casting import NO_HIT, Box, Hits, cast, visible_box
from pipeline.scene import Camera, Model

MAX_RAYS = 4_000_000
"""Rays cast at once, which bounds the memory to some 200 MB."""


@dataclass(frozen=True, eq=False)
class Surface:
    """Which point of the model each pixel of a crop shows."""

    face_ids: Int32[np.ndarray, "h w"]
    """Row of `model.faces`, -1 where there is no object."""
    barycentric: Float32[np.ndarray, "h w 2"]
    """(b, c): the point is (1 - b - c) * first + b * second + c * third corner of the face."""
    normals: Float32[np.ndarray, "h w 3"]
    """Unit normal of the face (corner order), model frame; zero where there is no object."""


@dataclass(frozen=True, eq=False)
class Rendering:
    """One object in one pose, cut to the box around it."""

    box: Box
    """Where the crop lies in the image; empty where the object is out of sight."""
    depth_crop: Float32[np.ndarray, "h w"]
    """Metres along z, 0 outside the object."""
    image_shape: tuple[int, int]
    """Rows and columns of the whole image."""
    surface: Surface | None = None
    """Faces hit, for the same crop; only when asked for."""

    @property
    def mask_crop(self) -> Bool[np.ndarray, "h w"]:
        """Silhouette in the crop."""
        return self.depth_crop > 0

    @property
    def depth(self) -> Float32[np.ndarray, "H W"]:
        """Depth of the whole image, metres along z, 0 outside the object (a new array each time)."""
        return self.expand(self.depth_crop)

    @property
    def mask(self) -> Bool[np.ndarray, "H W"]:
        """Silhouette in the whole image (a new array each time)."""
        return self.expand(self.mask_crop)

    def expand(self, crop: np.ndarray, fill: float = 0) -> np.ndarray:
        """Put an array that covers the crop into a whole image of `fill`."""
        image = np.full(self.image_shape + crop.shape[2:], fill, crop.dtype)
        image[self.box.slices] = crop
        return image


@dataclass(frozen=True, eq=False)
class SceneRendering:
    """Several objects in one image, the nearest one seen at each pixel."""

    depth: Float32[np.ndarray, "H W"]
    """Metres along z, 0 for background."""
    instance_ids: Int32[np.ndarray, "H W"]
    """Position in the list that was rendered, -1 for background."""
    renderings: tuple[Rendering, ...]
    """Each object alone, in the order given: its full silhouette, as if nothing stood before it."""


def render(
    model: Model,
    camera: Camera,
    camera_from_model: Float[np.ndarray, "4 4"],
    pixel_center: float = 0.5,
    with_surface: bool = False,
) -> Rendering:
    """Render one model in one pose; see `render_depths`."""
    return render_depths(model, camera, camera_from_model[None], pixel_center, with_surface)[0]


def render_depths(
    model: Model,
    camera: Camera,
    poses: Float[np.ndarray, "n 4 4"],
    pixel_center: float = 0.5,
    with_surface: bool = False,
) -> list[Rendering]:
    """Render one model in many poses `camera_from_model`, each as if alone, with one call of the ray caster.

    Rotations are taken as they are. A pose that is not finite or cannot be inverted shows nothing, as does an object
    behind the camera or outside the image; of one that reaches behind the camera, the part before it is seen.
    """
    poses = np.asarray(poses, dtype=np.float64)
    renderings: list[Rendering] = []
    boxes = [visible_box(model, camera, pose, pixel_center) for pose in poses]
    for start, stop in pairwise(_batch_limits(boxes)):
        hits = cast(model, camera, poses[start:stop], boxes[start:stop], pixel_center)
        renderings += [
            _rendering(box, hit, (camera.height, camera.width), with_surface)
            for box, hit in zip(boxes[start:stop], hits, strict=True)
        ]
    return renderings


def render_scene(
    models_and_poses: Sequence[tuple[Model, Float[np.ndarray, "4 4"]]], camera: Camera, pixel_center: float = 0.5
) -> SceneRendering:
    """Render several objects together, one call of the ray caster per different model."""
    positions: dict[Model, list[int]] = {}
    for i, (model, _) in enumerate(models_and_poses):
        positions.setdefault(model, []).append(i)
    alone: dict[int, Rendering] = {}
    for model, rows in positions.items():
        poses = np.stack([models_and_poses[i][1] for i in rows])
        alone.update(zip(rows, render_depths(model, camera, poses, pixel_center), strict=True))
    return _compose([alone[i] for i in range(len(models_and_poses))], (camera.height, camera.width))


def _rendering(box: Box, hits: Hits, image_shape: tuple[int, int], with_surface: bool) -> Rendering:
    depth = np.where(np.isfinite(hits.depth), hits.depth, np.float32(0))
    if not with_surface:
        return Rendering(box, depth, image_shape)
    face_ids = np.where(hits.face_ids == NO_HIT, -1, hits.face_ids.astype(np.int32))
    return Rendering(box, depth, image_shape, Surface(face_ids, hits.barycentric.copy(), hits.normals.copy()))


def _compose(renderings: list[Rendering], image_shape: tuple[int, int]) -> SceneRendering:
    depth = np.zeros(image_shape, np.float32)
    instance_ids = np.full(image_shape, -1, np.int32)
    for i, rendering in enumerate(renderings):
        behind = depth[rendering.box.slices]  # a view: written through below
        nearer = rendering.mask_crop & ((behind == 0) | (rendering.depth_crop < behind))
        behind[nearer] = rendering.depth_crop[nearer]
        instance_ids[rendering.box.slices][nearer] = i
    return SceneRendering(depth, instance_ids, tuple(renderings))


def _batch_limits(boxes: list[Box]) -> list[int]:
    """Where to cut the list of boxes so that no part has more than MAX_RAYS pixels (but at least one box)."""
    limits, rays = [0], 0
    for i, box in enumerate(boxes):
        rays += box.area
        if rays > MAX_RAYS and i > limits[-1]:
            limits.append(i)
            rays = box.area
    return [*limits, len(boxes)]
