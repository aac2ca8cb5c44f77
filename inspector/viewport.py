"""Where the browser's camera must look so that an image fills its window, and which pixel a point of the window shows.

The picture is a plane in the scene, placed where the image's own camera sees it, and the browser's camera stands in
the centre of projection. So meshes in the scene stay aligned with the image at any zoom; zooming narrows the field of
view and panning turns the camera.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.scene import Camera

LOOK_DISTANCE = 1e-3
"""Metres between the browser's camera and the point it looks at; small, so that viser's orbiting hardly moves it."""


class Viewport(NamedTuple):
    """How an image is shown in a window."""

    camera: Camera
    window_width: int
    """CSS pixels."""
    window_height: int
    """CSS pixels."""
    zoom: float
    """1 fits the whole image into the window."""
    center: tuple[float, float]
    """Image pixel (u, v) in the middle of the window."""

    @property
    def scale(self) -> float:
        """CSS pixels per image pixel, in the middle of the window."""
        return max(fitting_scale(self.camera, self.window_width, self.window_height) * self.zoom, 1e-6)

    @property
    def fov(self) -> float:
        """Vertical field of view of the browser's camera, radians."""
        return 2 * float(np.arctan(self.window_height / (2 * self.camera.K[1, 1] * self.scale)))

    @property
    def look_at(self) -> Float[np.ndarray, "3"]:
        """Point for the browser's camera at the origin to look at, camera frame."""
        return self.camera_from_view[:, 2] * LOOK_DISTANCE

    @property
    def camera_from_view(self) -> Float[np.ndarray, "3 3"]:
        """Rotation of the browser's camera in the image's camera frame (both x right, y down, z forward)."""
        return _looking_at(self.camera, self.center)

    def pixel_at(self, x: float, y: float) -> tuple[float, float]:
        """Image pixel (u, v) seen at a point of the window given as shares 0..1 of its width and height."""
        u, v, w = self.camera.K @ (self.camera_from_view @ self.ray_in_view(x, y))
        return (float(u / w), float(v / w)) if w > 1e-9 else (float("nan"), float("nan"))

    def window_at(self, u: float, v: float) -> tuple[float, float]:
        """Point of the window, as shares 0..1, at which an image pixel is seen; the inverse of `pixel_at`."""
        x, y, z = self.camera_from_view.T @ np.linalg.solve(self.camera.K, (u, v, 1.0))
        half = np.tan(self.fov / 2)
        return 0.5 + x / z / half / 2 * self.window_height / self.window_width, 0.5 + y / z / half / 2

    def ray_in_view(self, x: float, y: float) -> Float[np.ndarray, "3"]:
        """Direction seen at a point of the window, in the browser camera's frame (z = 1)."""
        half = np.tan(self.fov / 2)
        aspect = self.window_width / self.window_height
        return np.array([(2 * x - 1) * half * aspect, (2 * y - 1) * half, 1.0])


def fitting_scale(camera: Camera, window_width: int, window_height: int) -> float:
    """CSS pixels per image pixel at which the whole image just fits into the window."""
    w, h = camera.width - 0.5, camera.height - 0.5
    corners = np.array([[-0.5, -0.5, 1], [w, -0.5, 1], [w, h, 1], [-0.5, h, 1]])
    x, y, z = _looking_at(camera, image_center(camera)).T @ np.linalg.solve(camera.K, corners.T)
    half_width, half_height = np.abs(x / z).max(), np.abs(y / z).max()  # at depth 1
    return float(min(window_width / half_width, window_height / half_height) / (2 * camera.K[1, 1]))


def _looking_at(camera: Camera, pixel: tuple[float, float]) -> Float[np.ndarray, "3 3"]:
    """The smallest rotation, in the camera's frame, after which a camera in the same place looks at a pixel.

    So the image's edges stay as upright and level in the window as they can.
    """
    x, y, _ = forward = _unit(np.linalg.solve(camera.K, (*pixel, 1.0)))
    turn = np.array([-y, x, 0.0])  # axis times sine of the angle, from the z axis to `forward`
    return Rotation.from_rotvec(turn * (np.arccos(forward[2]) / (np.linalg.norm(turn) or 1.0))).as_matrix()


def _unit(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    return vector / np.linalg.norm(vector)


def image_center(camera: Camera) -> tuple[float, float]:
    """Middle of the image in pixels (centres of pixels are integers)."""
    return (camera.width - 1) / 2, (camera.height - 1) / 2


def plane_of(
    camera: Camera, z: float, edges: tuple[float, float, float, float] | None = None
) -> tuple[float, float, tuple[float, float, float]]:
    """Width, height and centre (camera frame, metres) of the plane at depth `z` that the image fills exactly.

    With `edges` (left, top, right, bottom, in pixels) that of a part of the image.
    """
    fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
    left, top, right, bottom = edges or (-0.5, -0.5, camera.width - 0.5, camera.height - 0.5)
    u, v = (left + right) / 2, (top + bottom) / 2
    return (right - left) * z / fx, (bottom - top) * z / fy, ((u - cx) * z / fx, (v - cy) * z / fy, z)
