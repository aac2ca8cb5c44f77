"""Colour pictures of a model at a pose: by OpenGL where it works, else by ray casting.

Both take vertex colours, else the texture, else gray, and light it in the same way; edges are smoothed by GL only.
"""

from typing import Literal

import numpy as np
from jaxtyping import Float

from pipeline.gl_rendering import GL, GlError, draw
from pipeline.ray_casting import visible_box
from pipeline.scene import Camera, Model
from pipeline.shading import ColorRendering, shade

__all__ = ["Backend", "ColorRendering", "GlError", "gl_available", "render_color"]

Backend = Literal["auto", "gl", "raycast"]


def render_color(
    model: Model,
    camera: Camera,
    camera_from_model: Float[np.ndarray, "4 4"],
    pixel_center: float = 0.0,
    backend: Backend = "auto",
) -> ColorRendering:
    """Draw a model in colour. Pixel (c, r) shows what is at (c + pixel_center, r + pixel_center): 0 fits overlays.

    "auto" takes GL where it works and else ray casting; a pose that is not finite shows nothing.

    Raises:
        GlError: GL was demanded and does not work.

    """
    in_sight = visible_box(model, camera, camera_from_model, pixel_center).area > 0
    if in_sight and backend != "raycast":
        try:
            return GL.run(lambda: draw(model, camera, camera_from_model, pixel_center))
        except GlError:
            if backend == "gl":
                raise
    return shade(model, camera, camera_from_model, pixel_center)


def gl_available() -> bool:
    """Tell whether GL works; the first call takes a second or two to try it out."""
    return GL.available()
