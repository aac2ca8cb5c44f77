"""A picture of the current view for a slide or a colleague."""

import cv2
import numpy as np
import viser
from jaxtyping import UInt8

from inspector.frame import Frame
from inspector.nodes import Drawing, Picture
from inspector.selection import Selection

RENDER_SIZE = (1200, 1600)
"""Height and width of pictures of the 3D view."""


def snapshot(
    client: viser.ClientHandle, frame: Frame, selection: Selection, drawing: Drawing
) -> UInt8[np.ndarray, "h w 3"]:
    """Return the view as RGB: in 2D the whole image with its layers at full resolution, in 3D what the browser draws."""
    models_in_3d = any(name.startswith("models/") for name in drawing.nodes)
    if selection.view == "scene" or models_in_3d:
        return client.get_render(*RENDER_SIZE, transport_format="png")[..., :3]
    pictures = [node for node in drawing.nodes.values() if isinstance(node, Picture)]
    size = (frame.fine_camera.width, frame.fine_camera.height)
    canvas = np.zeros((size[1], size[0], 3), np.float32)
    for picture in sorted(pictures, key=lambda p: -p.z):
        pixels = picture.pixels()
        part = canvas
        if picture.edges is not None:
            x, y = (round((edge + 0.5) * frame.fineness) for edge in picture.edges[:2])
            part = canvas[y : y + pixels.shape[0], x : x + pixels.shape[1]]
        pixels = cv2.resize(pixels, part.shape[1::-1], interpolation=cv2.INTER_NEAREST)
        alpha = pixels[..., 3:].astype(np.float32) / 255 if pixels.shape[2] == 4 else np.float32(1)
        part[:] = part * (1 - alpha) + pixels[..., :3] * alpha
    return canvas.round().astype(np.uint8)
