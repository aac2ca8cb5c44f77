"""The places of the image where a search has found its best poses (compiled)."""

from typing import NamedTuple, no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.compiled import compiled, kernel
from pipeline.epos.fitting.primitives.poses import copy_pose

_SAME_PLACE = 0.5
"""Two poses compete for a slot if their projected centres are nearer than this many projected radii."""


_SAME_TURN = 0.94
"""Cosine of the angle up to which two rotations agree (20 degrees)."""


class Slots(NamedTuple):
    """k poses at different places; empty ones have quality 0."""

    pose: np.ndarray
    """(k, 3, 4), locally optimized."""
    quality: np.ndarray
    """(k,) sum over pixels."""
    bar: np.ndarray
    """(k,) the raw quality that a hypothesis at this place must exceed to be optimized."""
    place: np.ndarray
    """(k, 3) u, v of the projected centre and the projected radius, pixels."""
    votes: np.ndarray
    """(k,) good hypotheses since that agree with the pose."""


@compiled()
@no_type_check
def make_slots(count):
    """Empty slots."""
    nowhere = np.full((count, 3), -1e9)
    return Slots(np.zeros((count, 3, 4)), np.zeros(count), np.zeros(count), nowhere, np.zeros(count, np.int64))


@kernel()
@no_type_check
def slot_at(slots, u, v):
    """Slot at a place, -1 for none."""
    place = slots.place
    best, least = -1, _SAME_PLACE * _SAME_PLACE
    for k in range(len(place)):
        du, dv, r = u - place[k, 0], v - place[k, 1], place[k, 2]
        square = (du * du + dv * dv) / (r * r)
        if square < least:
            best, least = k, square
    return best


@kernel()
@no_type_check
def weakest(slots):
    """Slot with the lowest quality."""
    quality = slots.quality
    k = 0
    for j in range(1, len(quality)):
        if quality[j] < quality[k]:
            k = j
    return k


@kernel()
@no_type_check
def agrees(slots, k, pose):
    """Tell whether a pose has nearly the rotation of a slot's pose."""
    trace = 0.0
    for r in range(3):
        for c in range(3):
            trace += slots.pose[k, r, c] * pose[r, c]
    return trace > 1.0 + 2.0 * _SAME_TURN


@kernel()
@no_type_check
def offer(slots, pose, quality, place, raw):
    """Keep an optimized pose if it is the best at its place, or better than the weakest slot; tell whether it was kept.

    Args:
        slots: changed.
        pose: (3, 4).
        quality: of the optimized pose.
        place: its u, v, radius.
        raw: quality before optimization.

    """
    k = slot_at(slots, place[0], place[1])
    if k < 0:
        k = weakest(slots)
        if quality <= slots.quality[k]:
            return False
        slots.bar[k], slots.quality[k], slots.votes[k] = 0.0, 0.0, 0
    if quality <= slots.quality[k]:
        return False
    if not agrees(slots, k, pose):
        slots.votes[k] = 0
    copy_pose(pose, slots.pose[k])
    slots.quality[k] = quality
    slots.place[k, 0], slots.place[k, 1], slots.place[k, 2] = place
    # Where optimization gained little over the raw hypothesis, others as good deserve it too.
    slots.bar[k] = min(max(slots.bar[k], raw), quality)
    return True
