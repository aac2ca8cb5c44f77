"""Pictures of the model from two sides with its fragments: as the pose shows it to the camera, and from behind."""

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8

from inspector.epos.colors import TRIPLET, UNLIT
from pipeline import geometry
from pipeline.epos.fragments import nearest_center
from pipeline.rendering import render_depths
from pipeline.scene import Camera, Model

SIZE = 320
"""Pixels of the side of one picture; shown at half of that."""
DISTANCE = 8.0
"""Of the camera, in radii of the model: far, so that it shows nearly half of the surface."""
AMBIENT = 0.35
SEAM = 0.72
"""Brightness of the seams between fragments."""


@dataclass(frozen=True, eq=False)
class Side:
    """The model from one side."""

    camera: Camera
    camera_from_model: Float[np.ndarray, "4 4"]
    depth: Float32[np.ndarray, "s s"]
    """Metres, 0 outside the model."""
    fragment_ids: Int[np.ndarray, "s s"]
    """-1 outside the model; 0 where fragments are unknown."""
    shade: Float[np.ndarray, "s s"]

    @property
    def mask(self) -> Bool[np.ndarray, "s s"]:
        """Where the model is."""
        return self.depth > 0

    def fragment_at(self, x: float, y: float) -> int | None:
        """Fragment at a place of the picture (shares 0..1); None beside the model."""
        column, row = (min(max(int(share * SIZE), 0), SIZE - 1) for share in (x, y))
        found = int(self.fragment_ids[row, column])
        return found if found >= 0 else None

    def painted(self, colors: UInt8[np.ndarray, "n 3"]) -> UInt8[np.ndarray, "s s 4"]:
        """The picture with a colour for each fragment; transparent beside the model."""
        palette = colors if len(colors) else np.array([UNLIT], np.uint8)
        picture = np.zeros((SIZE, SIZE, 4), np.uint8)
        mask = self.mask
        picture[mask, :3] = palette[np.minimum(self.fragment_ids[mask], len(palette) - 1)] * self.shade[mask][:, None]
        picture[..., 3] = cv2.GaussianBlur(np.where(mask, np.uint8(255), np.uint8(0)), (3, 3), 0)
        return picture

    def seen(self, points: Float[np.ndarray, "k 3"]) -> tuple[Float[np.ndarray, "k 2"], Bool[np.ndarray, "k"]]:
        """Where points of the model lie in the picture, pixels, and whether nothing of the model hides them."""
        in_camera = geometry.transform_points(self.camera_from_model, points)
        pixels = geometry.project(self.camera.K, in_camera)
        column, row = np.clip(pixels.round().astype(int), 0, SIZE - 1).T
        surface = self.depth[row, column]
        allowed = 0.04 * float(np.ptp(self.depth[self.mask])) if self.mask.any() else 0.0
        return pixels, (surface == 0) | (in_camera[:, 2] < surface + allowed)


def sides_of(
    model: Model, centers: Float[np.ndarray, "n 3"] | None, rotation: Float[np.ndarray, "3 3"]
) -> tuple[Side, Side]:
    """The side that a camera sees at a rotation, and the one that it does not; kept while the arguments stay equal."""
    known = b"" if centers is None else np.ascontiguousarray(centers, np.float64).tobytes()
    return _rendered(model, known, np.round(rotation.astype(np.float64), 2).tobytes())


@lru_cache(maxsize=32)
def _rendered(model: Model, centers_bytes: bytes, rotation_bytes: bytes) -> tuple[Side, Side]:
    centers = np.frombuffer(centers_bytes).reshape(-1, 3)
    rotation = _proper(np.frombuffer(rotation_bytes).reshape(3, 3))
    middle = (model.vertices.min(axis=0) + model.vertices.max(axis=0)) / 2
    radius = float(np.linalg.norm(model.vertices - middle, axis=1).max()) or 1.0
    focal = 0.48 * SIZE * DISTANCE
    center = (SIZE - 1) / 2
    camera = Camera(np.array([[focal, 0, center], [0, focal, center], [0, 0, 1]]), SIZE, SIZE)
    poses = np.stack([_looked_at(turn @ rotation, middle, DISTANCE * radius) for turn in (np.eye(3), _BEHIND)])
    first, second = (
        _side(model, camera, pose, rendering, centers)
        for pose, rendering in zip(poses, render_depths(model, camera, poses, 0.0, with_surface=True), strict=True)
    )
    return first, second


_BEHIND = np.diag([-1.0, 1.0, -1.0])


def _proper(matrix: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "3 3"]:
    """The rotation next to a matrix; the identity where it is none at all."""
    u, _, v = np.linalg.svd(np.nan_to_num(matrix))
    return u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v


def _looked_at(
    rotation: Float[np.ndarray, "3 3"], middle: Float[np.ndarray, "3"], distance: float
) -> Float[np.ndarray, "4 4"]:
    return geometry.transform(rotation, np.array([0, 0, distance]) - rotation @ middle)


def _side(model: Model, camera: Camera, pose: np.ndarray, rendering, centers: Float[np.ndarray, "n 3"]) -> Side:
    depth = rendering.depth
    v, u = np.nonzero(depth)
    points = geometry.unproject(camera.K, np.stack([u, v], axis=1).astype(float), depth[v, u].astype(float))
    in_model = geometry.transform_points(geometry.inverse(pose), points)
    ids = np.full(depth.shape, -1)
    ids[v, u] = nearest_center(centers, in_model) if len(centers) else 0
    normals = rendering.expand(rendering.surface.normals) @ pose[:3, :3].T
    facing = np.abs(normals @ np.array([0.25, -0.35, -0.9]))
    shade = np.clip(AMBIENT + (1 - AMBIENT) * facing, 0, 1)
    return Side(camera, pose, depth, ids, np.where(_seams(ids), SEAM * shade, shade))


def _seams(ids: Int[np.ndarray, "s s"]) -> Bool[np.ndarray, "s s"]:
    """Pixels whose right or lower neighbour belongs to another fragment."""
    seams = np.zeros(ids.shape, bool)
    seams[:, :-1] |= (ids[:, :-1] != ids[:, 1:]) & (ids[:, 1:] >= 0)
    seams[:-1] |= (ids[:-1] != ids[1:]) & (ids[1:] >= 0)
    return seams & (ids >= 0)


def with_points(
    side: Side, picture: UInt8[np.ndarray, "s s 4"], points: Float[np.ndarray, "k 3"], weights: Float[np.ndarray, "k"]
) -> UInt8[np.ndarray, "s s 4"]:
    """The picture with white dots at points that can be seen, larger for larger weights of 0..1."""
    colors = [(255, 255, 255)] * len(points)
    return _dotted(side, picture, points, (2.5 + 2.5 * weights).tolist(), colors)


def with_triplet(
    side: Side, picture: UInt8[np.ndarray, "s s 4"], points: Float[np.ndarray, "3 3"]
) -> UInt8[np.ndarray, "s s 4"]:
    """The picture with the points of a sampled triplet, in its three colours."""
    return _dotted(side, picture, points, [6.0] * 3, list(TRIPLET))


def _dotted(side: Side, picture: np.ndarray, points: np.ndarray, radii: list[float], colors: list) -> np.ndarray:
    result = np.ascontiguousarray(picture)
    pixels, visible = side.seen(points)
    for (u, v), shown, radius, color in zip(pixels, visible, radii, colors, strict=True):
        if shown and np.isfinite((u, v)).all() and 0 <= u < SIZE and 0 <= v < SIZE:
            at = (round(u * 16), round(v * 16))  # OpenCV's fractions of a pixel
            cv2.circle(result, at, round((radius + 1.5) * 16), (15, 15, 15, 255), -1, cv2.LINE_AA, 4)
            cv2.circle(result, at, round(radius * 16), (*color, 255), -1, cv2.LINE_AA, 4)
    return result
