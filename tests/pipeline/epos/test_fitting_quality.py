"""The quality of a pose, both the exact and the fast one, against the thesis's sum written out."""

from dataclasses import replace

import numpy as np
import pytest
from fitting_cases import TAU, random_pose, reprojection_errors, slow_quality
from numba import njit

from pipeline.epos.fitting.correspondences import PotentialCorrespondences
from pipeline.epos.fitting.pooled.workspace import make_workspace, score
from pipeline.epos.fitting.primitives.blocks import pixel_weights
from pipeline.epos.fitting.primitives.problem import Problem, plain_arrays, prepare
from pipeline.epos.fitting.primitives.projection import projection
from pipeline.epos.fitting.primitives.scoring import nearest, row_of
from pipeline.epos.fitting.progressive_x.prosac import measure
from pipeline.epos.fitting.synthetic import K, MadeScene, make_scene


@njit(cache=True)
def score_of(work, pose, tau):
    return score(work, pose, tau)[0]


@njit(cache=True)
def nearest_of(problem, pose):
    """Squared error and correspondence of the best alternative of each pixel."""
    blocks = problem.blocks
    count = blocks.pixel.size
    error, alternative = np.empty(count, np.float32), np.empty(count, np.float32)
    every = np.arange(len(blocks.pixel))
    nearest(projection(problem.lens, pose), blocks.uv, blocks.xyz, blocks.row, every, error, alternative)
    squares, found = np.empty(len(problem.pixels)), np.empty(len(problem.pixels), np.int64)
    for p in range(len(problem.pixels)):
        b, lane = blocks.place[p] // 16, blocks.place[p] % 16
        squares[p] = error[blocks.place[p]]
        found[p] = blocks.source[row_of(blocks.row, b, alternative[blocks.place[p]]), lane]
    return squares, found


def problem_of(c: PotentialCorrespondences) -> Problem:
    return prepare(*plain_arrays(c, K), np.array([0], np.uint64))


def relative_to(problem: Problem, pose: np.ndarray) -> np.ndarray:
    """The pose of points relative to the problem's centre."""
    moved = pose[:3].copy()
    moved[:, 3] += moved[:, :3] @ problem.centre
    return moved


def fast_quality(c: PotentialCorrespondences, pose: np.ndarray) -> float:
    problem = problem_of(c)
    work = make_workspace(problem, pixel_weights(problem.blocks))
    return score_of(work, relative_to(problem, pose), TAU) / len(problem.pixels)


def exact_quality(c: PotentialCorrespondences, pose: np.ndarray, known: tuple[np.ndarray, ...] = ()) -> float:
    problem = problem_of(c)
    nothing = np.full(len(c), np.inf)
    squares = [measure(problem, relative_to(problem, other), nothing, TAU)[0] for other in known]
    return measure(problem, relative_to(problem, pose), np.min([nothing, *squares], axis=0), TAU)[1]


@pytest.fixture(scope="module")
def scene() -> MadeScene:
    return make_scene(3, instances=3, outliers=0.4)


def poses_to_try(scene: MadeScene) -> list[np.ndarray]:
    """True poses, the like somewhat off, and any."""
    rng = np.random.default_rng(5)
    off = [pose.copy() for pose in scene.camera_from_model]
    for pose in off:
        pose[:3, 3] += rng.normal(size=3) * 0.002
    return [*scene.camera_from_model, *off, *(random_pose(rng) for _ in range(10))]


def test_both_qualities_are_the_thesis_s(scene: MadeScene):
    c = scene.correspondences
    wanted = [slow_quality(c, pose) for pose in poses_to_try(scene)]
    assert max(wanted) > 0.15
    np.testing.assert_allclose([exact_quality(c, pose) for pose in poses_to_try(scene)], wanted, atol=1e-12)
    np.testing.assert_allclose([fast_quality(c, pose) for pose in poses_to_try(scene)], wanted, atol=2e-5)


def test_many_alternatives_of_a_pixel_count_once():
    """More than the four that the fast quality has loops of their own for."""
    c = make_scene(4, outliers=0.3).correspondences
    rng = np.random.default_rng(6)
    merged = replace(c, pixel_ids=c.pixel_ids // 4, pixels=c.pixels[np.searchsorted(c.pixel_ids, c.pixel_ids // 4 * 4)])
    assert np.bincount(merged.pixel_ids).max() > 8
    for pose in [make_scene(4, outliers=0.3).camera_from_model[0], random_pose(rng)]:
        assert fast_quality(merged, pose) == pytest.approx(slow_quality(merged, pose), abs=2e-5)


def test_what_another_pose_explains_does_not_count_again(scene: MadeScene):
    c, poses = scene.correspondences, scene.camera_from_model
    twice = exact_quality(c, poses[0], (poses[0],))
    assert twice == pytest.approx(slow_quality(c, poses[0], (poses[0],)), abs=1e-12)
    assert twice < 0.5 * exact_quality(c, poses[0])
    beside = exact_quality(c, poses[0], (poses[1], poses[2]))
    assert beside == pytest.approx(slow_quality(c, poses[0], (poses[1], poses[2])), abs=1e-12)
    assert beside > 0.9 * exact_quality(c, poses[0])


def test_a_pose_behind_the_camera_explains_nothing(scene: MadeScene):
    behind = scene.camera_from_model[0].copy()
    behind[:3, :3] = np.diag([-1.0, -1.0, 1.0]) @ behind[:3, :3]  # projects to the very same pixels
    behind[:3, 3] *= -1
    behind[:3, :3] = np.diag([1.0, 1.0, -1.0]) @ behind[:3, :3]
    assert exact_quality(scene.correspondences, behind) == 0.0
    assert fast_quality(scene.correspondences, behind) == 0.0


def test_an_object_that_the_camera_is_nearly_inside_of_is_scored_in_full():
    """Where its ball cannot be projected, no pixel may be left out."""
    rng = np.random.default_rng(7)
    scene = make_scene(8)
    near = scene.camera_from_model[0].copy()
    near[:3, 3] = [0.0, 0.0, 0.04]
    c = scene.correspondences
    points = near[:3, :3] @ c.points_in_model.T + near[:3, 3:]
    seen = (K @ points / points[2]).T[:, :2]
    moved = replace(c, pixels=seen + rng.normal(size=seen.shape), pixel_ids=np.arange(len(c)))
    assert fast_quality(moved, near) == pytest.approx(slow_quality(moved, near), abs=2e-4)
    assert slow_quality(moved, near) > 0.3


@pytest.mark.parametrize("most", [1, 2, 3, 4, 5, 6, 7, 11])
def test_the_best_alternative_of_each_pixel_is_found(most: int):
    """For any number of alternatives, odd ones too, and whichever is the best."""
    rng = np.random.default_rng(most)
    pose, count = random_pose(rng), rng.integers(1, most + 1, 300)
    count[:40] = most
    ids = np.repeat(np.arange(300), count)
    pixels, points = rng.uniform(0, 600, (300, 2)), rng.uniform(-0.05, 0.05, (len(ids), 3))
    c = PotentialCorrespondences(1, pixels[ids], points, np.ones(len(ids)), ids)
    problem = problem_of(c)
    squares, found = nearest_of(problem, relative_to(problem, pose))
    error = reprojection_errors(c, pose)
    best = [np.flatnonzero(ids == p)[np.argmin(error[ids == p])] for p in range(300)]
    np.testing.assert_array_equal(found, best)
    np.testing.assert_allclose(np.sqrt(squares), error[best], rtol=1e-4)
