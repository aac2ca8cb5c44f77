"""Where an object may project to: its projection matrix, and the blocks of pixels that it can reach (compiled).

Poses are (3, 4) float64 `camera_from_model` of points relative to the object's centre; `lens` is K.
"""

from typing import no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.compiled import kernel


@kernel()
@no_type_check
def projection(lens, pose):
    """The product K [R t] as 12 float32."""
    a, b, c, d, e = lens[0, 0], lens[0, 1], lens[0, 2], lens[1, 1], lens[1, 2]
    return (
        np.float32(a * pose[0, 0] + b * pose[1, 0] + c * pose[2, 0]),
        np.float32(a * pose[0, 1] + b * pose[1, 1] + c * pose[2, 1]),
        np.float32(a * pose[0, 2] + b * pose[1, 2] + c * pose[2, 2]),
        np.float32(a * pose[0, 3] + b * pose[1, 3] + c * pose[2, 3]),
        np.float32(d * pose[1, 0] + e * pose[2, 0]),
        np.float32(d * pose[1, 1] + e * pose[2, 1]),
        np.float32(d * pose[1, 2] + e * pose[2, 2]),
        np.float32(d * pose[1, 3] + e * pose[2, 3]),
        np.float32(pose[2, 0]),
        np.float32(pose[2, 1]),
        np.float32(pose[2, 2]),
        np.float32(pose[2, 3]),
    )


@kernel()
@no_type_check
def window(lens, pose, radius, margin):
    """Smallest and largest u and v, as float32, that a ball around the object's centre projects to, and a margin."""
    x, y, z = pose[0, 3], pose[1, 3], pose[2, 3]
    depth = z * z - radius * radius
    if depth <= 0.0 or z <= 0.0:
        return np.float32(-np.inf), np.float32(np.inf), np.float32(-np.inf), np.float32(np.inf)
    du = radius * np.sqrt(max(x * x + depth, 0.0))
    dv = radius * np.sqrt(max(y * y + depth, 0.0))
    left, right = (x * z - du) / depth, (x * z + du) / depth
    top, bottom = (y * z - dv) / depth, (y * z + dv) / depth
    skew_low, skew_high = min(lens[0, 1] * top, lens[0, 1] * bottom), max(lens[0, 1] * top, lens[0, 1] * bottom)
    return (
        np.float32(lens[0, 0] * left + skew_low + lens[0, 2] - margin),
        np.float32(lens[0, 0] * right + skew_high + lens[0, 2] + margin),
        np.float32(lens[1, 1] * top + lens[1, 2] - margin),
        np.float32(lens[1, 1] * bottom + lens[1, 2] + margin),
    )


@kernel()
@no_type_check
def reaches(box, b, area):
    """Tell whether a block of pixels meets a window."""
    return (box[b, 1] >= area[0]) & (box[b, 0] <= area[1]) & (box[b, 3] >= area[2]) & (box[b, 2] <= area[3])


@kernel()
@no_type_check
def blocks_within(box, area, chosen):
    """Write the blocks that meet a window into `chosen`; return their number."""
    count = 0
    for b in range(len(box)):
        chosen[count] = b
        count += reaches(box, b, area)
    return count
