"""The camera of one browser: locked to the image's centre of projection in 2D, free in 3D."""

import numpy as np
import viser
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from inspector.selection import NO_EYE
from inspector.viewport import LOOK_DISTANCE, Viewport, fitting_scale, image_center
from pipeline.scene import Camera

FOV_3D = np.radians(45)


class Navigation:
    """Moves a browser's camera; zoom and pan are its state in 2D, kept as shares of the image."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self._camera = client.camera
        self._client = client
        self._viewport: Viewport | None = None
        self._window: tuple[int, int] | None = None

    @property
    def window(self) -> tuple[int, int]:
        """Width and height of the window in CSS pixels: as the page said last, else as viser heard it."""
        return self._window or (max(self._camera.image_width, 1), max(self._camera.image_height, 1))

    def resize(self, width: int, height: int) -> None:
        """Take note of a new size of the window; the image has to be shown again to fit."""
        self._window = (min(max(width, 1), 20_000), min(max(height, 1), 20_000))

    @property
    def viewport(self) -> Viewport | None:
        """How the image is shown; None in 3D."""
        return self._viewport

    def show_image(self, camera: Camera, zoom: float, center: tuple[float, float]) -> None:
        """Look at the image so that it fills the window `zoom` times; `center` is a share of width and height."""
        pixel = (center[0] * (camera.width - 1), center[1] * (camera.height - 1))
        self._viewport = Viewport(camera, *self.window, zoom, pixel)
        self._lock()

    def show_scene(self, target: Float[np.ndarray, "3"], eye: tuple[float, ...] = NO_EYE) -> None:
        """Look at a point of the camera frame, free to move from there.

        Without an `eye` (position and point looked at) from beside and above the image's camera.
        """
        self._viewport = None
        sideways = Rotation.from_euler("yx", [25, -12], degrees=True)
        position = target + sideways.apply(-target) * 0.9
        seen = np.array(eye)
        if 1e-3 < np.linalg.norm(seen[3:] - seen[:3]) < 1e3:  # else it is NO_EYE, or an address made it up
            position, target = seen[:3], seen[3:]
        with self._client.atomic():
            self._limit_orbit(0.01, 1e3)
            self._camera.up_direction = (0.0, -1.0, 0.0)
            self._camera.fov = FOV_3D
            self._camera.position = position
            self._camera.look_at = target

    def eye(self) -> tuple[float, ...] | None:
        """Position of the camera and the point that it looks at in 3D, to the millimetre; None in 2D."""
        if self._viewport is not None:
            return None
        return tuple(float(x) for x in np.round([*self._camera.position, *self._camera.look_at], 3))

    def hold(self) -> None:
        """In 2D, undo what moved the camera (viser's own keys and gestures)."""
        if self._viewport is None:
            return
        moved = np.abs(self._camera.position).max() > 1e-5
        turned = np.abs(self._camera.look_at - self._viewport.look_at).max() > 1e-6
        if moved or turned:
            self._lock()

    def zoomed(self, x: float, y: float, factor: float) -> tuple[float, tuple[float, float]]:
        """Zoom and centre after zooming by a factor about a point of the window (shares 0..1)."""
        assert self._viewport is not None
        view = self._viewport
        zoom = float(np.clip(view.zoom * np.clip(factor, 0.01, 100), 0.5, 60.0))
        fixed, center = np.array(view.pixel_at(x, y)), np.array(view.center)
        return zoom, self._share(fixed + (center - fixed) * view.zoom / zoom)

    def panned(self, dx: float, dy: float) -> tuple[float, float]:
        """Centre after dragging the image by CSS pixels."""
        assert self._viewport is not None
        moved = np.clip([dx, dy], -1e5, 1e5) / self._viewport.scale
        return self._share(np.array(self._viewport.center) - moved)

    def around(self, camera: Camera, box: tuple[float, float, float, float]) -> tuple[float, tuple[float, float]]:
        """Zoom and centre that show a box (u0, v0, u1, v1) of the image with some room around it."""
        width, height = self.window
        fit = fitting_scale(camera, width, height)
        size = np.maximum([box[2] - box[0], box[3] - box[1]], 8)
        zoom = float(np.clip(0.6 * min(width / size[0], height / size[1]) / fit, 1.0, 60.0))
        middle = ((box[0] + box[2]) / 2, (box[1] + box[3]) / 2)
        return zoom, (middle[0] / (camera.width - 1), middle[1] / (camera.height - 1))

    def ray(self, x: float, y: float) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
        """Origin and direction, in the camera frame of the image, of what is seen at a point of the window."""
        if self._viewport is not None:
            return np.zeros(3), self._viewport.camera_from_view @ self._viewport.ray_in_view(x, y)
        half = np.tan(self._camera.fov / 2)
        direction = np.array([(2 * x - 1) * half * self.window[0] / self.window[1], (2 * y - 1) * half, 1.0])
        return self._camera.position, Rotation.from_quat(self._camera.wxyz, scalar_first=True).apply(direction)

    def _lock(self) -> None:
        view = self._viewport
        assert view is not None
        with self._client.atomic():
            self._limit_orbit(LOOK_DISTANCE, LOOK_DISTANCE)
            self._camera.up_direction = -view.camera_from_view[:, 1]
            self._camera.fov = view.fov
            self._camera.position = (0.0, 0.0, 0.0)
            self._camera.look_at = view.look_at

    def _limit_orbit(self, nearest: float, farthest: float) -> None:
        self._camera.min_orbit_distance = min(nearest, self._camera.min_orbit_distance)  # viser wants them in order
        self._camera.max_orbit_distance = farthest
        self._camera.min_orbit_distance = nearest

    def _share(self, pixel: np.ndarray) -> tuple[float, float]:
        """A pixel as a share of the image's width and height, held within the image."""
        assert self._viewport is not None
        extent = 2 * np.array(image_center(self._viewport.camera))
        u, v = np.clip(np.nan_to_num(pixel / extent, nan=0.5), 0, 1)
        return float(u), float(v)
