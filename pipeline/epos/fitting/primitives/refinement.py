"""Local optimization of a pose on the best correspondence of each pixel, compiled.

Gauss-Newton steps of robust least squares (Tukey's weights) whose tolerance shrinks from step to step, so that a pose
from three noisy correspondences can first gather its inliers. Turns are taken about the object's centre.
"""

from typing import no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.blocks import LANES
from pipeline.epos.fitting.primitives.compiled import compiled, kernel
from pipeline.epos.fitting.primitives.normal_equations import UNKNOWNS, solve, sum_equations
from pipeline.epos.fitting.primitives.projection import projection
from pipeline.epos.fitting.primitives.scoring import nearest, row_of


@kernel()
@no_type_check
def gauss_newton_step(lens, pose, blocks, weight, tolerance, chosen, scratch):
    """Improve a pose in place by one step.

    Args:
        lens: K.
        pose: (3, 4), changed.
        blocks: the pixels.
        weight: (b, 16) weights of the pixels.
        tolerance: error in pixels from which a pixel has no say.
        chosen: blocks to look at.
        scratch: from `make_scratch`.

    Returns:
        False, with the pose as it was, where fewer than four pixels are within the tolerance or determine no pose.

    """
    error, alternative, inliers, equations = scratch
    nearest(projection(lens, pose), blocks.uv, blocks.xyz, blocks.row, chosen, error, alternative)
    limit = np.float32(tolerance * tolerance)
    count = _gather(blocks.uv, blocks.xyz, blocks.row, weight, chosen, error, alternative, limit, inliers)
    if count < 4:
        return False
    x, y, z, u, v, w = inliers[0], inliers[1], inliers[2], inliers[3], inliers[4], inliers[5]
    sum_equations(lens, pose, x, y, z, u, v, w, count, np.float32(1.0) / limit, equations)
    return solve(equations) and _move(pose, equations[UNKNOWNS])


@compiled()
@no_type_check
def make_scratch(blocks):
    """Arrays that a step writes to."""
    lanes = len(blocks.uv) * LANES
    inliers, equations = np.empty((6, lanes), np.float32), np.empty((UNKNOWNS + 1, UNKNOWNS))
    return np.empty(lanes, np.float32), np.empty(lanes, np.float32), inliers, equations


@kernel()
@no_type_check
def _gather(uv, xyz, row, weight, chosen, error, alternative, limit, inliers):
    """Copy the inliers among the pixels of the chosen blocks together; return their number."""
    at, count = 0, 0
    for b in chosen:
        for i in range(LANES):
            if error[at + i] < limit and weight[b, i] > 0.0:
                r = row_of(row, b, alternative[at + i])
                for c in range(3):
                    inliers[c, count] = xyz[r, c, i]
                inliers[3, count], inliers[4, count], inliers[5, count] = uv[b, 0, i], uv[b, 1, i], weight[b, i]
                count += 1
        at += LANES
    return count


@kernel()
@no_type_check
def _move(pose, step):
    """Turn the pose by the vector step[:3] about the object's centre (Rodrigues) and shift it by step[3:]."""
    x, y, z = step[0], step[1], step[2]
    square = x * x + y * y + z * z
    if not (square < 10.0 and pose[2, 3] + step[5] > 0.0):
        return False
    angle = np.sqrt(square)
    s = np.sin(angle) / angle if angle > 1e-9 else 1.0
    c = (1.0 - np.cos(angle)) / square if angle > 1e-9 else 0.5
    for j in range(3):
        a, b, d = pose[0, j], pose[1, j], pose[2, j]
        ca, cb, cd = y * d - z * b, z * a - x * d, x * b - y * a
        pose[0, j] = a + s * ca + c * (y * cd - z * cb)
        pose[1, j] = b + s * cb + c * (z * ca - x * cd)
        pose[2, j] = d + s * cd + c * (x * cb - y * ca)
    for r in range(3):
        pose[r, 3] += step[3 + r]
    return True
