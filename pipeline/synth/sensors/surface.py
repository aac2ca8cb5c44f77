"""What a depth image tells about its surfaces: angle of view, depth steps, shadows of a projector.

All of it is computed from inverse depth, which is linear in the pixel coordinates on a plane, so planes give exact
results in any perspective. Depth is in metres along z, 0 where there is nothing, pixel centres at integers.
"""

import numpy as np
from jaxtyping import Bool, Float, Float32

SHADOW_TOLERANCE = 0.02
"""Relative depth by which a surface must lie behind another to be in its shadow: of less, a shadow would be narrower
than a pixel with the baselines and focal lengths of such sensors."""


def inverse_depth(depth: Float[np.ndarray, "h w"]) -> Float32[np.ndarray, "h w"]:
    """1 / depth, 0 where there is nothing: as if it were infinitely far."""
    return np.divide(1.0, depth, out=np.zeros(depth.shape, np.float32), where=depth > 0, casting="same_kind")


def incidence(depth: Float[np.ndarray, "h w"], K: Float[np.ndarray, "3 3"]) -> Float32[np.ndarray, "h w"]:
    """Angle in radians, 0..pi/2, between the surface normal and the ray of view; pi/2 where there is nothing.

    Beside a depth step the normal is that of the pixel's own side.
    """
    w = inverse_depth(depth)
    du, dv = K[0, 0] * _slope(w, 1), K[1, 1] * _slope(w, 0)
    x = ((np.arange(w.shape[1]) - K[0, 2]) / K[0, 0]).astype(np.float32)[None, :]
    y = ((np.arange(w.shape[0]) - K[1, 2]) / K[1, 1]).astype(np.float32)[:, None]
    along = w - x * du - y * dv  # (du, dv, along) is the normal, scaled such that its product with the ray is w
    scale = np.sqrt((du * du + dv * dv + along * along) * (x * x + y * y + 1.0))
    cosine = np.divide(w, scale, out=np.zeros_like(w), where=scale > 0)
    return np.arccos(np.clip(cosine, 0.0, 1.0))


def steps(depth: Float[np.ndarray, "h w"], relative: float) -> Bool[np.ndarray, "h w"]:
    """Pixels beside a step of more than `relative` of their depth, on both sides of it; slopes are no steps."""
    w = inverse_depth(depth)
    bend = np.zeros_like(w)
    bend[:, 1:-1] = np.abs(w[:, 2:] - 2 * w[:, 1:-1] + w[:, :-2])
    bend[1:-1] = np.maximum(bend[1:-1], np.abs(w[2:] - 2 * w[1:-1] + w[:-2]))
    return (bend > relative * w) & (w > 0)


def shadow(depth: Float[np.ndarray, "h w"], K: Float[np.ndarray, "3 3"], baseline: float) -> Bool[np.ndarray, "h w"]:
    """Pixels that a projector at (baseline, 0, 0) of the camera frame cannot light, for what is nearer stands before them.

    Only what the image shows casts shadows. With a positive baseline (metres) they fall to the left.
    """
    w = inverse_depth(depth)
    rows, columns = w.shape
    seen_at = np.arange(columns, dtype=np.float32) - np.float32(K[0, 0] * baseline) * w  # column in the projector
    low = np.floor(seen_at).astype(np.int64)
    margin = int(np.ceil(abs(K[0, 0] * baseline * float(w.max(initial=0.0))))) + 2
    nearest = np.zeros((rows, columns + 2 * margin), np.float32)
    place = low + margin + np.arange(rows)[:, None] * nearest.shape[1]
    flat = nearest.ravel()
    np.maximum.at(flat, place.ravel(), w.ravel())
    np.maximum.at(flat, place.ravel() + 1, w.ravel())
    closer = flat[np.where(seen_at - low < 0.5, place, place + 1)]
    return (w > 0) & (closer * (1.0 - SHADOW_TOLERANCE) > w)


def _slope(values: Float32[np.ndarray, "h w"], axis: int) -> Float32[np.ndarray, "h w"]:
    """Change per pixel along an axis: of the differences to both neighbours the smaller one."""
    difference = np.diff(values, axis=axis)
    first, last = np.take(difference, [0], axis), np.take(difference, [-1], axis)
    ahead = np.concatenate([difference, last], axis)
    behind = np.concatenate([first, difference], axis)
    return np.where(np.abs(ahead) < np.abs(behind), ahead, behind)
