"""How much of an object an image shows, counted by exact ray casting as BOP counts it.

The silhouette is that of the object alone, also where it reaches beyond the image, on a canvas of three times the
image's width and height. What lies outside the image is hidden. Pixel centres are at integer coordinates.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from pipeline.ray_casting import Box
from pipeline.rendering import Rendering, render, render_scene
from pipeline.scene import Camera, Model

Posed = tuple[Model, Float[np.ndarray, "4 4"]]
"""A model and its `camera_from_model`."""


def visible_fraction(things: Sequence[Posed], index: int, camera: Camera) -> float:
    """Visible share, 0..1, of one of the things; only the part of the image about it is rendered."""
    model, pose = things[index]
    alone = render(model, _canvas(camera), pose, pixel_center=0.0)
    count = int(np.count_nonzero(alone.mask_crop))
    window = _inside(alone.box, camera)
    if not count or not window.area:
        return 0.0
    part = render_scene(things, _cut(camera, window), pixel_center=0.0)
    return int(np.count_nonzero(part.instance_ids == index)) / count


def silhouette_pixels(posed: Posed, camera: Camera, inside: Rendering) -> int:
    """Pixels of the whole silhouette on the canvas; `inside` is the object alone in the image, which is not repeated."""
    count = int(np.count_nonzero(inside.mask_crop))
    x0, y0, x1, y1 = inside.box
    if 0 < x0 < x1 < camera.width and 0 < y0 < y1 < camera.height:
        return count
    alone = render(*_on_canvas(posed, camera), pixel_center=0.0)
    beyond = alone.mask_crop.copy()
    window = _inside(alone.box, camera)
    top, left = window.y0 + camera.height - alone.box.y0, window.x0 + camera.width - alone.box.x0
    beyond[top : top + window.shape[0], left : left + window.shape[1]] = False
    return count + int(np.count_nonzero(beyond))


def _on_canvas(posed: Posed, camera: Camera) -> tuple[Model, Camera, Float[np.ndarray, "4 4"]]:
    model, pose = posed
    return model, _canvas(camera), pose


def _canvas(camera: Camera) -> Camera:
    """A camera whose image has the given one's in its middle."""
    return _shifted(camera, camera.width, camera.height, 3 * camera.width, 3 * camera.height)


def _cut(camera: Camera, window: Box) -> Camera:
    """A camera that sees a window of the image."""
    return _shifted(camera, -window.x0, -window.y0, window.x1 - window.x0, window.y1 - window.y0)


def _shifted(camera: Camera, right: int, down: int, width: int, height: int) -> Camera:
    shift = np.array([[1.0, 0.0, right], [0.0, 1.0, down], [0.0, 0.0, 1.0]])
    return Camera(shift @ camera.K, width, height)


def _inside(box: Box, camera: Camera) -> Box:
    """The part of a box of the canvas that lies in the image, in the image's coordinates; possibly empty."""
    x0, x1 = (min(max(x - camera.width, 0), camera.width) for x in (box.x0, box.x1))
    y0, y1 = (min(max(y - camera.height, 0), camera.height) for y in (box.y0, box.y1))
    return Box(x0, y0, x1, y1)
