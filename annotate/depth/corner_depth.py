"""The measured depth at a corner between pixels: of the plane about it, never across an edge."""

import numpy as np
from jaxtyping import Float

RADIUS_PX = 5
"""Half the side of the window that a plane is fitted to."""
LEAST_MEASURED = 0.7
"""Share of the window's pixels."""
FLAT = 0.004
"""Share of the depth within which measurements lie on the plane: steps of structured light at 1 m are 3 mm."""
LEAST_ON_PLANE = 0.9
"""Share of the measurements; where fewer lie on one plane there is an edge in the window."""
STEEPEST = 0.03
"""Share of its depth by which a surface may change from pixel to pixel; beyond, the angle of view is too flat."""
ROUNDS = 4


def corner_depths(
    depth: Float[np.ndarray, "h w"], pixels: Float[np.ndarray, "n 2"], radius_px: int = RADIUS_PX
) -> Float[np.ndarray, "n"]:
    """Depth in metres at points of flat surfaces, NaN where it cannot be told.

    A plane in space is linear in 1 / depth over the image; it is fitted to the window about each point by robust least
    squares, so that holes and single wrong pixels do no harm, and steps of the measurement average out. A window with
    an edge, with too many holes or beyond the image gives no depth.
    """
    return np.array([_depth_at(depth, pixel, radius_px) for pixel in pixels], float).reshape(len(pixels))


def _depth_at(depth: Float[np.ndarray, "h w"], pixel: Float[np.ndarray, "2"], radius: int) -> float:
    x, y = (round(value) for value in pixel.tolist()) if np.isfinite(pixel).all() else (-1, -1)
    if not (radius <= x < depth.shape[1] - radius and radius <= y < depth.shape[0] - radius):
        return float("nan")
    window = depth[y - radius : y + radius + 1, x - radius : x + radius + 1].astype(np.float64)
    v, u = np.nonzero(window > 0)
    if len(v) < LEAST_MEASURED * window.size:
        return float("nan")
    measured = window[v, u]
    design = np.column_stack([np.ones(len(u)), u + (x - radius) - pixel[0], v + (y - radius) - pixel[1]])
    return _on_plane(design, measured)


def _on_plane(design: Float[np.ndarray, "m 3"], measured: Float[np.ndarray, "m"]) -> float:
    """Depth where the plane's other coordinates are 0; NaN where the measurements are of no single plane."""
    inverse = 1.0 / measured
    middle = np.median(inverse)
    weight = np.abs(inverse - middle) < 6 * FLAT * middle + STEEPEST * middle * 2
    plane = np.array([middle, 0.0, 0.0])
    for _ in range(ROUNDS):
        if weight.sum() < 3:
            return float("nan")
        plane = np.linalg.lstsq(design * weight[:, None], inverse * weight, rcond=None)[0]
        weight = np.abs(inverse - design @ plane) < FLAT * middle
    flat = weight.mean() >= LEAST_ON_PLANE and np.hypot(plane[1], plane[2]) < STEEPEST * plane[0]
    return float(1.0 / plane[0]) if flat and plane[0] > 0 else float("nan")
