"""What matching compares, against slow references."""

import cv2
import numpy as np
from hashmatch_parts import CAMERA

from pipeline.hashmatch import channels
from pipeline.hashmatch.objectness import filled
from pipeline.hashmatch.poses import rotation_to_ray
from pipeline.hashmatch.response_maps import spread

K = CAMERA.K


def plane_depth(normal: np.ndarray, distance: float = 0.5) -> np.ndarray:
    v, u = np.indices((CAMERA.height, CAMERA.width))
    rays = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(K).T
    return (normal[2] * distance / (rays @ normal)).astype(np.float32)


def test_normals_of_a_plane_are_relative_to_the_viewing_rays():
    normal = np.array([0.3, -0.2, -1.0]) / np.linalg.norm([0.3, -0.2, -1.0])
    found = channels.normals(plane_depth(normal), K)
    for u, v in ((20, 20), (118, 91), (200, 150)):
        expected = rotation_to_ray(K, np.array([float(u), v])).T @ normal
        assert np.degrees(np.arccos(np.clip(found[v, u] @ expected, -1, 1))) < 1.0


def test_normals_do_not_cross_depth_steps_and_are_absent_without_depth():
    depth = plane_depth(np.array([0.0, 0.0, -1.0]))
    depth[:, 120:] += 0.3
    depth[60:70, 30:40] = 0
    found = channels.normals(depth, K)
    assert not found[65, 35].any()
    facing = rotation_to_ray(K, np.array([119.0, 90.0])).T @ [0, 0, -1]
    np.testing.assert_allclose(found[90, 119], facing, atol=1e-3)


def test_normal_bins_face_the_camera_or_go_by_azimuth():
    def tilted(inclination: float, azimuth: float) -> np.ndarray:
        a, b = np.deg2rad([inclination, azimuth])
        return np.array([np.sin(a) * np.cos(b), np.sin(a) * np.sin(b), -np.cos(a)], np.float32)

    sector = 360 / 7
    directions = np.array([tilted(5, 200), *(tilted(40, (i + 0.5) * sector) for i in range(7)), np.zeros(3)])
    assert channels.normal_bins(directions).tolist() == [0, 1, 2, 3, 4, 5, 6, 7, channels.NONE]
    near_a_boundary = channels.normal_bits(np.array([tilted(40, sector - 2), tilted(40, 1.5 * sector)]), np.deg2rad(8))
    assert near_a_boundary.tolist() == [(1 << 1) | (1 << 2), 1 << 2]


def test_a_uniform_sphere_fills_the_normal_bins_alike():
    rng = np.random.default_rng(0)
    radius, angle = np.sqrt(rng.random(20_000)), rng.random(20_000) * 2 * np.pi  # as a sphere shows them in an image
    normals = np.stack([radius * np.cos(angle), radius * np.sin(angle), -np.sqrt(1 - radius**2)], axis=-1)
    shares = np.bincount(channels.normal_bins(normals), minlength=8) / 20_000
    np.testing.assert_allclose(shares, 1 / 8, atol=0.01)


def test_gradients_equal_those_of_opencv():
    rgb = np.random.default_rng(1).integers(0, 255, (30, 40, 3), dtype=np.uint8)
    magnitude, orientation = channels.gradient_orientations(rgb, 0.0)
    blurred = cv2.GaussianBlur(rgb, (5, 5), 0)
    x, y = (cv2.Sobel(blurred, cv2.CV_32F, *d, ksize=3) for d in ((1, 0), (0, 1)))
    strongest = np.hypot(x, y).argmax(axis=-1)[..., None]
    x, y = (np.take_along_axis(d, strongest, axis=-1)[..., 0] for d in (x, y))
    inside = np.s_[1:-1, 1:-1]
    np.testing.assert_allclose(magnitude[inside], np.hypot(x, y)[inside], rtol=1e-5)
    difference = (orientation - np.arctan2(y, x))[inside] % np.pi
    assert np.minimum(difference, np.pi - difference).max() < 1e-4


def test_gradient_bits_ignore_which_side_is_brighter():
    edge = np.full((20, 20, 3), 40, np.uint8)
    edge[:, 10:] = 200
    bits = [channels.gradient_bits(*channels.gradient_orientations(rgb, 24.0)) for rgb in (edge, 240 - edge)]
    assert bits[0][10, 10] == bits[1][10, 10] != 0
    assert bits[0][10, 3] == 0


def test_the_response_map_has_all_bits_of_the_neighbourhood():
    bits = (1 << np.random.default_rng(2).integers(0, 8, (17, 23))).astype(np.uint8)
    bits[np.random.default_rng(3).random(bits.shape) < 0.8] = 0
    slow = np.zeros_like(bits)
    for v, u in np.ndindex(*bits.shape):
        slow[v, u] = np.bitwise_or.reduce(bits[max(0, v - 2) : v + 3, max(0, u - 2) : u + 3], axis=None)
    np.testing.assert_array_equal(spread(bits, 5), slow)


def test_black_counts_as_blue_and_gray_as_yellow():
    colors = np.array([[[0, 0, 0], [250, 250, 250], [255, 0, 0], [255, 255, 0], [0, 0, 255]]], np.uint8)
    assert channels.hues(colors)[0].tolist() == [120, 30, 0, 30, 120]


def test_holes_are_filled_from_behind():
    depth = np.full((9, 12), 0.5, np.float32)
    depth[:, 6:] = 0.8
    depth[:, 5:7] = 0
    assert (filled(depth)[:, 6] == np.float32(0.8)).all()
    assert filled(depth).min() > 0
