"""PROSAC (Chum & Matas 2005) with P3P and the thesis's quality, one hypothesis after the other (compiled)."""

from typing import NamedTuple, no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.compiled import compiled, kernel
from pipeline.epos.fitting.primitives.hypothesis_log import SCORED, note
from pipeline.epos.fitting.primitives.p3p import MAX_SOLUTIONS, solve_p3p
from pipeline.epos.fitting.primitives.poses import copy_pose, determinant
from pipeline.epos.fitting.primitives.random_numbers import below
from pipeline.epos.fitting.primitives.sampling import load_triplet

_RANDOM_TRIPLETS = 200_000
"""T_N: after so many triplets, or as many as there are, PROSAC draws like RANSAC."""


class Best(NamedTuple):
    """The best hypothesis so far; arrays, to be written to."""

    pose: np.ndarray
    """(3, 4)."""
    quality: np.ndarray
    """(1,) 0..1."""


@compiled()
@no_type_check
def prosac_sizes(count, draws):
    """(draws,) from how many of the most confident of `count` correspondences each triplet is drawn.

    Negative where the last of them must be in the triplet.
    """
    sizes = np.empty(draws, np.int64)
    size, due, expected = 3, 1, min(float(_RANDOM_TRIPLETS), count * (count - 1.0) * (count - 2.0) / 6.0)
    for i in range(3):
        expected *= (3 - i) / (count - i)
    for t in range(1, draws + 1):
        if t > due and size < count:
            following = expected * (size + 1) / (size - 2)
            due += np.int64(np.ceil(following - expected))
            expected = following
            size += 1
        sizes[t - 1] = -size if due >= t and size > 3 else size
    return sizes


@kernel()
@no_type_check
def squared_errors(lens, pose, pixels, owner, points, square):
    """Write the squared re-projection error of each correspondence; infinite behind the camera."""
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        a = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
        b = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
        c = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        if c > 0.0:
            u = (lens[0, 0] * a + lens[0, 1] * b) / c + lens[0, 2] - pixels[owner[i], 0]
            v = lens[1, 1] * b / c + lens[1, 2] - pixels[owner[i], 1]
            square[i] = u * u + v * v
        else:
            square[i] = np.inf


@kernel()
@no_type_check
def thesis_quality(square, explained, owner, count, tau):
    """Quality of a pose given squared errors, and the least ones by other poses (thesis eq. pose_quality_multi).

    Without other poses `explained` is infinite, and this is eq. pose_quality_single. Correspondences are sorted by
    pixel, of which there are `count`.
    """
    total, best = 0.0, 0.0
    for i in range(len(square)):
        if i > 0 and owner[i] != owner[i - 1]:
            total += best
            best = 0.0
        best = max(best, min(1.0 - square[i] / (tau * tau), explained[i] / (tau * tau)))
    return (total + best) / count


@compiled()
@no_type_check
def measure(problem, pose, explained, tau):
    """Squared errors (n,) of a pose, and its quality given the least squared errors by other poses."""
    square = np.empty(len(problem.points))
    squared_errors(problem.lens, pose, problem.pixels, problem.owner, problem.points, square)
    return square, thesis_quality(square, explained, problem.owner, len(problem.pixels), tau)


@compiled()
@no_type_check
def find_better(problem, sampler, sizes, start, explained, tau, min_area, best, state, counts, log):
    """Draw triplets from number `start` on until one gives a pose better than the best, which is written there.

    Args:
        problem: the correspondences.
        sampler: of the same.
        sizes: from `prosac_sizes`.
        start: triplets drawn before.
        explained: (n,) least squared errors by poses found before.
        tau: inlier threshold, pixels.
        min_area: of the triangle of pixels.
        best: changed.
        state: of the random numbers.
        counts: (4,) numbers of triplets, poses and poses scored, increased.
        log: `search.Log`, changed.

    Returns:
        Triplets drawn so far, and whether a better pose was found.

    """
    poses, triplet, square = np.empty((MAX_SOLUTIONS, 3, 4)), np.empty(3, np.int64), np.empty(len(explained))
    rays, points, pixels = np.empty((3, 3)), np.empty((3, 3)), len(problem.pixels)
    for t in range(start, len(sizes)):
        _draw(sampler, sizes[t], state, triplet)
        if not load_triplet(sampler, problem.rays, triplet, min_area, rays, points):
            continue
        counts[0] += 1
        better = False
        for s in range(solve_p3p(rays, points, poses)):
            counts[1] += 1
            if poses[s, 2, 3] <= 0.0 or determinant(poses[s]) < 0.0:
                continue  # behind the camera, or an improper rotation
            counts[2] += 1
            squared_errors(problem.lens, poses[s], problem.pixels, problem.owner, problem.points, square)
            q = thesis_quality(square, explained, problem.owner, pixels, tau)
            note(log, triplet, poses[s], q, SCORED)
            if q > best.quality[0]:
                best.quality[0], better = q, True
                copy_pose(poses[s], best.pose)
        if better:
            return t + 1, True
    return len(sizes), False


@kernel()
@no_type_check
def _draw(sampler, size, state, triplet):
    """Draw three of the `size` most confident correspondences; where it is negative, the last of them and two others."""
    if size < 0:
        triplet[0] = sampler.ranking[-size - 1]
        for k in range(1, 3):
            triplet[k] = sampler.ranking[below(state, -size - 1)]
    else:
        for k in range(3):
            triplet[k] = sampler.ranking[below(state, size)]
