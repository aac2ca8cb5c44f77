"""Where to look: axes about which turning a model by some angle brings it near to itself, seen from afar."""

import numpy as np
from jaxtyping import Float, Int

from pipeline.symmetry_search.fitting import CONTINUOUS, Fit, Line, roughly_fitted
from pipeline.symmetry_search.surface import Surface

AXES = 1500
"""Directions that are looked at, on a half sphere: 3.7 degrees from one to the next."""
FOLDS = (2, 3, 4, 5, 6, 7, 8, CONTINUOUS)
"""Folds that are looked for everywhere; higher ones are on an axis of a continuous one, roughly."""
SEEDS = 16
"""Most axes of a fold that are followed, of those that look best by the largest and by the mean distance each."""


def directions(count: int = AXES) -> Float[np.ndarray, "a 3"]:
    """Unit vectors spread evenly over a half sphere (z > 0)."""
    i = np.arange(count) + 0.5
    z, around = i / count, np.pi * (1 + np.sqrt(5)) * i
    return np.stack([np.sqrt(1 - z**2) * np.cos(around), np.sqrt(1 - z**2) * np.sin(around), z], axis=1)


def seeds(surface: Surface) -> list[Fit]:
    """Roughly fitted axes of every fold that the model may have, better ones first.

    The axes are followed from where the distance is a local minimum over directions, turned about the centre of area.
    """
    axes = directions()
    neighbours = _neighbours(axes)
    shares, distances = _screened(surface, axes)
    found = []
    for fold in FOLDS:
        of_fold = distances[:, _columns(shares, fold)].max(axis=1)
        starts = {int(i) for values in of_fold.T for i in _lowest(values, neighbours)}
        found += [roughly_fitted(surface, fold, Line(axes[i], np.zeros(3))) for i in sorted(starts)]
    return sorted(found, key=lambda fit: fit.distance)


def _screened(
    surface: Surface, axes: Float[np.ndarray, "a 3"]
) -> tuple[Float[np.ndarray, "k"], Float[np.ndarray, "a k 2"]]:
    """Shares of a full turn, and the largest and mean distance for every axis and share, either way round."""
    from scipy.spatial.transform import Rotation

    from pipeline.symmetry_search.loops import screen

    exact = {k / fold for fold in FOLDS if fold for k in range(1, fold // 2 + 1)}
    between = (np.arange(10) + 0.5) / 20
    shares = np.array(sorted(exact | set(between.tolist())))
    vectors = (axes[:, None, :] * (2 * np.pi * shares)[None, :, None]).reshape(-1, 3)
    both = [screen(*surface.field, surface.coarse, Rotation.from_rotvec(s * vectors).as_matrix()) for s in (1, -1)]
    return shares, np.maximum(*both).reshape(len(axes), len(shares), 2)


def _columns(shares: Float[np.ndarray, "k"], fold: int) -> Int[np.ndarray, "c"]:
    """Which shares of a turn a fold consists of, up to half a turn."""
    if fold == CONTINUOUS:
        return np.arange(len(shares))
    wanted = np.arange(1, fold // 2 + 1) / fold
    return np.flatnonzero((np.abs(shares[:, None] - wanted) < 1e-9).any(axis=1))


def _neighbours(axes: Float[np.ndarray, "a 3"]) -> Int[np.ndarray, "a 9"]:
    """Each axis and the eight nearest to it, where a direction and its opposite are the same."""
    from scipy.spatial import KDTree

    _, nearest = KDTree(np.concatenate([axes, -axes])).query(axes, 9)
    return np.asarray(nearest) % len(axes)


def _lowest(values: Float[np.ndarray, "a"], neighbours: Int[np.ndarray, "a 9"]) -> Int[np.ndarray, "n"]:
    """The lowest local minima."""
    minima = np.flatnonzero(values <= values[neighbours].min(axis=1))
    return minima[np.argsort(values[minima])][:SEEDS]
