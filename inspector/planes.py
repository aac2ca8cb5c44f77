"""Where pictures and marks stand so that the browser shows them over the image: planes of the camera, far to near."""

from collections.abc import Callable, Hashable

import numpy as np
from jaxtyping import Float, UInt8

from inspector.frame import ROLES, Frame
from inspector.nodes import Picture
from inspector.selection import Selection
from pipeline import geometry

BEHIND = 5.0
"""Metres; in the image view the image stands at least this far away, behind everything."""

IN_FRONT = 0.2
"""Metres; in the image view marks stand this near, before everything."""

FRUSTUM = 0.15
"""Length of the camera's frustum in 3D, as a share of the distance to the object."""


def depths_of(frame: Frame) -> tuple[float, float]:
    """Depths (metres) of the nearest and the farthest pose of the row; 1 m without any."""
    poses = [pose for role in ROLES if (pose := frame.pose(role)) is not None and np.isfinite(pose).all()]
    depths = [float(pose[2, 3]) for pose in poses if pose[2, 3] > 0] or [1.0]
    return min(depths), max(depths)


def image_depth(frame: Frame, selection: Selection) -> float:
    """Depth (metres) of the plane that carries the image: behind everything in 2D, at the small frustum's end in 3D."""
    nearest, farthest = depths_of(frame)
    return max(BEHIND, 2 * farthest) if selection.view == "image" else FRUSTUM * nearest


def picture(
    frame: Frame,
    selection: Selection,
    name: str,
    token: Hashable,
    pixels: Callable[[], UInt8[np.ndarray, "h w c"]],
    level: int,
    edges: tuple[float, float, float, float] | None = None,
    about: tuple = (),
) -> Picture:
    """A layer over the image; layers of a higher level hide those of a lower one.

    The browser draws transparent planes in the order of their centres' distance. Whole images have the same centre, so
    a little nearer is enough; parts lie off the axis and have to be nearer by a factor that no angle makes up for.

    Args:
        frame: The row.
        selection: Whether the image or the scene is seen.
        name: Of the node.
        token: With what the layer is about, decides whether it is sent again.
        pixels: Makes the layer when it is sent.
        level: 0 for the image itself.
        edges: Left, top, right, bottom in image pixels, where the layer covers a part of the image.
        about: What the layer is about; by default the row with its methods.

    """
    nearer = 1 - 2e-5 * level if edges is None else 0.5**level
    about = about or (frame.row, frame.method, frame.compare, frame.generations)
    return Picture((*about, name, token), pixels, frame.camera, image_depth(frame, selection) * nearer, edges)


def marks(frame: Frame, selection: Selection, pixels: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 3"]:
    """Points (camera frame) that are seen at pixels (u, v) of the image: before all in 2D, on the image plane in 3D."""
    depth = IN_FRONT if selection.view == "image" else 0.999 * image_depth(frame, selection)
    flat = pixels.reshape(-1, 2)
    return geometry.unproject(frame.camera.K, flat, np.full(len(flat), depth)).reshape(*pixels.shape[:-1], 3)


def brought_to_front(points: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 3"]:
    """Points (camera frame, before the camera) pulled along their rays, so that in 2D nothing hides them."""
    return points / points[..., 2:] * IN_FRONT
