"""Poses from correspondences with known answers, as the default scheme finds them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fitting_cases import TAU, exact_correspondences, random_pose, reprojection_errors, right_instances, slow_quality

from pipeline.epos.fitting.config import FittingConfig
from pipeline.epos.fitting.correspondences import PotentialCorrespondences, correspondences_of_pixels
from pipeline.epos.fitting.fit import fit_poses
from pipeline.epos.fitting.results import Fitting
from pipeline.epos.fitting.synthetic import K, Symmetry, make_scene
from pipeline.geometry import project, rotation_error, transform_points

SYMMETRIES: tuple[Symmetry, ...] = ("two-fold", "continuous")


def same(one: Fitting, other: Fitting) -> bool:
    return one.stopped == other.stopped and all(
        np.array_equal(a.camera_from_model, b.camera_from_model) and np.array_equal(a.inliers, b.inliers)
        for a, b in zip(one.poses, other.poses, strict=True)
    )


@pytest.mark.parametrize("flat", [False, True])
@pytest.mark.parametrize("count", [8, 60, 3000])
def test_without_noise_the_pose_is_exact(count: int, flat: bool):
    """Also of points on a plane, where EPnP alone fails."""
    rng = np.random.default_rng(count)
    pose = random_pose(rng)
    fitting = fit_poses(exact_correspondences(rng, pose, count, flat), K)
    np.testing.assert_allclose(fitting.poses[0].camera_from_model, pose, atol=1e-5)
    assert fitting.poses[0].quality == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_array_equal(fitting.poses[0].inliers, np.arange(count))


@pytest.mark.parametrize("symmetry", SYMMETRIES)
@pytest.mark.parametrize("outliers", [0.3, 0.5, 0.7])
def test_one_instance_is_found_among_outliers_and_symmetric_alternatives(outliers: float, symmetry: Symmetry):
    found = [
        right_instances(scene, fit_poses(scene.correspondences, K))
        for scene in (make_scene(seed, 1, symmetry, outliers) for seed in range(4))
    ]
    assert found == [[0]] * 4


@pytest.mark.parametrize("symmetry", SYMMETRIES)
@pytest.mark.parametrize(("instances", "outliers"), [(3, 0.3), (3, 0.7), (10, 0.5)])
def test_several_instances_are_found(instances: int, outliers: float, symmetry: Symmetry):
    scene = make_scene(instances, instances, symmetry, outliers)
    fitting = fit_poses(scene.correspondences, K, instances=instances)
    assert right_instances(scene, fitting) == list(range(instances))
    assert fitting.stopped == f"as many as wanted: {instances}"


@pytest.mark.parametrize("instances", [1, 3, 10])
def test_the_number_of_instances_is_found_out(instances: int):
    scene = make_scene(20 + instances, instances, "two-fold", 0.4)
    fitting = fit_poses(scene.correspondences, K, instances=None)
    assert len(fitting.poses) == instances
    assert right_instances(scene, fitting) == list(range(instances))


@pytest.mark.parametrize("symmetry", SYMMETRIES)
@pytest.mark.parametrize("wanted", [2, 3])
def test_a_twin_under_the_symmetry_is_no_second_instance(symmetry: Symmetry, wanted: int):
    for seed in range(4):
        scene = make_scene(seed, 1, symmetry, 0.3)
        fitting = fit_poses(scene.correspondences, K, instances=wanted)
        assert len(fitting.poses) == 1
        assert right_instances(scene, fitting) == [0]
        assert "others claim the same pixels" in fitting.stopped


def test_the_twin_is_returned_where_that_is_wanted():
    scene = make_scene(0, 1, "two-fold", 0.3)
    fitting = fit_poses(scene.correspondences, K, FittingConfig(reject_twins=False), instances=2)
    assert len(fitting.poses) == 2


def test_inliers_are_one_a_pixel_and_below_the_threshold():
    scene = make_scene(5, 3, "two-fold", 0.5)
    c = scene.correspondences
    fitting = fit_poses(c, K, instances=3)
    pixels = np.concatenate([c.pixel_ids[pose.inliers] for pose in fitting.poses])
    assert len(pixels) == len(np.unique(pixels)) > 200
    assert fitting.pixels == len(np.unique(c.pixel_ids))
    for pose in fitting.poses:
        error = reprojection_errors(c, pose.camera_from_model)[pose.inliers]
        assert error.max() < TAU + 1e-3
        assert pose.quality == pytest.approx(np.sum(1 - error**2 / TAU**2) / fitting.pixels, abs=1e-4)


def test_the_quality_of_one_instance_is_the_thesis_s():
    c = make_scene(6, 1, "two-fold", 0.5).correspondences
    pose = fit_poses(c, K).poses[0]
    assert pose.quality == pytest.approx(slow_quality(c, pose.camera_from_model), abs=1e-4)


@pytest.mark.parametrize("scheme", ["pooled", "progressive_x"])
def test_the_result_depends_on_the_arguments_alone(scheme: str):
    scene = make_scene(7, 3, "continuous", 0.5)
    config = FittingConfig(scheme=scheme)  # pyright: ignore[reportArgumentType]
    once, again, otherwise = (fit_poses(scene.correspondences, K, config, instances=3, seed=s) for s in (1, 1, 2))
    assert same(once, again)
    assert not same(once, otherwise)


def test_arguments_are_left_as_they_were_and_may_be_read_only_or_of_other_types():
    c = make_scene(8, 1, "two-fold", 0.5).correspondences
    arrays = {name: getattr(c, name).copy() for name in ("pixels", "points_in_model", "confidence", "pixel_ids")}
    for array in arrays.values():
        array.setflags(write=False)
    once = fit_poses(PotentialCorrespondences(1, **arrays), K)
    assert same(once, fit_poses(c, K))
    halves = replace(c, pixels=c.pixels.astype(np.float32), pixel_ids=c.pixel_ids.astype(np.int32))
    assert same(once, fit_poses(halves, K))  # their pixels are exact in float32, too
    for name, array in arrays.items():
        np.testing.assert_array_equal(array, getattr(c, name))


def test_the_order_of_the_correspondences_does_not_matter_to_what_is_found():
    scene = make_scene(9, 3, "two-fold", 0.5)
    c = scene.correspondences
    order = np.random.default_rng(0).permutation(len(c))
    fitting = fit_poses(c.at(order), K, instances=3)
    assert right_instances(scene, fitting) == [0, 1, 2]
    for pose in fitting.poses:
        assert reprojection_errors(c.at(order), pose.camera_from_model)[pose.inliers].max() < TAU + 1e-3


def test_confident_correspondences_are_tried_first():
    """At 95 % outliers, chance needs thousands of triplets; confidence tells the right ones."""
    rng = np.random.default_rng(10)
    pose = random_pose(rng)
    right = exact_correspondences(rng, pose, 100)
    wrong = exact_correspondences(rng, random_pose(rng), 1900)
    pixels = np.concatenate([right.pixels, rng.permutation(wrong.pixels)])
    points = np.concatenate([right.points_in_model, wrong.points_in_model])
    confidence = np.repeat([0.9, 0.1], [100, 1900])
    fitting = fit_poses(correspondences_of_pixels(1, pixels, points, confidence), K)
    np.testing.assert_allclose(fitting.poses[0].camera_from_model, pose, atol=2e-3)


def test_a_skewed_camera_and_unequal_focal_lengths_are_obeyed():
    camera = np.array([[700.0, 25.0, 310.0], [0.0, 540.0, 255.0], [0.0, 0.0, 1.0]])
    rng = np.random.default_rng(11)
    pose, points = random_pose(rng), rng.uniform(-0.05, 0.05, (200, 3))
    seen = project(camera, transform_points(pose, points))
    found = fit_poses(correspondences_of_pixels(1, seen, points, np.ones(200)), camera).poses[0]
    np.testing.assert_allclose(found.camera_from_model, pose, atol=1e-5)


def test_an_object_larger_than_its_distance_is_found():
    rng = np.random.default_rng(12)
    pose = random_pose(rng, 0.5)
    points = rng.uniform(-1, 1, (4000, 3)) * [0.9, 0.7, 0.7]
    seen = transform_points(pose, points)
    pixels = project(K, seen)
    inside = (seen[:, 2] > 0.05) & np.all((pixels > 0) & (pixels < (640, 480)), axis=1)
    found = fit_poses(correspondences_of_pixels(1, pixels[inside], points[inside], np.ones(inside.sum())), K).poses[0]
    np.testing.assert_allclose(found.camera_from_model, pose, atol=1e-3)


@pytest.mark.parametrize(("instances", "pixels"), [(1, 60), (3, 240)])
def test_few_scattered_pixels_are_enough(instances: int, pixels: int):
    """As of keypoints, or of a coarse network: hardly any pixel has neighbours."""
    right = 0
    for seed in range(5):
        scene = make_scene(50 + seed, instances, "two-fold", 0.3)
        ids = np.unique(scene.correspondences.pixel_ids)
        kept = np.random.default_rng(seed).choice(ids, pixels, replace=False)
        few = scene.correspondences.at(np.flatnonzero(np.isin(scene.correspondences.pixel_ids, kept)))
        right += len(right_instances(scene, fit_poses(few, K, instances=instances)))
    assert right >= 5 * instances - 1


@pytest.mark.parametrize("instances", [1, 3])
def test_small_distant_instances_are_found(instances: int):
    """About 46 px across, 126 pixels each."""
    right = 0
    for seed in range(5):
        scene = make_scene(60 + seed, instances, "two-fold", 0.4, noise_px=0.5, distance=(1.0, 1.2))
        right += len(right_instances(scene, fit_poses(scene.correspondences, K, instances=instances)))
    assert right >= 5 * instances - 1


def test_an_instance_mostly_hidden_by_another_is_found_beside_it():
    scene = make_scene(13, 3, "two-fold", 0.3)
    c = scene.correspondences
    hidden = (scene.instance == 1) & (c.pixels[:, 0] > np.quantile(c.pixels[scene.instance == 1, 0], 0.35))
    fitting = fit_poses(c.at(np.flatnonzero(~hidden)), K, instances=3)
    assert right_instances(scene, fitting) == [0, 1, 2]


@pytest.mark.parametrize("scheme", ["pooled", "progressive_x"])
def test_real_correspondences_give_the_given_pose(shared_data: Path, scheme: str):
    """95 of LM-O; rotation within one degree."""
    folder = shared_data / "correspondences"
    numbers, given = np.loadtxt(folder / "pose6dscene_points.txt"), np.loadtxt(folder / "pose6dscene_gt.txt")
    pairs = correspondences_of_pixels(1, numbers[:, :2].copy(), numbers[:, 2:] / 1000, np.ones(len(numbers)))
    config = FittingConfig(scheme=scheme)  # pyright: ignore[reportArgumentType]
    for seed in range(5):
        pose = fit_poses(pairs, np.loadtxt(folder / "pose6dscene.K"), config, seed=seed).poses[0].camera_from_model
        assert np.degrees(rotation_error(pose[:3, :3], given[:, :3])) < 1.0
        assert np.linalg.norm(1000 * pose[:3, 3] - given[:, 3]) < 5.0


@pytest.mark.parametrize("outliers", [0.3, 0.6])
def test_real_correspondences_are_fitted_among_added_outliers(shared_data: Path, outliers: float):
    folder = shared_data / "correspondences"
    numbers, given = np.loadtxt(folder / "pose6dscene_points.txt"), np.loadtxt(folder / "pose6dscene_gt.txt")
    rng = np.random.default_rng(14)
    wrong = rng.random(len(numbers)) < outliers
    numbers[wrong, 2:] = rng.permutation(numbers[wrong, 2:])
    pairs = correspondences_of_pixels(1, numbers[:, :2].copy(), numbers[:, 2:] / 1000, np.ones(len(numbers)))
    pose = fit_poses(pairs, np.loadtxt(folder / "pose6dscene.K")).poses[0].camera_from_model
    assert np.degrees(rotation_error(pose[:3, :3], given[:, :3])) < 1.0


def test_single_poses_are_as_accurate_as_poselib_s():
    """PoseLib (BSD) is no dependency: pip install poselib to run this."""
    poselib = pytest.importorskip("poselib", reason="PoseLib absent: pip install poselib")
    from pipeline.bop import errors

    ours, theirs = [], []
    for seed in range(6):
        scene = make_scene(30 + seed, 1, "two-fold", 0.5)
        c = scene.correspondences.at(np.argsort(-scene.correspondences.confidence, kind="stable"))
        camera = {"model": "PINHOLE", "width": 640, "height": 480, "params": [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]}
        options = {"max_reproj_error": TAU, "max_iterations": 2000, "progressive_sampling": True}
        rt = poselib.estimate_absolute_pose(c.pixels, c.points_in_model, camera, options, {})[0].Rt
        truth, found = scene.camera_from_model[0], fit_poses(scene.correspondences, K).poses[0].camera_from_model
        ours.append(errors.mspd(scene.model, K, found, truth).value)
        theirs.append(errors.mspd(scene.model, K, np.vstack([rt, [0, 0, 0, 1]]), truth).value)
    assert np.median(ours) < 1.2 * np.median(theirs)
