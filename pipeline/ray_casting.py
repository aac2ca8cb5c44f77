"""Casting the rays of boxes of pixels at a model with Open3D's Embree."""

from math import ceil, floor
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Float32, UInt32

from pipeline.geometry import inverse, project, transform_points
from pipeline.model_cache import convex_hull, per_model
from pipeline.scene import Camera, Model

NEAR = 1e-3
"""Metres: where some part of the object is nearer to the camera plane than this, the whole image is searched."""

NO_HIT = np.uint32(0xFFFFFFFF)


class Box(NamedTuple):
    """Half-open pixel rectangle x0 <= column < x1, y0 <= row < y1."""

    x0: int
    y0: int
    x1: int
    y1: int

    @property
    def slices(self) -> tuple[slice, slice]:
        """Index of the rectangle in an image."""
        return slice(self.y0, self.y1), slice(self.x0, self.x1)

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.y1 - self.y0, self.x1 - self.x0

    @property
    def area(self) -> int:
        """Number of pixels."""
        return (self.y1 - self.y0) * (self.x1 - self.x0)


class Hits(NamedTuple):
    """What the rays of one box met: views of a larger answer, to be copied by those who keep them."""

    depth: Float32[np.ndarray, "h w"]
    """Metres along z, infinite where nothing was hit."""
    face_ids: UInt32[np.ndarray, "h w"]
    """NO_HIT where nothing was hit."""
    barycentric: Float32[np.ndarray, "h w 2"]
    normals: Float32[np.ndarray, "h w 3"]


def visible_box(model: Model, camera: Camera, pose: Float[np.ndarray, "4 4"], pixel_center: float) -> Box:
    """The pixels that can see the object: bounds of the projected convex hull."""
    if not np.isfinite(pose).all() or abs(np.linalg.det(pose[:3, :3])) < 1e-12 or not len(model.faces):
        return Box(0, 0, 0, 0)
    hull_in_camera = transform_points(pose, _hull_points(model))
    if hull_in_camera[:, 2].max() <= NEAR:
        return Box(0, 0, 0, 0)
    if hull_in_camera[:, 2].min() <= NEAR:  # projections of such points say nothing about where the object is seen
        return Box(0, 0, camera.width, camera.height)
    pixels = project(camera.K, hull_in_camera)
    # Columns one by one: numpy is slow on a reduction of many short rows.
    x0, x1 = _limits(pixels[:, 0], pixel_center, camera.width)
    y0, y1 = _limits(pixels[:, 1], pixel_center, camera.height)
    return Box(x0, y0, x1, y1) if x0 < x1 and y0 < y1 else Box(0, 0, 0, 0)


def _limits(pixels: Float[np.ndarray, "n"], pixel_center: float, size: int) -> tuple[int, int]:
    """First and one after last of the columns (or rows) that these coordinates lie in, inside the image."""
    first, last = float(pixels.min()) - pixel_center, float(pixels.max()) - pixel_center
    return floor(min(max(first, 0), size)), ceil(min(max(last, -1), size - 1)) + 1


@per_model
def _hull_points(model: Model) -> Float[np.ndarray, "h 3"]:
    return model.vertices[convex_hull(model)]


def cast(
    model: Model, camera: Camera, poses: Float[np.ndarray, "n 4 4"], boxes: list[Box], pixel_center: float
) -> list[Hits]:
    """Cast the rays of one box of pixels per pose, all in one call, and cut the answer up again."""
    areas = [box.area for box in boxes]
    ends = np.cumsum(areas, dtype=int)
    starts = ends - areas
    rays = np.empty((sum(areas), 6), np.float32)
    for pose, box, start, end in zip(poses, boxes, starts, ends, strict=True):
        if end > start:
            _fill_rays(rays[start:end].reshape(*box.shape, 6), camera.K, pose, box, pixel_center)
    answer = _answer(model, rays)
    return [
        Hits(*(values[start:end].reshape(*box.shape, *values.shape[1:]) for values in answer))
        for box, start, end in zip(boxes, starts, ends, strict=True)
    ]


def _fill_rays(
    rays: Float32[np.ndarray, "h w 6"], K: np.ndarray, camera_from_model: np.ndarray, box: Box, pixel_center: float
) -> None:
    """Write origins and directions of a box of pixels, in the model frame.

    A direction is the model-frame image of K^-1 (u, v, 1), whose z in the camera frame is 1: left unnormalized, the
    ray parameter of a hit is its depth, for any invertible affine pose.
    """
    model_from_camera = inverse(camera_from_model)
    per_u, per_v, at_origin = (model_from_camera[:3, :3] @ np.linalg.inv(K)).T
    u = np.arange(box.x0, box.x1) + pixel_center
    v = np.arange(box.y0, box.y1) + pixel_center
    for k in range(3):  # long inner loops: numpy is slow on arrays whose last axis is 3
        rays[..., k] = model_from_camera[k, 3]
        rays[..., 3 + k] = u * per_u[k] + (v * per_v[k] + at_origin[k])[:, None]


def _answer(model: Model, rays: Float32[np.ndarray, "n 6"]) -> Hits:
    if not len(rays):
        return Hits(*(np.empty((0, *shape), np.float32) for shape in ((), (), (2,), (3,))))
    from open3d.core import Tensor

    answer = _raycaster(model).cast_rays(Tensor.from_numpy(rays))
    return Hits(*(answer[name].numpy() for name in ("t_hit", "primitive_ids", "primitive_uvs", "primitive_normals")))


@per_model
def _raycaster(model: Model) -> Any:
    """Open3D's scene of one model, its acceleration structure built."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    vertices = o3d.core.Tensor.from_numpy(np.ascontiguousarray(model.vertices, np.float32))
    faces = o3d.core.Tensor.from_numpy(np.ascontiguousarray(model.faces, np.uint32))
    scene.add_triangles(vertices, faces)
    # The structure is built by the first cast; doing it here keeps later casts free for many threads.
    scene.cast_rays(o3d.core.Tensor.from_numpy(np.zeros((1, 6), np.float32)))
    return scene


def first_hit(
    model: Model,
    camera_from_model: Float[np.ndarray, "4 4"],
    origin: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"],
) -> float | None:
    """Where one ray, given in the camera frame, first meets the model: the factor of `direction`; None for a miss."""
    if not np.isfinite(camera_from_model).all() or abs(np.linalg.det(camera_from_model[:3, :3])) < 1e-12:
        return None
    from open3d.core import Tensor

    model_from_camera = inverse(camera_from_model)
    ray = np.concatenate([transform_points(model_from_camera, origin), model_from_camera[:3, :3] @ direction])
    factor = float(_raycaster(model).cast_rays(Tensor.from_numpy(ray[None].astype(np.float32)))["t_hit"].numpy()[0])
    return factor if np.isfinite(factor) else None
