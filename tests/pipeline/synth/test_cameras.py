"""Sampled cameras: uniform in their ranges, aimed at the focus, and what bad ranges are answered with."""

from math import inf, nan

import numpy as np
import pytest
from scipy import stats

from pipeline.bop.dataset import open_dataset
from pipeline.bop.writer import AnnotatedImage, write_scene
from pipeline.exceptions import InputError
from pipeline.geometry import inverse, project, transform, transform_points
from pipeline.scene import Camera, GroundTruth, Image, ImageKey
from pipeline.synth.cameras import (
    CameraRanges,
    CameraSettingsError,
    Viewpoint,
    ranges_of_dataset,
    sample_view,
    viewpoints_of,
    world_from_camera,
)
from pipeline.synth.cameras.dataset_ranges import smallest_arc

FOCUS = np.array([0.3, -1.2, 0.8])
RANGES = CameraRanges(azimuth_deg=(-40.0, 200.0), elevation_deg=(-10.0, 70.0), distance=(0.4, 1.7), roll_deg=(-60, 90))
NAMES = ("azimuth_deg", "elevation_deg", "distance", "roll_deg")


def sampled(ranges: CameraRanges, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Poses of cameras, and their four numbers as columns; azimuths from the lower limit up."""
    rng = np.random.default_rng(seed)
    poses = np.array([sample_view(ranges, FOCUS, rng) for _ in range(count)])
    found = np.stack(viewpoints_of(poses, np.tile(FOCUS, (count, 1))), axis=1)
    found[:, 0] = ranges.azimuth_deg[0] + (found[:, 0] - ranges.azimuth_deg[0] + 1e-9) % 360
    return poses, found


def test_sampled_cameras_are_uniform_in_every_range_and_independent():
    _, found = sampled(RANGES, 3000)
    for column, name in enumerate(NAMES):
        low, high = getattr(RANGES, name)
        assert stats.kstest(found[:, column], "uniform", (low, high - low)).pvalue > 0.01, name
        for other in range(column):
            assert abs(stats.spearmanr(found[:, column], found[:, other]).statistic) < 0.05


def test_the_optical_axis_meets_the_focus_and_poses_are_rigid():
    poses, found = sampled(RANGES, 50)
    for pose, distance in zip(poses, found[:, 2], strict=True):
        np.testing.assert_allclose(transform_points(inverse(pose), FOCUS), (0, 0, distance), atol=1e-12)
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)


def test_angles_are_those_of_the_direction_to_the_camera():
    centre = world_from_camera(Viewpoint(90.0, 30.0, 2.0, 0.0), FOCUS)[:3, 3]
    np.testing.assert_allclose(centre - FOCUS, (0.0, 2 * np.cos(np.pi / 6), 1.0), atol=1e-12)


def test_without_roll_up_is_up_in_the_image_and_roll_turns_the_camera():
    K = np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]])
    above = FOCUS + np.array([0.0, 0.0, 0.1])
    for roll, direction in ((0.0, (0, -1)), (90.0, (-1, 0)), (180.0, (0, 1))):
        pose = world_from_camera(Viewpoint(70.0, 20.0, 1.0, roll), FOCUS)
        u, v = project(K, transform_points(inverse(pose), above)) - (320, 240)
        np.testing.assert_allclose(np.array([u, v]) / np.hypot(u, v), direction, atol=1e-9)


def test_straight_from_above_and_below_is_defined():
    for elevation in (90.0, -90.0):
        pose = world_from_camera(Viewpoint(25.0, elevation, 0.5, 10.0), FOCUS)
        np.testing.assert_allclose(pose[:3, 3] - FOCUS, (0, 0, 0.5 * np.sign(elevation)), atol=1e-12)
        assert np.linalg.det(pose[:3, :3]) == pytest.approx(1.0)


def test_equal_limits_fix_a_value_and_the_seed_decides():
    fixed = CameraRanges((30.0, 30.0), (40.0, 40.0), (0.7, 0.7), (5.0, 5.0))
    _, found = sampled(fixed, 3)
    np.testing.assert_allclose(found, [(30, 40, 0.7, 5)] * 3, atol=1e-6)
    np.testing.assert_array_equal(sampled(RANGES, 5, seed=4)[0], sampled(RANGES, 5, seed=4)[0])
    assert (sampled(RANGES, 5, seed=4)[0] != sampled(RANGES, 5, seed=5)[0]).any()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"azimuth_deg": (90.0, 10.0)}, "azimuth_deg 90 to 10: the lower limit is above the upper; swap them"),
        ({"azimuth_deg": (0.0, 400.0)}, "azimuth_deg 0 to 400: more than a full turn; take at most 360 between low and high"),
        ({"elevation_deg": (10.0, 95.0)}, "elevation_deg 10 to 95: outside -90 to 90; an elevation is an angle above the horizon"),
        ({"elevation_deg": (nan, 20.0)}, "elevation_deg nan to 20: not finite; give two numbers, low and high"),
        ({"distance": (0.0, 1.0)}, "distance 0 to 1: not above 0; give the distance from the object in metres"),
        ({"distance": (0.5, inf)}, "distance 0.5 to inf: not finite; give two numbers, low and high"),
        ({"roll_deg": (-181.0, 181.0)}, "roll_deg -181 to 181: more than a full turn; take at most 360 between low and high"),
    ],
)  # fmt: skip
def test_ranges_that_no_camera_can_keep_are_told_in_one_line(values, message):
    with pytest.raises(CameraSettingsError) as caught:
        CameraRanges(**values)
    assert str(caught.value) == message
    assert isinstance(caught.value, InputError)


# ---- ranges of a dataset


@pytest.mark.parametrize(
    ("angles", "arc"),
    [
        ([10.0, 50.0, 30.0], (10, 50)),
        ([350.0, 20.0, 5.0], (-10, 20)),
        ([170.0, 190.0], (170, 190)),
        ([0.0, 120.0, 240.0], (120, 360)),
        ([77.0], (77, 77)),
        ([200.0, 200.0], (-160, -160)),
    ],
)
def test_the_smallest_arc_goes_round_the_widest_gap(angles, arc):
    np.testing.assert_allclose(smallest_arc(np.array(angles)), arc, atol=1e-9)


def write_views(root, poses, world_from_model, *, with_world: bool):
    """A dataset whose images show object 1 from cameras at these poses."""
    K = np.array([[500.0, 0, 31.5], [0, 500, 23.5], [0, 0, 1]])
    rgb = np.zeros((48, 64, 3), np.uint8)
    images = []
    for im_id, pose in enumerate(poses):
        camera = Camera(K, 64, 48, pose if with_world else None)
        truth = GroundTruth(1, inverse(pose) @ world_from_model, 0)
        images.append(AnnotatedImage(Image(ImageKey(1, im_id), camera, rgb, None), [truth]))
    write_scene(root, "test", 1, images)
    return root


def assert_nearly(found: CameraRanges, wanted: CameraRanges) -> None:
    """Within the wanted ranges, and nearly as wide."""
    for name in NAMES:
        (low, high), (least, most) = getattr(found, name), getattr(wanted, name)
        slack = 0.08 * (most - least)
        assert least - 1e-6 <= low < least + slack, name
        assert most - slack < high <= most + 1e-6, name


def test_ranges_of_a_dataset_are_those_that_it_was_sampled_from(tmp_path):
    poses, _ = sampled(RANGES, 120)
    lying = transform(np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]), FOCUS)
    root = write_views(tmp_path / "made", poses, lying, with_world=True)
    assert_nearly(ranges_of_dataset(root, "test", roll_deg=None), RANGES)  # by the world, the object's y is up
    other = ranges_of_dataset(open_dataset(root), axes="model")
    assert other.elevation_deg[0] < -40
    assert other.distance == ranges_of_dataset(root).distance
    assert other.roll_deg == (-180.0, 180.0)


def test_without_camera_poses_the_models_frame_says_what_is_up(tmp_path):
    poses, _ = sampled(RANGES, 120)
    root = write_views(tmp_path / "made", poses, transform(np.eye(3), FOCUS), with_world=False)
    assert_nearly(ranges_of_dataset(root, roll_deg=None), RANGES)
    with pytest.raises(InputError, match=r"scene 1, image 0 has no camera pose .*; take the axes of the models"):
        ranges_of_dataset(root, axes="world")


def test_a_dataset_without_annotations_gives_no_ranges(tmp_path):
    root = write_views(tmp_path / "bare", [], np.eye(4), with_world=True)
    image = Image(ImageKey(1, 0), Camera(np.eye(3), 64, 48), np.zeros((48, 64, 3), np.uint8), None)
    write_scene(root, "test", 1, [AnnotatedImage(image)])
    with pytest.raises(InputError, match="has no ground-truth poses; give the ranges yourself or take another split"):
        ranges_of_dataset(root)


def test_ranges_of_lmo(lmo):
    found = ranges_of_dataset(lmo)
    distances = [
        np.linalg.norm(truth.camera_from_model[:3, 3])
        for dataset in [open_dataset(lmo)]
        for key in dataset.images()
        for truth in dataset.ground_truth(key)
    ]
    assert found.distance == pytest.approx((min(distances), max(distances)))
    assert 0 < found.elevation_deg[0] < found.elevation_deg[1] < 90  # upright objects on a table, seen from above


def test_ranges_of_ycbv_and_of_icbin_without_ground_truth(ycbv, shared_data):
    assert ranges_of_dataset(ycbv).distance == pytest.approx((0.546, 0.626), abs=1e-3)
    with pytest.raises(InputError, match="has no ground-truth poses"):
        ranges_of_dataset(shared_data / "icbin")
