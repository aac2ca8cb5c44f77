"""Which pixels of a view the verification compares (thesis sec. Multimodal Hypothesis Verification)."""

from typing import no_type_check

import numpy as np
from jaxtyping import Float, Integer

from pipeline.hashmatch.channels import normal_bins
from pipeline.hashmatch.compiling import compiled

_STABLE_COSINE = np.cos(np.deg2rad(12.0))


def normal_points(normals: Float[np.ndarray, "w w 3"], count: int) -> Integer[np.ndarray, "n 2"]:
    """Up to `count` pixels (x, y) whose normals are like those around them, spread over the view."""
    stability = _stability(normals)
    y, x = np.nonzero(normals.any(axis=-1))
    best_first = np.lexsort((x, y, -stability[y, x]))
    stable = stability[y, x][best_first] >= 0.75
    points = np.stack([x, y], axis=-1)[best_first]
    chosen = scattered(points[stable], count) if stable.sum() >= count // 2 else points[:0]
    return chosen if len(chosen) >= count // 2 else scattered(points, count)


def gradient_points(magnitude: Float[np.ndarray, "w w"], count: int) -> Integer[np.ndarray, "n 2"]:
    """Up to `count` pixels (x, y) with large gradients, spread over the view."""
    y, x = np.nonzero(magnitude)
    best_first = np.lexsort((x, y, -magnitude[y, x]))
    return scattered(np.stack([x, y], axis=-1)[best_first], count)


def scattered(points: Integer[np.ndarray, "n 2"], count: int) -> Integer[np.ndarray, "m 2"]:
    """The first points that are far enough from those before them, as far as gives `count` of them."""
    if len(points) <= count:
        return points
    kept, spacing = points, 2
    while len(wider := _spaced(points, spacing)) >= count:
        kept, spacing = wider, spacing + 1
    return kept[:count]


def _spaced(points: np.ndarray, spacing: int) -> np.ndarray:
    """Points in order, each no nearer than `spacing` (in x or y) to an earlier one that was kept."""
    return points[_kept(np.ascontiguousarray(points, np.int64), spacing)]


@compiled
@no_type_check
def _kept(points, spacing):
    taken = np.zeros((points[:, 0].max() + 1 + 2 * spacing, points[:, 1].max() + 1 + 2 * spacing), np.bool_)
    kept = np.zeros(len(points), np.bool_)
    for i in range(len(points)):
        x, y = points[i, 0], points[i, 1]
        if not taken[x + spacing, y + spacing]:
            kept[i] = True
            taken[x + 1 : x + 2 * spacing, y + 1 : y + 2 * spacing] = True
    return kept


def _stability(normals: np.ndarray) -> np.ndarray:
    """Share of the 24 neighbours whose normal differs by less than some degrees; 0 where there is no normal."""
    padded = np.pad(normals, ((2, 2), (2, 2), (0, 0)))
    height, width = normals.shape[:2]
    alike = np.zeros((height, width))
    for dy in range(5):
        for dx in range(5):
            alike += (normals * padded[dy : dy + height, dx : dx + width]).sum(axis=-1) > _STABLE_COSINE
    return np.maximum(alike - 1, 0) / 24 * (normal_bins(normals) != 255)
