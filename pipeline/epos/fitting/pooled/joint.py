"""Several poses refined together, each on the pixels that it explains best (compiled)."""

from typing import no_type_check

import numpy as np

from pipeline.epos.fitting.pooled.workspace import LAST_STEPS, make_workspace, optimize
from pipeline.epos.fitting.primitives.blocks import LANES
from pipeline.epos.fitting.primitives.compiled import compiled
from pipeline.epos.fitting.primitives.projection import projection
from pipeline.epos.fitting.primitives.scoring import nearest, row_of


@compiled()
@no_type_check
def refine_together(problem, poses, tau):
    """Refine poses in place, each on the pixels that it explains better than the others do.

    Returns:
        (k, p) int64, the inlier of each pose at each pixel, -1 for none; a pixel is an inlier of one pose at most.
        (k,) sums of quality over the inliers.

    """
    blocks, count = problem.blocks, len(poses)
    lanes = len(blocks.uv) * LANES
    error, alternative = np.empty((count, lanes), np.float32), np.empty((count, lanes), np.float32)
    every = np.arange(len(blocks.uv))
    weight = np.empty((len(blocks.uv), LANES), np.float32)
    work = make_workspace(problem, weight)
    for last in range(2):
        for k in range(count):
            p = projection(problem.lens, poses[k])
            nearest(p, blocks.uv, blocks.xyz, blocks.row, every, error[k], alternative[k])
        if last or count == 1:
            break
        for k in range(count):
            _share(blocks.pixel, error, k, weight)
            optimize(work, poses[k], tau, tau, LAST_STEPS)
    return _inliers(problem, error, alternative, tau)


@compiled()
@no_type_check
def _share(pixel, error, k, weight):
    """Weight 1 for pixels that no other pose explains better than pose k."""
    for b in range(len(pixel)):
        for i in range(LANES):
            e = error[k, b * LANES + i]
            weight[b, i] = np.float32(pixel[b, i] >= 0)
            for j in range(len(error)):
                if error[j, b * LANES + i] < e:
                    weight[b, i] = np.float32(0.0)


@compiled()
@no_type_check
def _inliers(problem, error, alternative, tau):
    """What `refine_together` returns."""
    blocks = problem.blocks
    inliers, quality = np.full((len(error), len(problem.pixels)), -1), np.zeros(len(error))
    for b in range(len(blocks.pixel)):
        for i in range(LANES):
            best, least, at = -1, tau * tau, b * LANES + i
            for k in range(len(error)):
                if error[k, at] < least:
                    best, least = k, error[k, at]
            if best >= 0 and blocks.pixel[b, i] >= 0:
                inliers[best, blocks.pixel[b, i]] = blocks.source[row_of(blocks.row, b, alternative[best, at]), i]
                quality[best] += 1.0 - least / (tau * tau)
    return inliers, quality
