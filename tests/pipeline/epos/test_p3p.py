"""P3P against the truth, its own equations and OpenCV."""

import cv2
import numpy as np
import pytest
from fitting_cases import random_pose

from pipeline.epos.fitting.primitives.p3p import MAX_SOLUTIONS, solve_p3p
from pipeline.epos.fitting.synthetic import K
from pipeline.geometry import project, transform_points


def solutions(rays: np.ndarray, points: np.ndarray) -> np.ndarray:
    poses = np.full((MAX_SOLUTIONS, 3, 4), np.nan)
    return poses[: solve_p3p(rays, points, poses)]


def problem(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rays, points and the true pose."""
    pose, points = random_pose(rng, rng.uniform(0.3, 2.0)), rng.uniform(-0.1, 0.1, (3, 3))
    seen = transform_points(pose, points)
    return seen / np.linalg.norm(seen, axis=1, keepdims=True), points, pose


def test_the_true_pose_is_among_the_solutions():
    rng = np.random.default_rng(0)
    off = []
    for _ in range(2000):
        rays, points, pose = problem(rng)
        off.append(min((np.abs(found - pose[:3]).max() for found in solutions(rays, points)), default=np.inf))
    assert np.median(off) < 1e-12
    assert np.mean(np.array(off) < 1e-6) > 0.998  # the rest are double solutions, where digits are lost


def test_each_solution_is_a_proper_pose_that_sees_the_points_along_the_rays():
    rng = np.random.default_rng(1)
    for _ in range(500):
        rays, points, _ = problem(rng)
        for found in solutions(rays, points):
            np.testing.assert_allclose(found[:, :3] @ found[:, :3].T, np.eye(3), atol=1e-9)
            assert np.linalg.det(found[:, :3]) == pytest.approx(1.0)
            seen = points @ found[:, :3].T + found[:, 3]
            lengths = np.linalg.norm(seen, axis=1, keepdims=True)
            np.testing.assert_allclose(seen / lengths, rays, atol=1e-6)  # along, not against


def test_no_solution_of_opencv_is_missed():
    rng = np.random.default_rng(2)
    known = missed = 0
    for _ in range(300):
        rays, points, pose = problem(rng)
        pixels = project(K, transform_points(pose, points))
        found = solutions(rays, points)
        _, turns, shifts = cv2.solveP3P(points, pixels, K, None, flags=cv2.SOLVEPNP_P3P)
        for turn, shift in zip(turns, shifts, strict=True):
            theirs = np.hstack([cv2.Rodrigues(turn)[0], shift])
            seen = points @ theirs[:, :3].T + theirs[:, 3]
            if np.all(seen[:, 2] > 0) and np.abs(project(K, seen) - pixels).max() < 1e-3:
                known += 1
                missed += not any(np.abs(theirs - ours).max() < 1e-3 for ours in found)
    assert known > 400
    assert missed <= 0.005 * known


@pytest.mark.parametrize("equal", [(0, 1), (1, 2), (0, 2)])
def test_a_point_given_twice_has_no_solution(equal: tuple[int, int]):
    rays, points, _ = problem(np.random.default_rng(3))
    points[equal[0]] = points[equal[1]]
    assert len(solutions(rays, points)) == 0


def test_equal_rays_give_no_nonsense():
    rays, points, _ = problem(np.random.default_rng(4))
    rays[1] = rays[0]
    assert np.isfinite(solutions(rays, points)).all()
