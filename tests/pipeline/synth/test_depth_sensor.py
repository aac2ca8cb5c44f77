"""Sensors: what they do to depth is what they state: line, noise, steps, holes, range."""

from dataclasses import replace
from math import pi

import numpy as np
import pytest
from scipy import stats

from pipeline.bop.dataset import open_dataset
from pipeline.exceptions import InputError, UnknownIdError
from pipeline.scene import ImageKey
from pipeline.synth.sensors import CAMERAS, SENSORS, DepthSensor, depth_sensor, sensor_camera
from pipeline.synth.sensors.presets import DISPARITY_STEP
from pipeline.synth.sensors.surface import incidence, shadow, steps

CAMERA = sensor_camera("kinect_v1")
K = CAMERA.K


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def plane(z: float, tilt_deg: float = 0.0, axis: int = 1) -> np.ndarray:
    """Depth of a plane through (0, 0, z), tilted about the y (axis 1: along the rows) or the x axis."""
    v, u = np.indices((CAMERA.height, CAMERA.width))
    along = (u - K[0, 2]) / K[0, 0] if axis == 1 else (v - K[1, 2]) / K[1, 1]
    with np.errstate(divide="ignore"):
        depth = z / (1 - np.tan(np.radians(tilt_deg)) * along)
    return np.where(depth > 0, depth, 0.0)


def board_before_wall(near: float, far: float, columns: slice) -> np.ndarray:
    depth = plane(far)
    depth[100:400, columns] = near
    return depth


# ---- presets


def test_the_exact_sensor_changes_nothing_and_draws_nothing():
    depth = (rng().random((48, 64)) * 9).astype(np.float32)
    depth[rng(1).random(depth.shape) < 0.2] = 0
    generator = rng()
    measured = depth_sensor("exact").measure(depth, K, generator)
    np.testing.assert_array_equal(measured, depth)
    assert measured is not depth
    assert generator.random() == rng().random()


@pytest.mark.parametrize("name", SENSORS)
def test_sensors_measure_again_what_they_measured_with_the_same_seed(name):
    depth = board_before_wall(0.8, 1.3, slice(200, 400))
    kept = depth.copy()
    first, again, other = (depth_sensor(name).measure(depth, K, rng(seed)) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (name == "exact") == bool((first == other).all())
    assert first.dtype == np.float32
    np.testing.assert_array_equal(depth, kept)


@pytest.mark.parametrize("name", SENSORS)
def test_where_nothing_is_nothing_is_measured(name):
    depth = board_before_wall(0.8, 1.0, slice(200, 400))
    depth[depth == 1.0] = 0.0
    measured = depth_sensor(name).measure(depth, K, rng())
    assert (measured[:90] == 0).all()
    assert (measured[110:390, 230:390] > 0).mean() > 0.99
    assert (depth_sensor(name).measure(np.zeros((48, 64)), K, rng()) == 0).all()


def test_unknown_names_are_told_with_those_there_are():
    with pytest.raises(UnknownIdError, match="depth sensor realsense is not in the presets; available: carmine, exact"):
        depth_sensor("realsense")
    with pytest.raises(UnknownIdError, match="camera canon is not in the presets; available: carmine, carmine_tless"):
        sensor_camera("canon")


@pytest.mark.parametrize("name", CAMERAS)
def test_intrinsics_see_the_middle_of_their_image(name):
    camera = sensor_camera(name)
    assert abs(camera.K[0, 2] / camera.width - 0.5) < 0.02
    assert abs(camera.K[1, 2] / camera.height - 0.5) < 0.02
    field_of_view = 2 * np.degrees(np.arctan(camera.width / 2 / camera.K[0, 0]))
    assert 35 < field_of_view < 75
    assert sensor_camera(name).K is not camera.K


def test_intrinsics_of_the_kinect_are_those_of_lmo(lmo):
    camera = open_dataset(lmo).camera(ImageKey(2, 3))
    np.testing.assert_allclose(camera.K, K)
    assert (camera.width, camera.height) == (CAMERA.width, CAMERA.height)


# ---- the linear error


@pytest.mark.parametrize(("name", "a", "b"), [("carmine", 1.0247, -0.00519), ("kinect_v2", 1.0266, -0.02688)])
def test_a_line_fitted_to_measured_depth_gives_back_the_correction(name, a, b):
    """In the range of T-LESS, 0.53 to 0.92 m; pixels far enough apart to be independent."""
    true, measured = [], []
    for k, z in enumerate(np.linspace(0.53, 0.92, 14)):
        depth = plane(float(z))
        found = depth_sensor(name).measure(depth, K, rng(k))
        true.append(depth[10::30, 10::30].ravel())
        measured.append(found[10::30, 10::30].ravel())
    d_c, d = np.concatenate(true), np.concatenate(measured)
    assert (d > 0).all()
    fit = stats.linregress(d_c, d)  # the noise is in d: d = d_c / a - b / a
    assert abs(fit.slope - 1 / a) < 2.5 * fit.stderr
    assert abs(fit.intercept + b / a) < 2.5 * fit.intercept_stderr
    assert fit.stderr < 0.05 * (1 - 1 / a)  # the error is well above what is uncertain
    direct = np.polyfit(d, d_c, 1)  # what depth correction does
    np.testing.assert_allclose(direct, (a, b), atol=0.003)
    assert depth_sensor(name).corrected == replace(depth_sensor(name), a=1.0, b=0.0)


@pytest.mark.parametrize(("name", "published_mm"), [("carmine", 12.4), ("kinect_v2", 7.0)])
def test_the_error_is_as_large_as_the_thesis_reports(name, published_mm):
    """Mean absolute difference before correction (thesis sec. tless_depth_correction)."""
    differences = [
        np.abs(depth_sensor(name).measure(plane(float(z)), K, rng())[::20, ::20] - z).mean()
        for z in np.linspace(0.53, 0.92, 9)
    ]
    assert 1000 * np.mean(differences) == pytest.approx(published_mm, abs=0.7)


# ---- noise


@pytest.mark.parametrize("name", ["kinect_v1", "kinect_v2"])
@pytest.mark.parametrize(("z", "tilt"), [(0.6, 0.0), (1.0, 0.0), (2.0, 0.0), (3.0, 0.0), (1.0, 45.0)])
def test_noise_is_as_strong_as_stated(name, z, tilt):
    sensor = replace(depth_sensor(name).corrected, inverse_depth_step=0.0, depth_step=0.0)
    depth = plane(z, tilt)
    measured = sensor.measure(depth, K, rng())
    stated = sensor.noise_std(depth, incidence(depth, K))
    window = (slice(100, 380), slice(200, 440))  # 67 200 pixels, thousands of independent ones
    assert (measured[window] > 0).all()
    ratio = (measured - depth)[window] / stated[window]
    assert ratio.std() == pytest.approx(1.0, abs=0.03)
    assert abs(ratio.mean()) < 0.05


def test_noise_is_as_published():
    """Nguyen et al. 2012 for the first Kinect, Fankhauser et al. 2015 for the second."""
    z = np.array([0.5, 1.0, 3.0])
    np.testing.assert_allclose(SENSORS["kinect_v1"].noise_std(z), 0.0012 + 0.0019 * (z - 0.4) ** 2)
    np.testing.assert_allclose(SENSORS["kinect_v2"].noise_std(z), 0.0015 - 0.0005 * z + 0.0003 * z**2)
    steep = (1.2 / (pi / 2 - 1.2)) ** 2
    added = [SENSORS[name].noise_std(z, 1.2) - SENSORS[name].noise_std(z) for name in ("kinect_v1", "kinect_v2")]
    np.testing.assert_allclose(added[0], 0.0001 / np.sqrt(z) * steep)
    np.testing.assert_allclose(added[1], 0.0001 * z**1.5 * steep)


def test_neighbours_are_alike_as_far_as_the_window_reaches():
    noise = DepthSensor(noise=(0.002, 0, 0), grain_px=2.0).measure(plane(1.0), K, rng()) - 1.0
    for pixels in (1, 2, 4, 12):
        alike = np.corrcoef(noise[:, :-pixels].ravel(), noise[:, pixels:].ravel())[0, 1]
        assert alike == pytest.approx(np.exp(-(pixels**2) / (4 * 2.0**2)), abs=0.05)


def test_outlines_waver_by_what_is_stated():
    depth = plane(2.0)
    depth[:, 300:] = 1.0
    for sigma in (0.8, 2.0):
        measured = DepthSensor(jitter_px=sigma, grain_px=1.5).measure(depth, K, rng())
        assert set(np.unique(measured)) == {1.0, 2.0}
        borders = (measured == 2.0).sum(axis=1) - 300
        assert borders.std() == pytest.approx(sigma, rel=0.25)
        assert abs(borders.mean()) < 0.3
        assert (measured[:, :290] == 2.0).all()


# ---- steps and range


def test_disparity_steps_grow_with_the_square_of_the_distance():
    depth = np.linspace(0.6, 3.0, 48 * 64).reshape(48, 64)
    measured = DepthSensor(inverse_depth_step=DISPARITY_STEP).measure(depth, K, rng())
    levels = 1 / np.unique(measured).astype(float) / DISPARITY_STEP
    np.testing.assert_allclose(levels, np.rint(levels), atol=1e-3)
    half_a_step = 0.5 * DISPARITY_STEP * depth**2
    assert (np.abs(measured - depth) < 1.05 * half_a_step).all()
    assert np.abs(measured - depth).max() > 0.8 * half_a_step.max()


def test_steps_of_the_preset_are_those_of_real_images(lmo, shared_data):
    """The depths that LM-O's Kinect and IC-BIN's Carmine tell apart."""
    for root, key in ((lmo, ImageKey(2, 3)), (shared_data / "icbin", ImageKey(2, 1))):
        depth = open_dataset(root).depth(key)
        assert depth is not None
        levels = np.unique(depth[(depth > 0.95) & (depth < 1.4)])
        between = np.median(np.diff(1 / levels.astype(float)[::-1]))
        assert between == pytest.approx(DISPARITY_STEP, rel=0.05)


def test_fixed_steps():
    measured = DepthSensor(depth_step=0.01).measure(np.array([[0.504, 0.506, 1.2345]]).repeat(3, axis=0), K, rng())
    np.testing.assert_allclose(measured[0], (0.50, 0.51, 1.23), atol=1e-6)


@pytest.mark.parametrize("name", ["carmine", "kinect_v1", "kinect_v2"])
def test_nothing_is_measured_beyond_the_range(name):
    low, high = depth_sensor(name).sensing_range
    for share, kept in ((0.8, False), (1.2, True)):
        measured = depth_sensor(name).measure(plane(share * low), K, rng())
        assert (measured > 0).any() == kept
    for share, kept in ((0.9, True), (1.2, False)):
        measured = depth_sensor(name).measure(plane(share * high), K, rng())
        assert (measured > 0).any() == kept
    for z in (low, high):  # noise takes some across the limit, but what is returned is within
        measured = depth_sensor(name).corrected.measure(plane(z), K, rng())
        assert 0.2 < (measured > 0).mean() < 0.8
        assert measured[measured > 0].min() >= low
        assert measured.max() <= high


# ---- what is missing


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("tilt", [0.0, 30.0, 60.0, 80.0, -70.0])
def test_the_angle_of_view_is_exact_on_planes(tilt, axis):
    depth = plane(1.0, tilt, axis)
    angles = np.degrees(incidence(depth, K))
    v, u = np.indices(depth.shape)
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(depth.shape)], axis=-1)
    normal = np.array([np.sin(np.radians(tilt)), 0, -np.cos(np.radians(tilt))])[[0, 1, 2] if axis == 1 else [1, 0, 2]]
    expected = np.degrees(np.arccos(np.abs(rays @ normal) / np.linalg.norm(rays, axis=-1)))
    seen = (depth > 0.3) & (depth < 4.0)
    assert seen.mean() > 0.3
    np.testing.assert_allclose(angles[seen], expected[seen], atol=0.15)


def test_the_angle_beside_a_step_is_that_of_the_surface():
    depth = board_before_wall(0.6, 1.4, slice(250, 380))
    angles = np.degrees(incidence(depth, K))
    face_on = np.degrees(incidence(plane(1.0), K))
    np.testing.assert_allclose(angles, face_on, atol=0.1)


def test_slopes_are_no_edges_but_steps_are():
    assert not steps(plane(1.0, 80.0)[:, 100:400], 0.01).any()
    edges = steps(board_before_wall(1.0, 1.05, slice(250, 380)), 0.01)
    assert edges[200, [249, 250, 379, 380]].all()
    assert edges[[99, 100, 399, 400], 300].all()
    assert edges.sum() == 2 * (2 * 300 + 2 * 130) - 4  # inside, corners belong to two sides
    assert not steps(board_before_wall(1.0, 1.005, slice(250, 380)), 0.01).any()


def test_the_share_missing_rises_with_the_angle_of_view():
    sensor = DepthSensor(grazing_deg=(60.0, 80.0), grain_px=1.0)
    for tilt, share in ((40.0, 0.0), (65.0, 0.25), (70.0, 0.5), (75.0, 0.75), (85.0, 1.0)):
        depth = plane(1.0, tilt, axis=0)
        angles = np.degrees(incidence(depth, K))
        there = (np.abs(angles - tilt) < 1.0) & (depth > 0)
        assert there.sum() > 3000
        missing = sensor.measure(depth, K, rng())[there] == 0
        assert missing.mean() == pytest.approx(share, abs=0.06)


def test_presets_lose_what_is_seen_at_a_grazing_angle():
    for name in ("carmine", "kinect_v1", "kinect_v2"):
        kept = [
            (depth_sensor(name).measure(plane(0.9, tilt, axis=0), K, rng())[238:246] > 0).mean()
            for tilt in (0.0, 45.0, 80.0, 89.0)
        ]
        assert kept[0] == 1.0
        assert kept[1] > 0.99
        assert kept[2] < 0.9
        assert kept[3] < 0.02


def test_the_share_missing_at_edges_is_as_stated():
    depth = board_before_wall(0.8, 1.4, slice(200, 400))
    measured = DepthSensor(edge_missing=0.5, grain_px=0.8).measure(depth, K, rng())
    near_an_edge = np.zeros(depth.shape, bool)
    near_an_edge[98:402, 198:402] = True
    near_an_edge[102:398, 202:398] = False
    missing = measured == 0
    assert missing[near_an_edge].mean() == pytest.approx(0.5, abs=0.06)
    assert not missing[~near_an_edge].any()


def test_flying_pixels_lie_between_the_two_sides_of_an_edge():
    depth = board_before_wall(0.8, 1.4, slice(200, 400))
    measured = DepthSensor(edge_mixed=0.4).measure(depth, K, rng())
    flying = (measured > 0.81) & (measured < 1.39)
    assert flying.sum() == pytest.approx(0.4 * steps(depth, 0.01).sum(), rel=0.1)
    assert not flying[120:380, 220:380].any()
    assert measured.min() >= np.float32(0.8)
    assert measured.max() <= np.float32(1.4)


@pytest.mark.parametrize("baseline", [0.075, -0.05])
def test_a_board_casts_the_projectors_shadow_on_the_wall(baseline):
    """f B (1/near - 1/far) columns wide, to the left of the board if the projector is to the right."""
    near, far = 0.7, 1.2
    width = K[0, 0] * abs(baseline) * (1 / near - 1 / far)
    dark = shadow(board_before_wall(near, far, slice(250, 380)), K, baseline)
    columns = np.flatnonzero(dark[200])
    assert len(columns) == pytest.approx(width, abs=1.5)
    assert columns[-1] == 249 if baseline > 0 else columns[0] == 380
    assert not dark[:100].any()
    assert not dark[:, 250:380].any()


def test_a_thin_pole_casts_a_thin_shadow_apart_from_it():
    dark = shadow(board_before_wall(0.7, 1.4, slice(300, 304)), K, 0.075)
    columns = np.flatnonzero(dark[200])
    offset = K[0, 0] * 0.075 * (1 / 0.7 - 1 / 1.4)
    assert len(columns) == pytest.approx(4, abs=1.5)
    assert columns.mean() == pytest.approx(301.5 - offset, abs=1.0)


def test_the_shadow_of_a_board_that_faces_the_projector_has_no_gaps():
    """Its columns lie further apart in the projector than in the camera."""
    depth = plane(2.0)
    depth[:, 300:340] = plane(0.7, 72.0)[:, 300:340]
    dark = shadow(depth, K, 0.075)
    columns = np.flatnonzero(dark[200])
    assert len(columns) > 40
    assert (np.diff(columns) == 1).all()


def test_planes_cast_no_shadow_on_themselves():
    for tilt in (-75.0, -40.0, 0.0, 40.0, 75.0):
        depth = plane(1.0, tilt)
        depth[depth > 2] = 0
        assert shadow(depth, K, 0.075).mean() < 1e-3


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"a": 0.0}, "depth sensor: a = 0; give a factor above 0, near 1"),
        ({"b": float("nan")}, "depth sensor: b, noise, slanted_noise or eyes is not finite; give numbers"),
        ({"edge_missing": 1.5}, "depth sensor: edge_missing = 1.5; give a share of 0 to 1"),
        ({"depth_step": -0.001}, "depth sensor: depth_step = -0.001; give 0 or more"),
        ({"sensing_range": (2.0, 1.0)}, "depth sensor: sensing_range = 2 to 1; give 0 <= low <= high"),
        ({"grazing_deg": (-5.0, 80.0)}, "depth sensor: grazing_deg = -5 to 80; give 0 <= low <= high"),
    ],
)
def test_sensors_that_make_no_sense_are_told(values, message):
    with pytest.raises(InputError) as caught:
        DepthSensor(**values)
    assert str(caught.value) == message
