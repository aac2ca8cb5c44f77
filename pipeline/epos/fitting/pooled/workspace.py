"""Local optimization and scoring of one pose, with the arrays that they write to (compiled)."""

from typing import Any, NamedTuple, no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.blocks import LANES, Blocks
from pipeline.epos.fitting.primitives.compiled import compiled, kernel
from pipeline.epos.fitting.primitives.projection import blocks_within, projection, window
from pipeline.epos.fitting.primitives.refinement import gauss_newton_step, make_scratch
from pipeline.epos.fitting.primitives.scoring import quality

LAST_STEPS = np.int64(8)  # as a literal it would compile everything twice
"""Steps of local optimization at the final tolerance."""


class Workspace(NamedTuple):
    """What every look at a pose needs, and arrays to write to."""

    lens: np.ndarray
    radius: float
    blocks: Blocks
    weight: np.ndarray
    """(b, 16) float32 weights of the pixels."""
    chosen: np.ndarray
    """(b,)."""
    best: np.ndarray
    """(16,)."""
    trial: np.ndarray
    """(3, 4)."""
    scratch: Any
    """From `make_scratch`."""


@compiled()
@no_type_check
def make_workspace(problem, weight):
    """Arrays for a search, with weights of the pixels."""
    chosen, best, trial = np.empty(len(weight), np.int64), np.empty(LANES, np.float32), np.empty((3, 4))
    scratch = make_scratch(problem.blocks)
    return Workspace(problem.lens, problem.radius, problem.blocks, weight, chosen, best, trial, scratch)


@kernel()
@no_type_check
def optimize(work, pose, first, last, steps):
    """Improve a pose in place by steps whose tolerance falls from `first` to `last`; False where that fails."""
    for i in range(steps):
        tolerance = first * (last / first) ** (i / (steps - 1)) if steps > 1 else last
        within = blocks_within(work.blocks.box, window(work.lens, pose, work.radius, tolerance), work.chosen)
        if not gauss_newton_step(
            work.lens, pose, work.blocks, work.weight, tolerance, work.chosen[:within], work.scratch
        ):
            return False
    return True


@kernel()
@no_type_check
def score(work, pose, tau):
    """Quality of a pose (a sum over pixels), and the number of blocks that it reaches."""
    blocks, inverse = work.blocks, np.float32(1.0 / (tau * tau))
    within = blocks_within(blocks.box, window(work.lens, pose, work.radius, tau), work.chosen)
    p = projection(work.lens, pose)
    return quality(p, blocks.uv, blocks.xyz, blocks.row, work.weight, inverse, work.chosen[:within], work.best), within
