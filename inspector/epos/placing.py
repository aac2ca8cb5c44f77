"""Where things stand in 3D: a copy of the model beside the image, as large as the image is high and turned as its pose."""

import numpy as np
from jaxtyping import Float

from inspector.epos.row import EposRow
from inspector.planes import FRUSTUM, depths_of, image_depth
from inspector.selection import Selection
from pipeline import geometry
from pipeline.scene import Camera, Model

SIZE = 0.85
"""Diameter of the copy in heights of the image."""
GAP = 0.3
"""Between image and copy, in heights of the image."""
TURNED = np.radians(40)
"""How far the side of the copy that the camera sees is turned towards the image, so that lines reach it from the front."""
FROM = np.array([-0.5, -0.25, -0.83]) / np.linalg.norm([-0.5, -0.25, -0.83])
"""From where image and copy are looked at: from before them, a little from the left and above."""
FILLED = 0.92
"""Share of the window that both take at most."""
FIELD_OF_VIEW = np.radians(45)
"""Vertical, of the browser's camera in 3D."""


def copy_from(row: EposRow, selection: Selection) -> Float[np.ndarray, "4 4"] | None:
    """camera_from_model of the copy, with its scale; None without a model."""
    model = row.model
    if model is None:
        return None
    camera = row.frame.camera
    middle, width, height = _image_plane(camera, image_depth(row.frame, selection))
    size = SIZE * height
    scale = size / max(model.diameter, 1e-9)
    c, s = np.cos(TURNED), np.sin(TURNED)
    linear = scale * np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ rotation_of(row)
    center = middle + np.array([width / 2 + GAP * height + size / 2, 0, 0])
    return geometry.transform(linear, center - linear @ _center(model))


def rotation_of(row: EposRow) -> Float[np.ndarray, "3 3"]:
    """How the model is turned in its pictures: as the row's estimate or ground truth has it, else slightly from above."""
    for role in ("estimate", "ground_truth"):
        pose = row.frame.pose(role)
        if pose is not None and np.isfinite(pose).all():
            return pose[:3, :3]
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("xy", [-110, 30], degrees=True).as_matrix()


def eye_beside(row: EposRow, window: tuple[int, int]) -> tuple[float, ...]:
    """Position and target of a browser's camera that sees the image and the copy side by side, as near as they fit.

    `window` is the size of the picture in CSS pixels.
    """
    middle, width, height = _image_plane(row.frame.camera, FRUSTUM * depths_of(row.frame)[0])
    beside = (GAP + SIZE) * height
    target = middle + np.array([beside / 2, 0, 0])
    half = np.array([width + beside, height]) / 2
    corners = np.array([[x, y, 0.0] for x in (-half[0], half[0]) for y in (-half[1], half[1])])
    distances = np.geomspace(half[0], 20 * half[0], 60)
    away = next((d for d in distances if _seen(corners - d * FROM, window)), distances[-1])
    return tuple(float(x) for x in (*(target + away * FROM), *target))


def _seen(points: Float[np.ndarray, "n 3"], window: tuple[int, int]) -> bool:
    """Whether a camera sees points that are given from its place, when it looks along the opposite of `FROM`."""
    right = np.cross([0, 1.0, 0], -FROM)
    right /= np.linalg.norm(right)
    down = np.cross(-FROM, right)
    along = points @ -FROM
    limit = FILLED * np.tan(FIELD_OF_VIEW / 2)
    wide, high = np.abs(points @ right) / along, np.abs(points @ down) / along
    return bool((along > 0).all() and wide.max() < limit * window[0] / window[1] and high.max() < limit)


def _image_plane(camera: Camera, depth: float) -> tuple[Float[np.ndarray, "3"], float, float]:
    """Middle, width and height (metres) of the image on the plane at a depth."""
    center = np.array([(camera.width - 1) / 2, (camera.height - 1) / 2])
    middle = geometry.unproject(camera.K, center, np.array(depth))
    return middle, camera.width * depth / camera.K[0, 0], camera.height * depth / camera.K[1, 1]


def _center(model: Model) -> Float[np.ndarray, "3"]:
    return (model.vertices.min(axis=0) + model.vertices.max(axis=0)) / 2
