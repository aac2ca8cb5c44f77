"""Small things to look for: an asymmetric part, a camera, and images of it on a board."""

import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.geometry import transform
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.rendering import render_scene
from pipeline.scene import Camera, Image, ImageKey, Model
from pipeline.shading import shade

CAMERA = Camera(np.array([[300.0, 0, 118.0], [0, 300.0, 91.0], [0, 0, 1]]), width=240, height=180)
KEY = ImageKey(1, 0)
COARSE = HashMatchConfig(angle_step_deg=30, in_plane_limit_deg=30, triplets=600, scales_up=2, scales_down=2, threads=1)
"""108 templates; enough where the pose is one of theirs."""


def cuboid(low: tuple[float, ...], high: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    corners = np.array(
        [[(low, high)[i][0], (low, high)[j][1], (low, high)[k][2]] for i in (0, 1) for j in (0, 1) for k in (0, 1)]
    )
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return corners, np.array([triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))])


def model_of(
    *cuboids: tuple[tuple[float, ...], tuple[float, ...]], obj_id: int = 1, color: tuple[int, ...] | None
) -> Model:
    parts = [cuboid(low, high) for low, high in cuboids]
    vertices = np.concatenate([corners for corners, _ in parts])
    faces = np.concatenate([faces + 8 * i for i, (_, faces) in enumerate(parts)]).astype(np.int32)
    diameter = float(np.linalg.norm(vertices[:, None] - vertices, axis=-1).max())
    colors = None if color is None else np.tile(np.array(color, np.uint8), (len(vertices), 1))
    return Model(obj_id, vertices, faces, diameter, colors=colors)


def part(color: tuple[int, ...] | None = (200, 60, 40)) -> Model:
    """A plate with two blocks of different height; no two views of it are alike."""
    blocks = (((-0.05, -0.03, -0.02), (0.05, 0.03, 0.0)), ((-0.05, -0.03, 0.0), (-0.02, 0.03, 0.035)))
    return model_of(*blocks, ((0.02, 0.0, 0.0), (0.045, 0.025, 0.02)), color=color)


def other_part() -> Model:
    """A tall block with a foot, in another colour."""
    return model_of(((-0.02, -0.02, -0.04), (0.02, 0.02, 0.04)), ((-0.04, -0.02, -0.04), (0.02, 0.02, -0.025)), obj_id=2,
                    color=(40, 90, 200))  # fmt: skip


def board() -> Model:
    return model_of(((-1.0, -1.0, -0.01), (1.0, 1.0, 0.0)), obj_id=99, color=(120, 125, 120))


def looking_at(distance: float, angles: tuple[float, float, float], x: float = 0.0, y: float = 0.0) -> np.ndarray:
    return transform(Rotation.from_euler("xyz", angles).as_matrix(), np.array([x, y, distance]))


def image_of(
    *seen: tuple[Model, np.ndarray], background: float = 0.9, camera: Camera = CAMERA, noise: float = 0.0
) -> Image:
    """An image of models before a board that faces the camera."""
    world = [(board(), transform(np.eye(3), np.array([0, 0, background]))), *seen]
    rendered = render_scene(world, camera, pixel_center=0.0)
    rgb = np.zeros((camera.height, camera.width, 3), np.uint8)
    for i, (model, pose) in enumerate(world):
        visible = rendered.instance_ids == i
        rgb[visible] = shade(model, camera, pose, 0.0).rgb[visible]
    depth = rendered.depth
    if noise:
        depth = depth + np.random.default_rng(0).normal(0, noise, depth.shape).astype(np.float32)
    return Image(KEY, camera, rgb, depth.astype(np.float32))
