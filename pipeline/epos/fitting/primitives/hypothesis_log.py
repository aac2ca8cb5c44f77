"""Hypotheses noted by a compiled search, for the trace."""

from typing import NamedTuple, no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.compiled import kernel
from pipeline.epos.fitting.primitives.poses import copy_pose


class Log(NamedTuple):
    """Hypotheses in the order of the search, as far as they fit in; none do where nobody wants to know."""

    size: np.ndarray
    """(1,) how many have been noted."""
    triplet: np.ndarray
    """(l, 3) the correspondences it came from."""
    pose: np.ndarray
    """(l, 3, 4)."""
    quality: np.ndarray
    """(l,) sum over the pixels that were looked at."""
    kind: np.ndarray
    """(l,) LOOKED_AT, SCORED, OPTIMIZED or KEPT."""


LOOKED_AT, SCORED, OPTIMIZED, KEPT = range(4)


def make_log(capacity: int) -> Log:
    """Room for so many hypotheses."""
    poses, triplets = np.zeros((capacity, 3, 4)), np.zeros((capacity, 3), np.int64)
    return Log(np.zeros(1, np.int64), triplets, poses, np.zeros(capacity), np.zeros(capacity, np.int64))


@kernel()
@no_type_check
def note(log, triplet, pose, quality, kind):
    """Add a hypothesis to the log, if there is room."""
    i = log.size[0]
    if i < len(log.kind):
        for k in range(3):
            log.triplet[i, k] = triplet[k]
        copy_pose(pose, log.pose[i])
        log.quality[i], log.kind[i] = quality, kind
        log.size[0] += 1
