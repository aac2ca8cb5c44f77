"""Quality of a pose over blocks of pixels: per pixel only the best correspondence counts (thesis eq. pose_quality_single).

Poses are (3, 4) float64 `camera_from_model` of points relative to the object's centre; `lens` is K.
"""

from typing import no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.blocks import LANES
from pipeline.epos.fitting.primitives.compiled import FAST, kernel

_ZERO, _ONE, _TWO, _WORST = np.float32(0.0), np.float32(1.0), np.float32(2.0), np.float32(1e30)


@kernel(fastmath=FAST)
@no_type_check
def quality(p, uv, xyz, row, weight, inverse, chosen, best):
    """Sum over pixels of weight * max(0, 1 - e^2 / tau^2), e of the best alternative.

    Args:
        p: the projection.
        uv: `Blocks.uv`.
        xyz: `Blocks.xyz`.
        row: `Blocks.row`.
        weight: (b, 16) float32, 0 for pixels that do not count.
        inverse: 1 / tau^2, float32.
        chosen: the blocks to look at.
        best: (16,) float32, scratch.

    """
    total = _ZERO
    for b in chosen:
        r = row[b]
        rows = row[b + 1] - r
        # One loop for each number of alternatives: without anything stored in between, the compiler
        # needs no checks whether arrays overlap, which cost more than the arithmetic.
        if rows == 1:
            for i in range(LANES):
                total += _kernel(_error(p, xyz, r, uv, b, i), inverse) * weight[b, i]
        elif rows == 2:
            for i in range(LANES):
                total += _kernel(_two(p, xyz, r, uv, b, i), inverse) * weight[b, i]
        elif rows == 3:
            for i in range(LANES):
                e = _least(_two(p, xyz, r, uv, b, i), _error(p, xyz, r + 2, uv, b, i))
                total += _kernel(e, inverse) * weight[b, i]
        elif rows == 4:
            for i in range(LANES):
                e = _least(_two(p, xyz, r, uv, b, i), _two(p, xyz, r + 2, uv, b, i))
                total += _kernel(e, inverse) * weight[b, i]
        else:
            _best_of_many(p, uv, xyz, row, b, best)
            for i in range(LANES):
                total += _kernel(best[i], inverse) * weight[b, i]
    return total


@kernel(fastmath=FAST)
@no_type_check
def _error(p, xyz, r, uv, b, i):
    """Squared re-projection error; enormous for a point behind the camera."""
    x, y, z = xyz[r, 0, i], xyz[r, 1, i], xyz[r, 2, i]
    depth = p[8] * x + p[9] * y + p[10] * z + p[11]
    scale = _ONE / depth
    du = (p[0] * x + p[1] * y + p[2] * z + p[3]) * scale - uv[b, 0, i]
    dv = (p[4] * x + p[5] * y + p[6] * z + p[7]) * scale - uv[b, 1, i]
    e = du * du + dv * dv
    return e if depth > _ZERO else _WORST


@kernel(fastmath=FAST)
@no_type_check
def _least(a, b):
    return a if a < b else b


@kernel(fastmath=FAST)
@no_type_check
def _two(p, xyz, r, uv, b, i):
    return _least(_error(p, xyz, r, uv, b, i), _error(p, xyz, r + 1, uv, b, i))


@kernel(fastmath=FAST)
@no_type_check
def _kernel(e, inverse):
    """Truncated quadratic: 1 for no error, 0 from tau on."""
    q = _ONE - e * inverse
    return q if q > _ZERO else _ZERO


@kernel(fastmath=FAST)
@no_type_check
def _best_of_many(p, uv, xyz, row, b, best):
    best[:] = _WORST
    last = row[b + 1] - 1
    for r in range(row[b], last + 1, 4):
        for i in range(LANES):
            e = _least(_error(p, xyz, r, uv, b, i), _error(p, xyz, min(r + 1, last), uv, b, i))
            f = _least(_error(p, xyz, min(r + 2, last), uv, b, i), _error(p, xyz, min(r + 3, last), uv, b, i))
            best[i] = _least(best[i], _least(e, f))


@kernel(fastmath=FAST)
@no_type_check
def nearest(p, uv, xyz, row, chosen, error, alternative):
    """Find the best alternative of each pixel of the chosen blocks.

    Args:
        p: the projection.
        uv: `Blocks.uv`.
        xyz: `Blocks.xyz`.
        row: `Blocks.row`.
        chosen: the blocks to look at.
        error: (16 * chosen,) float32, filled block after block with the squared error.
        alternative: the same with the number of the best alternative, from 0; float32, as vectors of mixed types are slow.

    """
    at = 0
    for b in chosen:
        r, last = row[b], row[b + 1] - 1
        if r == last:
            for i in range(LANES):
                error[at + i], alternative[at + i] = _error(p, xyz, r, uv, b, i), _ZERO
        elif r + 1 == last:
            for i in range(LANES):
                error[at + i], alternative[at + i] = _nearer(p, xyz, uv, r, last, b, i)
        else:
            fourth = min(r + 3, last)
            for i in range(LANES):
                e, k = _nearer(p, xyz, uv, r, r + 1, b, i)
                f, m = _nearer(p, xyz, uv, r + 2, fourth, b, i)
                error[at + i] = f if f < e else e
                alternative[at + i] = m + _TWO if f < e else k
            for s in range(r + 4, last + 1, 2):
                offset = np.float32(s - r)
                for i in range(LANES):
                    f, m = _nearer(p, xyz, uv, s, min(s + 1, last), b, i)
                    better = f < error[at + i]
                    error[at + i] = f if better else error[at + i]
                    alternative[at + i] = m + offset if better else alternative[at + i]
        at += LANES


@kernel(fastmath=FAST)
@no_type_check
def _nearer(p, xyz, uv, r, s, b, i):
    """The smaller error of two rows, and 0 or 1 for which of them has it: 0 for the same row given twice."""
    e, f = _error(p, xyz, r, uv, b, i), _error(p, xyz, s, uv, b, i)
    return (f if f < e else e), (_ONE if f < e else _ZERO)


@kernel()
@no_type_check
def row_of(row, b, alternative):
    """Row of an alternative that `nearest` found in a block; never one of the next block, not even after an overflow."""
    return min(row[b] + np.int64(alternative), row[b + 1] - 1)
