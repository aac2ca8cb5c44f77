"""Pose errors against slow implementations written from the equations of thesis secs. bop_vsd, bop_mssd, bop_mspd, rel_eval."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from pipeline.bop import errors
from pipeline.bop.dataset import open_dataset
from pipeline.bop.vsd import TAUS, vsd, vsd_of_poses
from pipeline.exceptions import FormatError
from pipeline.geometry import transform
from pipeline.rendering import render
from pipeline.scene import Camera, ImageKey, Model

K = np.array([[572.4114, 0.0, 325.2611], [0.0, 573.57043, 242.04899], [0.0, 0.0, 1.0]])
SMALL = Camera(np.array([[80.0, 0.0, 31.3], [0.0, 81.0, 23.8], [0.0, 0.0, 1.0]]), width=64, height=48)


def rotation_about(axis: list[float], angle: float) -> np.ndarray:
    return Rotation.from_rotvec(np.array(axis) / np.linalg.norm(axis) * angle).as_matrix()


def pose(seed: int, z: float = 0.4, spread: float = 0.02) -> np.ndarray:
    """A random pose before the camera, its rotation as far from orthonormal as LM-O's."""
    rng = np.random.default_rng(seed)
    R = Rotation.random(rng=rng).as_matrix() + 4e-3 * rng.uniform(-1, 1, (3, 3))
    return transform(R, np.array([0, 0, z]) + spread * rng.uniform(-1, 1, 3))


def near(camera_from_model: np.ndarray, seed: int, angle: float = 0.1, shift: float = 0.005) -> np.ndarray:
    rng = np.random.default_rng(seed)
    turned = Rotation.from_rotvec(angle * rng.normal(size=3)).as_matrix() @ camera_from_model[:3, :3]
    return transform(turned, camera_from_model[:3, 3] + shift * rng.normal(size=3))


def bumpy(seed: int = 0, symmetries: np.ndarray | None = None) -> Model:
    """A solid some 10 cm across with many vertices that are not on the convex hull."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(150, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    faces = ConvexHull(directions).simplices.astype(np.int32)
    vertices = directions * rng.uniform(0.03, 0.05, (150, 1)) + [0.01, 0.0, -0.02]
    diameter = float(np.linalg.norm(vertices[:, None] - vertices, axis=2).max())
    return Model(1, vertices, faces, diameter, np.eye(4)[None] if symmetries is None else symmetries)


def turns(count: int, offset: tuple[float, float, float] = (0.003, -0.002, 0.001)) -> np.ndarray:
    """Symmetries about an axis that does not go through the origin."""
    center = np.array(offset)
    rotations = [rotation_about([1, 2, 3], 2 * np.pi * k / count) for k in range(count)]
    return np.stack([transform(R, center - R @ center) for R in rotations])


# ---- the equations, slowly


def slow_mssd(model: Model, estimate: np.ndarray, truth: np.ndarray) -> tuple[float, int, int]:
    distances = [
        [
            np.linalg.norm(
                (estimate[:3, :3] @ x + estimate[:3, 3]) - (truth[:3, :3] @ (S[:3, :3] @ x + S[:3, 3]) + truth[:3, 3])
            )
            for x in model.vertices
        ]
        for S in model.symmetries
    ]
    symmetry = int(np.argmin(np.max(distances, axis=1)))
    return np.max(distances[symmetry]), int(np.argmax(distances[symmetry])), symmetry


def slow_mspd(model: Model, K: np.ndarray, estimate: np.ndarray, truth: np.ndarray) -> tuple[float, int, int]:
    def proj(x: np.ndarray) -> np.ndarray:
        return (K @ x)[:2] / (K @ x)[2]

    distances = [
        [
            np.linalg.norm(
                proj(estimate[:3, :3] @ x + estimate[:3, 3])
                - proj(truth[:3, :3] @ (S[:3, :3] @ x + S[:3, 3]) + truth[:3, 3])
            )
            for x in model.vertices
        ]
        for S in model.symmetries
    ]
    symmetry = int(np.argmin(np.max(distances, axis=1)))
    return np.max(distances[symmetry]), int(np.argmax(distances[symmetry])), symmetry


def placed(model: Model, camera_from_model: np.ndarray) -> np.ndarray:
    return model.vertices @ camera_from_model[:3, :3].T + camera_from_model[:3, 3]


def slow_depth(model: Model, camera: Camera, camera_from_model: np.ndarray) -> np.ndarray:
    """Depth at +0.5, with each pixel's ray as a sum of the corners of each face: met where no weight is negative."""
    corners = placed(model, camera_from_model)[model.faces]
    v, u = np.indices((camera.height, camera.width)) + 0.5
    rays = np.linalg.inv(camera.K) @ np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    weights = np.linalg.inv(corners.transpose(0, 2, 1)) @ rays
    z = 1 / weights.sum(axis=1)
    z[(weights < 0).any(axis=1)] = np.inf
    depth = z.min(axis=0).reshape(u.shape)
    return np.where(np.isfinite(depth), depth, 0)


def slow_vsd(depth_estimate, depth_truth, depth_test, K, diameter, taus, delta, variant) -> list[float]:
    """Pixel by pixel, as in thesis sec. bop_vsd; delta is 15 mm, tau a fraction of the diameter."""
    est_only = both = truth_only = 0
    differences = []
    for v, u in np.ndindex(depth_test.shape):
        ray = np.linalg.norm([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], 1.0])
        d_est, d_truth, d_test = (float(d[v, u]) * ray for d in (depth_estimate, depth_truth, depth_test))
        if variant == "bop19":
            seen_truth = d_truth > 0 and (d_truth - d_test <= delta or d_test == 0)
            seen_est = d_est > 0 and (d_est - d_test <= delta or d_test == 0 or seen_truth)
        else:
            seen_truth = d_truth > 0 and d_test > 0 and d_truth - d_test <= delta
            seen_est = d_est > 0 and ((d_test > 0 and d_est - d_test <= delta) or seen_truth)
        both += seen_est and seen_truth
        est_only += seen_est and not seen_truth
        truth_only += seen_truth and not seen_est
        if seen_est and seen_truth:
            differences.append(abs(d_est - d_truth) / diameter)
    union = both + est_only + truth_only
    wrong = [sum(difference >= tau for difference in differences) for tau in taus]
    return [(w + est_only + truth_only) / union if union else 1.0 for w in wrong]


def measured(model: Model, truth: np.ndarray) -> np.ndarray:
    """A measured depth image: the object, a plane behind it, an occluder across it and a hole."""
    depth = slow_depth(model, SMALL, truth).astype(np.float32)
    depth[depth == 0] = 0.6
    depth[:, 34:40] = 0.3
    depth[18:24, :] = 0
    depth[28:32, 20:34] = 0.37
    return depth


# ---- parity


@pytest.mark.parametrize("count", [1, 2, 12])
@pytest.mark.parametrize("seed", range(4))
def test_mssd_is_the_equation(seed: int, count: int):
    model = bumpy(seed, turns(count))
    for estimate, truth in ((near(pose(seed), seed), pose(seed)), (pose(seed + 50), pose(seed, z=0.9))):
        value, vertex, symmetry = errors.mssd(model, estimate, truth)
        expected = slow_mssd(model, estimate, truth)
        assert value == pytest.approx(expected[0], abs=1e-12)  # metres: the demand is 1e-9 mm
        assert (vertex, symmetry) == expected[1:]


@pytest.mark.parametrize("count", [1, 2, 12])
@pytest.mark.parametrize("seed", range(4))
def test_mspd_is_the_equation(seed: int, count: int):
    model = bumpy(seed, turns(count))
    for estimate, truth in ((near(pose(seed), seed), pose(seed)), (pose(seed + 50), pose(seed, z=0.9))):
        value, vertex, symmetry = errors.mspd(model, K, estimate, truth)
        expected = slow_mspd(model, K, estimate, truth)
        assert value == pytest.approx(expected[0], abs=1e-9)
        assert (vertex, symmetry) == expected[1:]


@pytest.mark.parametrize("seed", range(4))
def test_add_is_the_mean_distance_of_corresponding_vertices(seed: int):
    model, estimate, truth = bumpy(seed), near(pose(seed), seed), pose(seed)
    expected = np.mean(
        [np.linalg.norm(a - b) for a, b in zip(placed(model, estimate), placed(model, truth), strict=True)]
    )
    assert errors.add(model, estimate, truth) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("orthonormal", [True, False])
def test_adi_is_the_mean_distance_to_the_closest_vertex(orthonormal: bool):
    model, truth = bumpy(3), pose(3)
    estimate = near(truth, 3)
    if orthonormal:
        estimate[:3, :3] = rotation_about([1, -2, 0.5], 0.7)
    at_estimate = placed(model, estimate)
    expected = np.mean([np.linalg.norm(at_estimate - x, axis=1).min() for x in placed(model, truth)])
    assert errors.adi(model, estimate, truth) == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("variant", ["bop19", "bop18"])
@pytest.mark.parametrize("seed", range(3))
def test_vsd_is_the_equation_on_depth_by_brute_force(seed: int, variant):
    model, truth = bumpy(seed), pose(seed, z=0.4)
    depth = measured(model, truth)
    for estimate in (near(truth, seed, 0.05, 0.002), near(truth, seed, 0.4, 0.02), pose(seed + 9, spread=0.06)):
        result = vsd_of_poses(model, SMALL, estimate, truth, depth, variant=variant)
        rendered = [slow_depth(model, SMALL, each) for each in (estimate, truth)]
        expected = slow_vsd(*rendered, depth, SMALL.K, model.diameter, TAUS, 0.015, variant)
        np.testing.assert_allclose(result.values, expected, atol=2e-3)


def test_vsd_of_2017_takes_tau_as_a_length():
    model, truth = bumpy(1), pose(1)
    estimate, depth = near(truth, 1, 0.2, 0.01), measured(bumpy(1), pose(1))
    renderings = [render(model, SMALL, each) for each in (estimate, truth)]
    by_length = vsd(*renderings, depth, SMALL.K, diameter=1.0, taus=[0.02], variant="bop18")
    by_share = vsd(*renderings, depth, SMALL.K, model.diameter, taus=[0.02 / model.diameter], variant="bop18")
    expected = slow_vsd(*(r.depth for r in renderings), depth, SMALL.K, 1.0, [0.02], 0.015, "bop18")
    assert by_length.values == pytest.approx(expected)
    assert by_length.values == pytest.approx(by_share.values)


# ---- properties


def test_the_right_pose_has_no_error():
    model, truth = bumpy(0, turns(3)), pose(0)
    assert errors.mssd(model, truth, truth).value == 0
    assert errors.mspd(model, K, truth, truth).value == 0
    assert errors.add(model, truth, truth) == 0
    assert errors.adi(model, truth, truth) == pytest.approx(0, abs=1e-15)
    assert errors.translation_error(truth, truth) == 0
    assert (vsd_of_poses(model, SMALL, truth, truth, measured(model, truth)).values == 0).all()


@pytest.mark.parametrize("turn", [0, 40, 314])
def test_a_pose_turned_by_a_symmetry_has_no_error_and_names_it(turn: int):
    model, truth = bumpy(0, turns(315)), pose(0)
    turned = truth @ model.symmetries[turn]
    assert errors.mssd(model, turned, truth).value == pytest.approx(0, abs=1e-12)
    assert errors.mssd(model, turned, truth).symmetry == turn
    assert errors.mspd(model, K, turned, truth).value == pytest.approx(0, abs=1e-9)
    assert errors.mspd(model, K, turned, truth).symmetry == turn


def test_many_symmetries_give_what_each_alone_gives_at_best():
    alone, model, estimate, truth = bumpy(5), bumpy(5, turns(315)), near(pose(5), 5, 1.0), pose(5)
    best = min(errors.mssd(alone, estimate, truth @ S).value for S in model.symmetries)
    assert errors.mssd(model, estimate, truth).value == pytest.approx(best, abs=1e-14)
    best = min(errors.mspd(alone, K, estimate, truth @ S).value for S in model.symmetries)
    assert errors.mspd(model, K, estimate, truth).value == pytest.approx(best, abs=1e-11)


def test_the_hull_is_exact_for_any_matrix():
    model, truth, estimate = bumpy(7), pose(7), pose(8)
    estimate[:3, :3] *= [[1.3, 0.2, -0.5], [0.9, 1.1, 0.4], [0.0, 0.3, 0.7]]
    assert errors.mssd(model, estimate, truth).value == pytest.approx(slow_mssd(model, estimate, truth)[0], abs=1e-12)


def test_a_shift_is_measured_as_itself():
    truth = pose(2)
    estimate = truth.copy()
    estimate[:3, 3] += [0.003, 0.0, -0.004]
    assert errors.mssd(bumpy(2), estimate, truth).value == pytest.approx(0.005)
    assert errors.add(bumpy(2), estimate, truth) == pytest.approx(0.005)
    assert errors.translation_error(estimate, truth) == pytest.approx(0.005)


def test_the_rotation_error_is_the_angle():
    truth = transform(rotation_about([1, 0, 2], 0.4), np.zeros(3))
    estimate = transform(rotation_about([0, 1, 1], 0.25) @ truth[:3, :3], np.zeros(3))
    assert errors.rotation_error(estimate, truth) == pytest.approx(0.25)


def test_poses_that_are_not_finite_have_infinite_error():
    model, good = bumpy(0, turns(2)), pose(0)
    for bad_value in (np.nan, np.inf):
        bad = good.copy()
        bad[1, 2] = bad_value
        bad[0, 3] = bad_value
        for estimate, truth in ((bad, good), (good, bad)):
            assert errors.mssd(model, estimate, truth) == (np.inf, -1, -1)
            assert errors.mspd(model, K, estimate, truth) == (np.inf, -1, -1)
            assert errors.add(model, estimate, truth) == np.inf
            assert errors.adi(model, estimate, truth) == np.inf
            assert errors.rotation_error(estimate, truth) == np.inf
            assert errors.translation_error(estimate, truth) == np.inf
            assert not errors.spheres_overlap(estimate, truth, 0.1)
            assert not errors.sphere_projections_overlap(estimate, truth, 0.1)
            assert (vsd_of_poses(model, SMALL, estimate, truth, measured(model, good)).values == 1).all()


def test_a_matrix_that_cannot_be_inverted_is_no_crash():
    flat = transform(np.zeros((3, 3)), np.array([0, 0, 0.4]))
    assert errors.rotation_error(pose(0), flat) == np.inf
    assert np.isfinite(errors.adi(bumpy(), flat, pose(0)))
    assert np.isfinite(errors.mssd(bumpy(), flat, pose(0)).value)


def test_a_vertex_in_the_camera_plane_has_infinite_mspd():
    model = Model(1, np.array([[0.0, 0, 0], [0.1, 0, 0], [0, 0.1, 0]]), np.array([[0, 1, 2]], np.int32), 0.14)
    in_plane = transform(np.eye(3), np.array([0.1, 0.1, 0.0]))
    assert errors.mspd(model, K, in_plane, pose(0)).value == np.inf


def test_the_spheres_that_spare_work_meet_as_in_bop():
    a = transform(np.eye(3), np.array([0.0, 0.0, 1.0]))
    b = transform(np.eye(3), np.array([0.1, 0.0, 1.0]))
    assert errors.spheres_overlap(a, b, 0.1 + 1e-9)
    assert not errors.spheres_overlap(a, b, 0.1)
    assert errors.sphere_projections_overlap(a, b, 0.1 + 1e-9)
    assert not errors.sphere_projections_overlap(a, b, 0.1 - 1e-9)
    assert not errors.sphere_projections_overlap(a, transform(np.eye(3), np.array([0.1, 0.0, 0.0])), 5.0)


def test_errors_do_not_depend_on_memory_layout_or_precision_of_the_arrays():
    model, truth, estimate = bumpy(0), pose(0).astype(np.float32), np.asfortranarray(near(pose(0), 0))
    estimate.flags.writeable = False
    value = errors.mssd(model, estimate, truth).value
    assert value == pytest.approx(slow_mssd(model, estimate, truth.astype(float))[0], abs=1e-12)
    assert errors.mspd(model, np.asfortranarray(K), estimate, truth).value > 0


# ---- the maps behind VSD


def test_the_maps_of_vsd_account_for_its_value():
    model, truth = bumpy(4), pose(4)
    result = vsd_of_poses(model, SMALL, near(truth, 4, 0.3, 0.015), truth, measured(model, truth))
    assert 0 < result.values[-1] < result.values[0] < 1
    for tau, value in zip(result.taus, result.values, strict=True):
        assert np.nanmean(result.cost(tau)) == pytest.approx(value)
    both = result.visible_estimate & result.visible_gt
    np.testing.assert_array_equal(~np.isnan(result.difference), both)
    np.testing.assert_array_equal(np.isnan(result.cost(0.1)), ~(result.visible_estimate | result.visible_gt))
    np.testing.assert_array_equal(result.expand(result.distance_gt) > 0, render(model, SMALL, truth).mask)
    assert result.expand(result.cost(0.1), fill=np.nan).shape == (48, 64)


def test_where_depth_is_missing_the_object_is_visible_since_2019_only():
    model, truth = bumpy(1), pose(1)
    nothing_measured = np.zeros((48, 64), np.float32)
    assert vsd_of_poses(model, SMALL, truth, truth, nothing_measured).visible_gt.any()
    before = vsd_of_poses(model, SMALL, truth, truth, nothing_measured, variant="bop18")
    assert not before.visible_gt.any()
    assert (before.values == 1).all()


def test_an_estimate_behind_the_visible_object_is_not_hidden_by_it():
    model, truth = bumpy(1), transform(np.eye(3), np.array([0, 0, 0.4]))
    estimate = transform(np.eye(3), np.array([0, 0, 0.46]))
    result = vsd_of_poses(model, SMALL, estimate, truth, slow_depth(model, SMALL, truth).astype(np.float32))
    over_the_object = (result.distance_estimate > 0) & result.visible_gt
    assert over_the_object.any()
    assert result.visible_estimate[over_the_object].all()


def test_renderings_side_by_side_or_empty_have_error_one():
    model, depth = bumpy(1), np.full((48, 64), 0.9, np.float32)
    left, right = (transform(np.eye(3), np.array([x, 0, 0.6])) for x in (-0.15, 0.15))
    assert (vsd_of_poses(model, SMALL, left, right, depth).values == 1).all()
    out_of_sight = transform(np.eye(3), np.array([9.0, 0, 0.6]))
    assert (vsd_of_poses(model, SMALL, left, out_of_sight, depth).values == 1).all()
    nothing = vsd_of_poses(model, SMALL, out_of_sight, out_of_sight, depth)
    assert (nothing.values == 1).all()
    assert nothing.cost(0.1).size == 0


def test_a_depth_image_of_another_size_is_refused_in_one_line():
    with pytest.raises(FormatError, match=r"depth image has 30 x 20 pixels, but its camera has 64 x 48; .*K"):
        vsd_of_poses(bumpy(), SMALL, pose(0), pose(0), np.zeros((20, 30), np.float32))


# ---- real data


def test_on_lmo_the_hull_and_the_pruning_change_nothing(lmo: Path):
    dataset = open_dataset(lmo)
    key = ImageKey(2, 3)
    for gt in dataset.ground_truth(key):
        model = dataset.model(gt.obj_id)
        for seed, angle in enumerate((0.05, 0.5, 3.0)):
            estimate, truth = near(gt.camera_from_model, seed, angle), gt.camera_from_model
            symmetric = [truth @ S for S in model.symmetries]
            value, vertex, symmetry = errors.mssd(model, estimate, truth)
            offsets = [np.linalg.norm(placed(model, estimate) - placed(model, each), axis=1) for each in symmetric]
            assert value == pytest.approx(min(offset.max() for offset in offsets), abs=1e-12)
            assert offsets[symmetry][vertex] == pytest.approx(value, abs=1e-12)
            value, vertex, symmetry = errors.mspd(model, K, estimate, truth)
            pixels = [placed(model, each) @ K.T for each in (estimate, *symmetric)]
            pixels = [each[:, :2] / each[:, 2:] for each in pixels]
            offsets = [np.linalg.norm(pixels[0] - each, axis=1) for each in pixels[1:]]
            assert value == pytest.approx(min(offset.max() for offset in offsets), abs=1e-9)
            assert offsets[symmetry][vertex] == pytest.approx(value, abs=1e-9)


def test_on_lmo_vsd_is_that_of_whole_images(lmo: Path):
    dataset = open_dataset(lmo)
    key = ImageKey(2, 3)
    camera, depth = dataset.camera(key), dataset.depth(key)
    assert depth is not None
    for gt in dataset.ground_truth(key)[:1]:
        model, truth = dataset.model(gt.obj_id), gt.camera_from_model
        estimate = near(truth, 1, 0.1, 0.004)
        rows = slice(*np.nonzero(render(model, camera, truth).mask.any(axis=1))[0][[0, -1]] + [-20, 20])
        whole = [render(model, camera, each).depth[rows] for each in (estimate, truth)]
        K_rows = camera.K - [[0, 0, 0], [0, 0, rows.start], [0, 0, 0]]
        expected = slow_vsd(*whole, depth[rows], K_rows, model.diameter, TAUS, 0.015, "bop19")
        result = vsd_of_poses(model, camera, estimate, truth, depth)
        np.testing.assert_allclose(result.values, expected, atol=2e-3)
        assert 0.2 < result.values[0] <= 1
