"""Average precision of detections as the BOP Challenge 2024 computes it for 6D poses (its `calc_ap`).

Precision at a recall is the largest one at that recall or a higher one, sampled at 0, 0.01, ..., 1 as in COCO.
"""

import numpy as np
from jaxtyping import Bool, Float

RECALLS = np.linspace(0.0, 1.0, 101)
"""Where the precision is sampled."""


def average_precision(right: Bool[np.ndarray, "n"], demanded: int) -> float:
    """Mean of the sampled precisions, 0..1; 0 without detections.

    Args:
        right: whether each detection, by falling score, is of an instance that no better scored one has taken.
        demanded: number of instances to be detected, above 0.

    """
    precisions, recalls = precision_recall(right, demanded)
    best_from = np.maximum.accumulate(np.append(precisions, 0.0)[::-1])[::-1]
    return float(best_from[np.searchsorted(recalls, RECALLS, side="left")].mean())


def precision_recall(
    right: Bool[np.ndarray, "n"], demanded: int
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Precision and recall of the first 1, 2, ..., n detections."""
    found = np.cumsum(right)
    return found / np.arange(1, len(right) + 1), found / float(demanded)
