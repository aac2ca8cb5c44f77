"""One object's correspondences made ready for the compiled search: sorted by pixel, centred, laid out in blocks."""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float

from pipeline.epos.fitting.correspondences import PotentialCorrespondences
from pipeline.epos.fitting.primitives.blocks import Blocks, make_blocks
from pipeline.epos.fitting.primitives.compiled import compiled
from pipeline.epos.fitting.primitives.grid import Grid, make_grid
from pipeline.epos.fitting.primitives.random_numbers import uniform
from pipeline.epos.fitting.primitives.sorting import median, order_of

_SAMPLES = 100
"""Points that the middle of the object is found from, about."""


class Problem(NamedTuple):
    """n correspondences at p pixels."""

    lens: np.ndarray
    """(3, 3) K."""
    centre: np.ndarray
    """(3,) middle of the model points, the origin of `points`."""
    radius: float
    """Distance of the farthest point (that is none of a few absurd ones) from the centre, metres."""
    pixels: np.ndarray
    """(p, 2) u, v of each pixel."""
    rays: np.ndarray
    """(p, 3) unit vector of each pixel in the camera frame."""
    points: np.ndarray
    """(n, 3) model points less the centre, sorted by pixel."""
    first: np.ndarray
    """(p + 1,) first correspondence of each pixel."""
    owner: np.ndarray
    """(n,) pixel of each correspondence."""
    ranking: np.ndarray
    """(n,) correspondences by falling confidence."""
    blocks: Blocks
    grid: Grid


def plain_arrays(correspondences: PotentialCorrespondences, K: Float[np.ndarray, "3 3"]) -> tuple[np.ndarray, ...]:
    """K, pixels, points, confidence and pixel ids as `prepare` takes them; other types would be compiled anew."""
    c = correspondences
    numbers = (
        np.require(array, np.float64, ["C", "W", "A"]) for array in (K, c.pixels, c.points_in_model, c.confidence)
    )
    return *numbers, np.require(c.pixel_ids, np.int64, ["C", "W", "A"])


@compiled()
@no_type_check
def prepare(lens, pixels, points, confidence, group, state):
    """Sort and lay out correspondences.

    Args:
        lens: (3, 3) K.
        pixels: (n, 2) u, v.
        points: (n, 3) in the model frame.
        confidence: (n,), not negative.
        group: (n,) int64, rising; equal where correspondences share a pixel.
        state: of the random numbers.

    """
    n = len(pixels)
    centre, radius = _ball(points)
    owner, centred = np.empty(n, np.int64), np.empty((n, 3))
    count = 0
    for i in range(n):
        count += i == 0 or group[i] != group[i - 1]
        owner[i] = count - 1
        for c in range(3):
            centred[i, c] = points[i, c] - centre[c]
    first = np.zeros(count + 1, np.int64)
    for i in range(n):
        first[owner[i] + 1] = i + 1
    uv, rays = _rays(lens, pixels, first)
    blocks, grid = make_blocks(uv, centred, first), make_grid(uv)
    return Problem(lens, centre, radius, uv, rays, centred, first, owner, _ranking(confidence, state), blocks, grid)


@compiled()
@no_type_check
def _ball(points):
    """Middle of the points, and the distance of the farthest that is not absurdly far (8 times the median)."""
    step = max(1, len(points) // _SAMPLES)
    sample = points[::step]
    centre, distance = np.empty(3), np.empty(len(sample))
    for c in range(3):
        centre[c] = median(sample[:, c].copy())
    for i in range(len(sample)):
        distance[i] = _distance(sample, i, centre)
    limit, radius = 8.0 * median(distance), 0.0
    for i in range(len(points)):
        distance_i = _distance(points, i, centre)
        if distance_i <= limit:
            radius = max(radius, distance_i)
    return centre, radius


@compiled()
@no_type_check
def _distance(points, i, centre):
    return np.sqrt((points[i, 0] - centre[0]) ** 2 + (points[i, 1] - centre[1]) ** 2 + (points[i, 2] - centre[2]) ** 2)


@compiled()
@no_type_check
def _ranking(confidence, state):
    """Correspondences by falling confidence, ties shuffled: else they would come line by line."""
    top = 0.0
    for value in confidence:
        top = max(top, value)
    key = np.empty(len(confidence), np.int64)
    for i in range(len(confidence)):
        share = confidence[i] / top if top > 0.0 else 0.0
        key[i] = np.int64((1.0 - share) * 1048575.0) << 13 | np.int64(8192.0 * uniform(state))
    return order_of(key, 33)


@compiled()
@no_type_check
def _rays(lens, pixels, first):
    """Coordinates of each pixel and its unit ray."""
    count = len(first) - 1
    uv, rays = np.empty((count, 2)), np.empty((count, 3))
    for p in range(count):
        u, v = pixels[first[p], 0], pixels[first[p], 1]
        uv[p, 0], uv[p, 1] = u, v
        y = (v - lens[1, 2]) / lens[1, 1]
        x = (u - lens[0, 2] - lens[0, 1] * y) / lens[0, 0]
        scale = 1.0 / np.sqrt(x * x + y * y + 1.0)
        rays[p, 0], rays[p, 1], rays[p, 2] = x * scale, y * scale, scale
    return uv, rays
