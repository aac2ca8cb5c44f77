"""From rough poses to poses on the measured surface."""

from dataclasses import replace

import numpy as np
import pytest
from hashmatch_parts import COARSE, board, image_of, looking_at, other_part, part
from scipy.spatial.transform import Rotation

from pipeline.bop.errors import mssd
from pipeline.geometry import transform
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.detector import Detector
from pipeline.hashmatch.fit import depth_fit
from pipeline.hashmatch.polish import polished
from pipeline.hashmatch.pose_search import PoseSearch, boxes_of
from pipeline.hashmatch.proposals import propose, rough_instances
from pipeline.hashmatch.pyramid import prepare
from pipeline.hashmatch.rendered_templates import learn
from pipeline.hashmatch.selection import choose_rough
from pipeline.ray_casting import cast
from pipeline.scene import Image

POSE = looking_at(0.47, (2.4, 0.25, 0.3))


def near(pose: np.ndarray, degrees: float, metres: float, rng: np.random.Generator) -> np.ndarray:
    turn, shift = rng.normal(size=(2, 3))
    moved = pose.copy()
    moved[:3, :3] = Rotation.from_rotvec(np.deg2rad(degrees) * turn / np.linalg.norm(turn)).as_matrix() @ pose[:3, :3]
    moved[:3, 3] += metres * shift / np.linalg.norm(shift)
    return moved


def slowly_aligned(image: Image, pose: np.ndarray, tolerance: float) -> np.ndarray:
    """One step of point-to-plane alignment by NumPy's least squares."""
    fit = depth_fit(part(), prepare(image, 0.05), 2, tolerance)
    [box] = boxes_of(fit, pose[None])
    [hit] = cast(part(), fit.camera, pose[None], [box], 0.0)
    measured, K = fit.depth[box.slices], fit.camera.K
    v, u = np.nonzero((measured > 0) & (abs(measured - hit.depth) < tolerance))
    rays = np.stack([(u + box.x0 - K[0, 2]) / K[0, 0], (v + box.y0 - K[1, 2]) / K[1, 1], np.ones(len(u))], axis=-1)
    points, normals = rays * hit.depth[v, u][:, None], hit.normals[v, u] @ pose[:3, :3].T
    away = (rays * (measured - hit.depth)[v, u][:, None] * normals).sum(axis=1)
    middle = points.mean(axis=0)
    weight = 1 / np.sqrt(1 + (away / (tolerance / 4)) ** 2)
    rows = np.hstack([np.cross(points - middle, normals), normals]) * weight[:, None]
    damping = np.sqrt(np.diag([1e-4 * len(u) * part().diameter ** 2] * 3 + [1e-3 * len(u)] * 3))
    motion = np.linalg.lstsq(np.vstack([rows, damping]), np.concatenate([away * weight, np.zeros(6)]))[0]
    turn = Rotation.from_rotvec(motion[:3]).as_matrix()
    return transform(turn, turn @ -middle + middle + motion[3:]) @ pose


def test_a_step_of_alignment_is_that_of_least_squares():
    image = image_of((part(), POSE), noise=0.0005)
    start = near(POSE, 2.0, 0.002, np.random.default_rng(3))
    fit = depth_fit(part(), prepare(image, 0.05), 2, 0.01)
    after, scores = polished(fit, start[None], boxes_of(fit, start[None]), steps=1)
    assert scores[0] > fit.scores(start[None], boxes_of(fit, start[None]))[0]
    assert after[0] == pytest.approx(slowly_aligned(image, start, 0.01), abs=1e-5)


def test_poses_that_see_nothing_of_the_surface_stay_where_they_are():
    image = image_of((part(), POSE))
    fit = depth_fit(part(), prepare(image, 0.05), 2, 0.01)
    away = np.stack([looking_at(0.2, (0.0, 0.0, 0.0)), looking_at(0.5, (0.0, 0.0, 0.0), x=3.0)])
    after, scores = polished(fit, away, boxes_of(fit, away))
    assert (after == away).all()
    assert (scores == 0).all()


def test_one_good_start_among_many_wrong_ones_is_followed_to_the_surface():
    image = image_of((part(), POSE), (other_part(), looking_at(0.5, (0.3, 0.2, 0.1), x=-0.12)), noise=0.0005)
    rng = np.random.default_rng(0)
    starts = np.array([
        near(looking_at(0.5, tuple(rng.uniform(-3, 3, 3)), *rng.uniform(-0.1, 0.1, 2)), 5, 0.01, rng) for _ in range(300)
    ])  # fmt: skip
    starts[117] = near(POSE, 7.0, 0.006, rng)
    config = replace(COARSE, drawn_per_instance=60, redrawn_per_instance=15)
    search = PoseSearch(config, part(), prepare(image, 0.05), None, starts, 1, 0)
    rows, moved = search.by_alignment(starts)
    kept, moved = search.by_fine_alignment(moved)
    assert len(kept) <= config.swarms_per_instance
    assert rows[kept[0]] == 117
    _, moved = search.by_swarms(moved, keep_particles=False)
    assert mssd(part(), moved[0], POSE).value < 0.002


@pytest.fixture(scope="module")
def detector() -> Detector:
    return Detector([learn(part(), COARSE, 300.0)], COARSE)


@pytest.mark.parametrize("distance", [0.42, 0.47, 0.53])
def test_rough_poses_stand_where_the_surface_was_measured(detector: Detector, distance: float):
    pose = looking_at(distance, (2.4, 0.25, 0.3))
    image = image_of((part(), pose), (board(), transform(np.eye(3), np.array([0, 0, 0.9]))))
    matching = detector.match(image)
    every, chosen = choose_rough(detector, matching, {0: 1})
    assert len(chosen) == 1
    assert {one.row for one in every} == {one.row for one in rough_instances(detector, matching, 0)}
    assert abs(chosen[0].rough[2, 3] - distance) < 0.015  # levels of the pyramid are 20 % apart
    refined = propose(detector, matching, 0, part(), 1)[0]
    assert mssd(part(), refined.pose, pose).value < 0.5 * mssd(part(), refined.rough, pose).value


def test_n_grows_with_the_templates_of_an_object():
    config = HashMatchConfig()
    assert config.for_templates(2916).votes_kept == config.for_templates(100).votes_kept == config.votes_kept == 100
    assert config.for_templates(11664).votes_kept == 400
