"""Bad and degenerate input to fitting: no pose or one line, never a hang, a crash or a number that is none."""

import time
from dataclasses import replace

import numpy as np
import pytest
from fitting_cases import exact_correspondences, random_pose
from hypothesis import given, settings
from hypothesis import strategies as st

from pipeline.epos.fitting.config import FittingConfig, Scheme
from pipeline.epos.fitting.correspondences import PotentialCorrespondences, correspondences_of_pixels
from pipeline.epos.fitting.fit import fit_poses
from pipeline.epos.fitting.results import Fitting, FittingTrace
from pipeline.epos.fitting.synthetic import K, make_scene
from pipeline.exceptions import InputError

SCHEMES: list[Scheme] = ["pooled", "progressive_x"]

both = pytest.mark.parametrize("config", [FittingConfig(scheme) for scheme in SCHEMES], ids=SCHEMES)


def made(pixels: np.ndarray, points: np.ndarray) -> PotentialCorrespondences:
    return correspondences_of_pixels(7, pixels, points, np.ones(len(pixels)))


def assert_sound(fitting: Fitting, c: PotentialCorrespondences) -> None:
    for pose in fitting.poses:
        assert np.isfinite(pose.camera_from_model).all()
        np.testing.assert_allclose(
            pose.camera_from_model[:3, :3] @ pose.camera_from_model[:3, :3].T, np.eye(3), atol=1e-6
        )
        assert 0 <= pose.quality <= 1 + 1e-6
        assert np.all((pose.inliers >= 0) & (pose.inliers < len(c)))


@both
@pytest.mark.parametrize("count", [0, 1, 2])
def test_fewer_than_three_pixels_have_no_pose(config: FittingConfig, count: int):
    rng, trace = np.random.default_rng(0), FittingTrace()
    fitting = fit_poses(exact_correspondences(rng, random_pose(rng), count), K, config, trace=trace)
    assert (fitting.poses, fitting.pixels) == ((), count)
    assert fitting.stopped == f"{count} pixels; a pose needs 3"
    assert [event.text for event in trace.events] == [fitting.stopped]


@both
@pytest.mark.parametrize("count", [3, 4, 5])
def test_fewer_pixels_than_an_instance_must_explain_have_no_pose(config: FittingConfig, count: int):
    rng = np.random.default_rng(1)
    assert fit_poses(exact_correspondences(rng, random_pose(rng), count), K, config).poses == ()


@both
@pytest.mark.parametrize(
    "case", ["one point repeated", "one pixel repeated", "points on a line", "pixels on a line", "all the same"]
)
def test_degenerate_geometry_has_no_pose(config: FittingConfig, case: str):
    rng = np.random.default_rng(2)
    pixels, points = rng.uniform(100, 400, (200, 2)), rng.uniform(-0.05, 0.05, (200, 3))
    if case in ("one point repeated", "all the same"):
        points[:] = points[0]
    if case in ("one pixel repeated", "all the same"):
        pixels[:] = pixels[0]
    if case == "points on a line":
        points = points[:, :1] * np.array([[1.0, 2.0, -1.0]])
    if case == "pixels on a line":
        pixels = pixels[:, :1] * np.array([[1.0, 0.5]])
    for instances in (1, 2, None):
        fitting = fit_poses(made(pixels, points), K, config, instances=instances)
        assert fitting.poses == (), fitting.stopped


@both
def test_rows_that_are_not_finite_are_left_out(config: FittingConfig):
    rng = np.random.default_rng(3)
    pose = random_pose(rng)
    c = exact_correspondences(rng, pose, 80)
    pixels, points, confidence = c.pixels.copy(), c.points_in_model.copy(), c.confidence.copy()
    pixels[0, 1], pixels[3], points[10, 2], points[11], confidence[20], confidence[21], confidence[22] = (
        np.nan,
        np.inf,
        np.nan,
        -np.inf,
        np.nan,
        -0.5,
        np.inf,
    )
    pixels[30] = 1e12
    bad = [0, 3, 10, 11, 20, 21, 22, 30]
    broken = PotentialCorrespondences(1, pixels, points, confidence, rng.permutation(80))
    fitting = fit_poses(broken, K, config)
    np.testing.assert_allclose(fitting.poses[0].camera_from_model, pose, atol=1e-4)
    np.testing.assert_array_equal(fitting.poses[0].inliers, np.setdiff1d(np.arange(80), bad))
    assert fitting.pixels == 72


@both
def test_nothing_but_nan_is_no_pixel(config: FittingConfig):
    c = made(np.full((50, 2), np.nan), np.full((50, 3), np.nan))
    assert fit_poses(c, K, config).stopped == "0 pixels; a pose needs 3"


def test_absurd_points_among_good_ones_do_no_harm():
    rng = np.random.default_rng(4)
    pose = random_pose(rng)
    c = exact_correspondences(rng, pose, 300)
    points = c.points_in_model.copy()
    points[:30] = rng.normal(size=(30, 3)) * 10.0 ** rng.uniform(1, 300, (30, 1))
    fitting = fit_poses(replace(c, points_in_model=points), K)
    np.testing.assert_allclose(fitting.poses[0].camera_from_model, pose, atol=1e-5)


def test_confidences_of_zero_are_as_good_as_equal_ones():
    rng = np.random.default_rng(5)
    pose = random_pose(rng)
    c = replace(exact_correspondences(rng, pose, 100), confidence=np.zeros(100))
    np.testing.assert_allclose(fit_poses(c, K).poses[0].camera_from_model, pose, atol=1e-5)


@both
def test_pure_noise_ends_soon(config: FittingConfig):
    rng = np.random.default_rng(6)
    c = made(rng.integers(0, 160, (3000, 2)) * 4 + 1.5, rng.uniform(-0.05, 0.05, (3000, 3)))
    for instances in (1, 5, None):
        assert_sound(fit_poses(c, K, config, instances=instances), c)


def test_absurdly_many_instances_are_no_burden():
    scene = make_scene(7, 1, "two-fold", 0.3)
    fitting = fit_poses(scene.correspondences, K, instances=10**9)
    assert 1 <= len(fitting.poses) <= 3


def test_huge_numbers_of_correspondences_are_fitted_in_seconds():
    rng = np.random.default_rng(8)
    pose = random_pose(rng)
    c = exact_correspondences(rng, pose, 200_000)
    start = time.perf_counter()
    fitting = fit_poses(c, K)
    assert time.perf_counter() - start < 20  # 0.2 s on one core: this is no benchmark
    np.testing.assert_allclose(fitting.poses[0].camera_from_model, pose, atol=1e-4)


def test_hundreds_of_alternatives_at_a_pixel_are_fitted():
    """A network without an idea: each pixel is linked with every fragment."""
    rng = np.random.default_rng(9)
    pose = random_pose(rng)
    right = exact_correspondences(rng, pose, 120)
    ids = np.repeat(np.arange(120), 257)
    points = rng.uniform(-0.05, 0.05, (len(ids), 3))
    points[::257] = right.points_in_model
    confidence = rng.uniform(0, 0.5, len(ids))
    confidence[::257] = 1.0
    c = PotentialCorrespondences(1, right.pixels[ids], points, confidence, ids)
    found = fit_poses(c, K)
    assert_sound(found, c)
    np.testing.assert_allclose(found.poses[0].camera_from_model, pose, atol=2e-3)


@settings(max_examples=60)
@given(data=st.data())
def test_any_numbers_give_sound_poses_or_none(data: st.DataObject):
    count = data.draw(st.integers(0, 40))
    number = st.one_of(
        st.floats(-700, 700), st.sampled_from([0.0, -0.0, 1e-300, 1e300, -1e30, np.nan, np.inf, 1e5, 3.0, 100.0])
    )
    row = st.lists(number, min_size=6, max_size=6)
    numbers = np.array(data.draw(st.lists(row, min_size=count, max_size=count)), float).reshape(count, 6)
    ids = np.array(data.draw(st.lists(st.integers(-3, 12), min_size=count, max_size=count)), int)
    c = PotentialCorrespondences(1, numbers[:, :2], numbers[:, 2:5], numbers[:, 5], ids)
    for scheme in SCHEMES:
        assert_sound(fit_poses(c, K, FittingConfig(scheme), instances=data.draw(st.sampled_from([1, 3, None]))), c)


@pytest.mark.parametrize(
    ("broken", "shown"),
    [
        (np.zeros((3, 3)), "K is"),
        (K.T, "K is"),
        (-K, "K is"),
        (np.where(K > 500, np.nan, K), "K is"),
    ],
)
def test_a_camera_that_is_none_is_refused(broken: np.ndarray, shown: str):
    c = exact_correspondences(np.random.default_rng(10), random_pose(np.random.default_rng(10)))
    with pytest.raises(InputError, match=shown) as caught:
        fit_poses(c, broken)
    assert "\n" not in str(caught.value)
    assert "expected [[fx, s, cx]" in str(caught.value)


def test_wrong_arguments_are_refused_in_one_line():
    c = exact_correspondences(np.random.default_rng(11), random_pose(np.random.default_rng(11)))
    with pytest.raises(InputError, match=r"^fitting: -1 instances asked for; expected 0 or more, or None to find out$"):
        fit_poses(c, K, instances=-1)
    for seed in (-1, 1 << 64):
        with pytest.raises(InputError, match=f"^fitting: seed is {seed}; expected 0 to 2\\^64 - 1$"):
            fit_poses(c, K, seed=seed)
    assert fit_poses(c, K, instances=0).stopped == "no instance was asked for"


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"inlier_threshold_px": 0.0}, "inlier_threshold_px is 0.0; expected a number above 0"),
        ({"inlier_threshold_px": float("nan")}, "inlier_threshold_px is nan; expected a number above 0"),
        ({"draws_per_pixel": float("inf")}, "draws_per_pixel is inf; expected a number above 0"),
        ({"max_iterations": 0}, "max_iterations is 0; expected a number above 0"),
        ({"max_iterations": 10**9}, "max_iterations is 1000000000; expected 1,000,000 at most"),
        ({"min_triangle_area_px2": -1.0}, "min_triangle_area_px2 is -1.0; expected a number from 0"),
        ({"quality_threshold": 1.5}, "quality_threshold is 1.5; expected 0 to 1"),
        (
            {"neighbour_distance_px": (5.0, 5.0)},
            r"neighbour_distance_px is \(5.0, 5.0\); expected a smaller and a larger",
        ),
    ],
)
def test_a_config_out_of_range_is_refused(wrong: dict, message: str):
    with pytest.raises(InputError, match=f"^fitting: {message}"):
        FittingConfig(**wrong)


def test_arrays_of_different_lengths_are_refused():
    short = PotentialCorrespondences.__new__(PotentialCorrespondences)  # past the shape checks of tests
    arrays = (np.zeros((5, 2)), np.zeros((5, 3)), np.zeros(4), np.arange(5), None)
    for name, array in zip(
        ("pixels", "points_in_model", "confidence", "pixel_ids", "fragment_ids"), arrays, strict=True
    ):
        object.__setattr__(short, name, array)
    object.__setattr__(short, "obj_id", 7)
    with pytest.raises(
        InputError, match=r"^correspondences of object 7: confidence has shape \(4,\); expected \(5,\)$"
    ):
        short.__post_init__()
