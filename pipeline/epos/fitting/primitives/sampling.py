"""Random triplets of correspondences: by confidence (PROSAC), and near a seed pixel (compiled, reproducible)."""

from typing import NamedTuple, no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.compiled import compiled, kernel
from pipeline.epos.fitting.primitives.grid import Grid, cell_at
from pipeline.epos.fitting.primitives.random_numbers import below, random_bits, uniform

_DIRECTIONS = 64


_DISTANCES = 32


class Sampler(NamedTuple):
    """What triplets are drawn from."""

    grid: Grid
    ranking: np.ndarray
    """(n,) correspondences by falling confidence."""
    owner: np.ndarray
    """(n,) pixel of each correspondence."""
    first: np.ndarray
    """(p + 1,) first correspondence of each pixel."""
    pixels: np.ndarray
    """(p, 2)."""
    points: np.ndarray
    """(n, 3)."""
    directions: np.ndarray
    """(64, 2) unit vectors all around."""
    distances: np.ndarray
    """(32,) distances in pixels, in geometric progression."""


@compiled()
@no_type_check
def make_sampler(problem, nearest, farthest):
    """Prepare to draw triplets whose points lie between two distances (pixels) apart."""
    directions, distances = np.empty((_DIRECTIONS, 2)), np.empty(_DISTANCES)
    for k in range(_DIRECTIONS):
        angle = 2.0 * np.pi * k / _DIRECTIONS
        directions[k, 0], directions[k, 1] = np.cos(angle), np.sin(angle)
    for k in range(_DISTANCES):
        distances[k] = nearest * (farthest / nearest) ** (k / (_DISTANCES - 1))
    p = problem
    return Sampler(p.grid, p.ranking, p.owner, p.first, p.pixels, p.points, directions, distances)


@kernel()
@no_type_check
def sample_anywhere(sampler, limit, state, triplet):
    """Draw three correspondences among the `limit` most confident."""
    for k in range(3):
        triplet[k] = sampler.ranking[below(state, limit)]


@kernel()
@no_type_check
def sample_nearby(sampler, limit, coherence, state, triplet):
    """Draw a seed among the `limit` most confident correspondences, and two at pixels in its neighbourhood.

    Of a neighbour's alternatives the one nearest to the seed's 3D point is taken with the probability `coherence`, since
    alternatives by symmetry lie far apart, else any. False where no neighbour was found.
    """
    seed = sampler.ranking[below(state, limit)]
    pixel = sampler.owner[seed]
    triplet[0] = seed
    u, v = sampler.pixels[pixel, 0], sampler.pixels[pixel, 1]
    bits = random_bits(state)
    distance = sampler.distances[bits & np.uint64(_DISTANCES - 1)]
    direction = np.int64(bits >> np.uint64(58))
    for k in range(1, 3):
        other = _neighbour(sampler, u, v, distance, direction, state)
        if other < 0:
            return False
        triplet[k] = _alternative(sampler, other, seed, coherence, state)
        bits = random_bits(state)
        turn = 10 + np.int64(bits & np.uint64(15))  # 56 to 141 degrees: no flat triangles
        direction += turn if bits >> np.uint64(63) else -turn
    return True


@kernel()
@no_type_check
def _neighbour(sampler, u, v, distance, direction, state):
    """Random pixel some way from (u, v); -1 where three looks found none."""
    grid = sampler.grid
    for _ in range(3):
        k = direction & (_DIRECTIONS - 1)
        cell = cell_at(grid, u + distance * sampler.directions[k, 0], v + distance * sampler.directions[k, 1])
        if cell >= 0:
            first = grid.first[cell]
            count = grid.first[cell + 1] - first
            if count > 0:
                return grid.members[first + below(state, count)]
        direction += 20
        distance *= 0.8
    return -1


@kernel()
@no_type_check
def _alternative(sampler, pixel, seed, coherence, state):
    """One of a pixel's correspondences."""
    first, last, points = sampler.first[pixel], sampler.first[pixel + 1], sampler.points
    if last - first == 1:
        return first
    if uniform(state) >= coherence:
        return first + below(state, last - first)
    best, least = first, np.inf
    for i in range(first, last):
        x, y, z = points[i, 0] - points[seed, 0], points[i, 1] - points[seed, 1], points[i, 2] - points[seed, 2]
        square = x * x + y * y + z * z
        if square < least:
            best, least = i, square
    return best


@kernel()
@no_type_check
def load_triplet(sampler, rays, triplet, min_area, triplet_rays, triplet_points):
    """Copy the rays and points of a triplet; False where P3P had better not try (thesis sec. single_instance_fitting).

    That is where two are of the same pixel, the pixels' triangle has less than `min_area`, or the points are collinear.
    """
    owner, uv, points = sampler.owner, sampler.pixels, sampler.points
    a, b, c = owner[triplet[0]], owner[triplet[1]], owner[triplet[2]]
    if a in (b, c) or b == c:
        return False
    double = (uv[b, 0] - uv[a, 0]) * (uv[c, 1] - uv[a, 1]) - (uv[c, 0] - uv[a, 0]) * (uv[b, 1] - uv[a, 1])
    if abs(double) < 2.0 * min_area:
        return False
    for d in range(3):
        triplet_rays[0, d], triplet_rays[1, d], triplet_rays[2, d] = rays[a, d], rays[b, d], rays[c, d]
        for k in range(3):
            triplet_points[k, d] = points[triplet[k], d]
    return not _collinear(triplet_points)


@kernel()
@no_type_check
def _collinear(points):
    """Tell whether the sine of the angle at the first of three points is below 0.03."""
    ax, ay, az = points[1, 0] - points[0, 0], points[1, 1] - points[0, 1], points[1, 2] - points[0, 2]
    bx, by, bz = points[2, 0] - points[0, 0], points[2, 1] - points[0, 1], points[2, 2] - points[0, 2]
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    return x * x + y * y + z * z <= 1e-3 * (ax * ax + ay * ay + az * az) * (bx * bx + by * by + bz * bz)
