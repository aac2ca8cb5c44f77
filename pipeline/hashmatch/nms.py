"""Detections and non-maxima suppression (thesis sec. Non-Maxima Suppression)."""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float, Integer, Real

from pipeline.hashmatch.compiling import compiled


class Suppressed(NamedTuple):
    """What is left of some detections."""

    kept: Integer[np.ndarray, "k"]
    """Rows, best first."""
    by: Integer[np.ndarray, "n"]
    """For each detection the row of the one that suppressed it; its own row where it was kept."""


def ranking_scores(
    scores: Float[np.ndarray, "n"], areas: Real[np.ndarray, "n"], scales: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """Scores r = c (a / s): detections that explain more of the scene come first."""
    return scores * (areas / scales)


def suppress(
    scores: Float[np.ndarray, "n"],
    boxes: Float[np.ndarray, "n 4"],
    groups: Integer[np.ndarray, "n"],
    overlap: float,
) -> Suppressed:
    """Retain the best detection again and again, and remove those of its group that overlap it by more than `overlap`.

    Boxes are x0, y0, x1, y1; overlap is intersection over union. Equal scores go by row.
    """
    order = np.argsort(-scores, kind="stable")
    by = np.full(len(order), -1)
    boxes = np.ascontiguousarray(boxes, np.float64)
    for group in np.unique(groups):
        _suppress(order[groups[order] == group], boxes, overlap, by)
    return Suppressed(order[by[order] == order], by)


@compiled
@no_type_check
def _suppress(left, boxes, overlap, by):
    """Suppress within a group, given best first; the rows that are left over move up in `left`."""
    count = len(left)
    while count > 0:
        a, others = left[0], 0
        by[a] = a
        area = (boxes[a, 2] - boxes[a, 0]) * (boxes[a, 3] - boxes[a, 1])
        for j in range(1, count):
            b = left[j]
            width = min(boxes[a, 2], boxes[b, 2]) - max(boxes[a, 0], boxes[b, 0])
            height = min(boxes[a, 3], boxes[b, 3]) - max(boxes[a, 1], boxes[b, 1])
            other = (boxes[b, 2] - boxes[b, 0]) * (boxes[b, 3] - boxes[b, 1])
            shared = width * height
            if width > 0 and height > 0 and shared > overlap * (area + other - shared):
                by[b] = a
            else:
                left[others] = b
                others += 1
        count = others
