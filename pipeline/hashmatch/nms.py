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
    by = _suppress(order, np.ascontiguousarray(boxes, np.float64), np.ascontiguousarray(groups, np.int64), overlap)
    return Suppressed(order[by[order] == order], by)


@compiled
@no_type_check
def _suppress(order, boxes, groups, overlap):
    by = np.full(len(order), -1)
    for i in range(len(order)):
        a = order[i]
        if by[a] >= 0:
            continue
        by[a] = a
        area = (boxes[a, 2] - boxes[a, 0]) * (boxes[a, 3] - boxes[a, 1])
        for j in range(i + 1, len(order)):
            b = order[j]
            if by[b] >= 0 or groups[a] != groups[b]:
                continue
            width = min(boxes[a, 2], boxes[b, 2]) - max(boxes[a, 0], boxes[b, 0])
            height = min(boxes[a, 3], boxes[b, 3]) - max(boxes[a, 1], boxes[b, 1])
            if width <= 0 or height <= 0:
                continue
            other = (boxes[b, 2] - boxes[b, 0]) * (boxes[b, 3] - boxes[b, 1])
            if width * height > overlap * (area + other - width * height):
                by[b] = a
    return by
