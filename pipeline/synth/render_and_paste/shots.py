"""What the camera sees of one object: its place in the image, its projection for OpenGL, and depth from GL's buffer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Float32

from pipeline.model_cache import convex_hull
from pipeline.ray_casting import NEAR, Box, visible_box
from pipeline.scene import Camera, Model
from pipeline.synth.render_and_paste.lights import Light


@dataclass(frozen=True, eq=False)
class Painted:
    """An object as it is to be drawn."""

    model: Model
    camera_from_model: Float[np.ndarray, "4 4"]
    """Metres."""
    plain: tuple[float, float, float] | None = None
    """Linear RGB in place of the model's own colours."""
    gloss: float = 0.1
    """Strength of highlights."""
    sharpness: float = 30.0
    """Exponent of highlights (Blinn-Phong)."""


class Shot(NamedTuple):
    """An object before a camera."""

    item: Painted
    box: Box
    """Pixels that can show it; empty where it is out of sight."""
    near: float
    """Metres along z: nothing of the object that can be seen is nearer."""
    far: float


def shot_of(item: Painted, camera: Camera) -> Shot:
    """Place an object in the image, pixel centres being at integer coordinates."""
    box = visible_box(item.model, camera, item.camera_from_model, 0.0)
    hull = item.model.vertices[convex_hull(item.model)]
    z = hull @ item.camera_from_model[2, :3] + item.camera_from_model[2, 3]
    return Shot(item, box, max(0.95 * float(z.min()), NEAR), 1.05 * float(z.max()))


def clip_from_camera(shot: Shot, camera: Camera) -> Float32[np.ndarray, "4 4"]:
    """Pinhole projection of the whole image to GL's cube; GL samples pixel c at c + 0.5."""
    near, far = shot.near, shot.far
    projection = np.zeros((4, 4), np.float32)
    projection[0, :3] = 2.0 * camera.K[0] / camera.width
    projection[1, :3] = 2.0 * camera.K[1] / camera.height
    projection[:2, 2] += [1.0 / camera.width - 1.0, 1.0 / camera.height - 1.0]
    projection[2, 2:] = (far + near) / (far - near), -2.0 * far * near / (far - near)
    projection[3, 2] = 1.0
    return projection


def depth_from_buffer(buffer: Float32[np.ndarray, "h w"], shot: Shot) -> Float32[np.ndarray, "h w"]:
    """Metres along z of the values 0..1 of GL's depth buffer, 0 where nothing was drawn."""
    depth = shot.near * shot.far / (shot.far - buffer.astype(np.float64) * (shot.far - shot.near))
    return np.where(buffer < 1.0, depth, 0.0).astype(np.float32)


OBJECT_UNIFORMS = (
    *("clip_from_camera", "camera_from_model", "normal_camera_from_model"),
    *("plain", "gloss", "sharpness", "ray_of_pixel"),
)
LIGHT_UNIFORMS = ("up", "from_above", "from_below", "lamps", "lamp_directions", "lamp_colors")


def set_object(gl: Any, places: dict[str, int], shot: Shot, camera: Camera) -> None:
    """Hand an object's uniforms to the program in use."""
    item, pose = shot.item, shot.item.camera_from_model
    _matrix(gl.glUniformMatrix4fv, places["clip_from_camera"], clip_from_camera(shot, camera))
    _matrix(gl.glUniformMatrix4fv, places["camera_from_model"], pose)
    _matrix(gl.glUniformMatrix3fv, places["normal_camera_from_model"], np.linalg.inv(pose[:3, :3]).T)
    gl.glUniform4f(places["plain"], *(item.plain or (0.0, 0.0, 0.0)), float(item.plain is not None))
    gl.glUniform1f(places["gloss"], item.gloss)
    gl.glUniform1f(places["sharpness"], item.sharpness)
    (fx, _, cx), (_, fy, cy), _ = camera.K
    first = shot.box.x0 - 0.5 - cx, shot.box.y0 - 0.5 - cy
    gl.glUniform4f(places["ray_of_pixel"], 1.0 / fx, 1.0 / fy, first[0] / fx, first[1] / fy)


def set_light(gl: Any, places: dict[str, int], light: Light) -> None:
    """Hand the light's uniforms to the program in use."""
    for name in ("up", "from_above", "from_below"):
        gl.glUniform3fv(places[name], 1, getattr(light, name).astype(np.float32))
    count = len(light.directions)
    gl.glUniform1i(places["lamps"], count)
    if count:
        gl.glUniform3fv(places["lamp_directions"], count, light.directions.astype(np.float32))
        gl.glUniform3fv(places["lamp_colors"], count, light.colors.astype(np.float32))


def _matrix(function: Any, place: int, matrix: np.ndarray) -> None:
    function(place, 1, True, np.ascontiguousarray(matrix, np.float32))  # rows first, as NumPy has them
