"""Which of the poses found are instances: greedily by quality, each counting only pixels not yet taken (compiled)."""

from typing import NamedTuple, no_type_check

import numpy as np

from pipeline.epos.fitting.pooled.workspace import LAST_STEPS, make_workspace, optimize, score
from pipeline.epos.fitting.primitives.claims import make_table, quality_outside, take
from pipeline.epos.fitting.primitives.compiled import compiled
from pipeline.epos.fitting.primitives.sorting import median

_OWN_SHARE = 0.5
"""Share of a pose's quality that must be at pixels not taken by others."""

_FEW = 4
"""So many poses must be known to tell what chance is."""


class Selection(NamedTuple):
    """k accepted poses in the order of acceptance."""

    slot: np.ndarray
    """(k,) slot that each came from."""
    own: np.ndarray
    """(k,) quality at pixels that were not taken then."""
    refused: np.ndarray
    """(slots,) True where a pose was refused because its pixels were taken."""


@compiled()
@no_type_check
def select(problem, weight, slots, tau, wanted, least, certainty, twins):
    """Choose instances among the slots, whose poses are optimized to convergence first.

    Args:
        problem: the correspondences.
        weight: (b, 16) weights of pixels.
        slots: poses and qualities, changed.
        tau: inlier threshold, pixels.
        wanted: most instances to choose.
        least: quality that an instance must have.
        certainty: the probability that it is one, 1 - (quality of a chance pose) / (its quality), must be at least this.
        twins: let poses count pixels that others have taken.

    """
    converge(problem, weight, slots, tau)
    count, table = len(slots.quality), make_table(problem, weight)
    bound, fresh, refused = slots.quality.copy(), np.zeros(count, np.bool_), np.zeros(count, np.bool_)
    order, own = np.empty(count, np.int64), np.empty(count)
    least = max(least, _chance(slots.quality) / (1.0 - min(certainty, 0.99)))
    taken = 0
    while taken < wanted:
        k = np.argmax(bound)  # never less than the true value, as claims only grow
        if bound[k] < least:
            break
        if not fresh[k] and not twins:
            whole, bound[k] = quality_outside(problem, slots.pose[k], tau, table)
            if bound[k] < _OWN_SHARE * whole:
                bound[k], refused[k] = 0.0, True
            fresh[k] = True
            continue
        order[taken], own[taken] = k, bound[k]
        taken += 1
        bound[k] = 0.0
        fresh[:] = False
        take(problem, slots.pose[k], tau, table)
    return Selection(order[:taken], own[:taken], refused)


@compiled()
@no_type_check
def _chance(quality):
    """Quality that chance poses reach: the lower quartile of all slots, most of which hold no instance."""
    found = quality[quality > 0.0]
    median(found)  # puts them in order
    return found[len(found) // 4] if len(found) >= _FEW else 0.0


@compiled()
@no_type_check
def converge(problem, weight, slots, tau):
    """Optimize all poses at the final tolerance."""
    work = make_workspace(problem, weight)
    for k in range(len(slots.quality)):
        if slots.quality[k] > 0.0:
            optimize(work, slots.pose[k], tau, tau, LAST_STEPS)
            slots.quality[k] = score(work, slots.pose[k], tau)[0]
