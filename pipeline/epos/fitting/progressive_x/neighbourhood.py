"""Which correspondences are neighbours: nearer than tau_d in 5D, pixels and centimetres (thesis sec. single_instance_fitting)."""

from typing import no_type_check

import numpy as np
from jaxtyping import Float

from pipeline.epos.fitting.primitives.compiled import compiled
from pipeline.epos.fitting.progressive_x.max_flow import Adjacency, make_adjacency

_CM = 100.0

_MOST_PAIRS = 4_000_000
"""What memory is spent on at most, 0.4 GB; 16,000 correspondences of ten instances have 1.2 million."""

_SHRINKINGS = 8


def make_neighbourhood(pixels: Float[np.ndarray, "n 2"], points: Float[np.ndarray, "n 3"], radius: float) -> Adjacency:
    """Graph of the pairs of correspondences nearer than `radius`, in pixels and centimetres; points in metres.

    Where there are more than four million, as where a hundred thousand crowd together, the radius is reduced.
    """
    return _neighbourhood(pixels, points, radius, np.argsort(pixels[:, 0], kind="stable"))


@compiled()
@no_type_check
def _neighbourhood(pixels, points, radius, order):
    """The same, given the order of the pixels from left to right."""
    none = np.empty((0, 2), np.int64)
    count = _each_pair(pixels, points, radius, order, none)
    for _ in range(_SHRINKINGS):
        if count > _MOST_PAIRS:
            radius *= 0.7
            count = _each_pair(pixels, points, radius, order, none)
    pairs = np.empty((min(count, _MOST_PAIRS), 2), np.int64)
    _each_pair(pixels, points, radius, order, pairs)
    return make_adjacency(len(pixels), pairs)


@compiled()
@no_type_check
def _each_pair(pixels, points, radius, order, pairs):
    """Write the pairs, as far as they fit in; return their number, where there are too many only that they are."""
    count, limit = 0, radius * radius
    for i in range(len(order)):
        a = order[i]
        for j in range(i + 1, len(order)):
            b = order[j]
            du, dv = pixels[b, 0] - pixels[a, 0], pixels[b, 1] - pixels[a, 1]
            if du >= radius:
                break
            square = du * du + dv * dv
            for c in range(3):
                square += (_CM * (points[b, c] - points[a, c])) ** 2
            if square < limit:
                if count < len(pairs):
                    pairs[count, 0], pairs[count, 1] = a, b
                count += 1
        if count > _MOST_PAIRS:
            break
    return count
