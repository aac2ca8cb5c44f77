"""Finding markers: corners to a small fraction of a pixel on exact images, and poses that bear with wrong markers."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from pipeline.geometry import inverse, project, rotation_error, transform_points
from pipeline.scene import Camera
from pipeline.synth.boards import Detections, NoBoardError, camera_pose, detect, grid_board, turntable_views

BOARD = grid_board(4, 4, 0.05, 0.015, 0.015)
CAMERA = Camera(np.array([[420.0, 0, 161.3], [0, 425.0, 117.8], [0, 0, 1.0]]), 320, 240)
FINE = 8000.0


def picture_of(camera_from_board: np.ndarray, gradient: bool = False, samples: int = 8) -> np.ndarray:
    """An sRGB image of the board's plane: every pixel the mean over its area, in linear light."""
    camera_from_plane = CAMERA.K @ camera_from_board[:3][:, [0, 1, 3]]
    steps = (np.arange(CAMERA.width * samples) + 0.5) / samples - 0.5
    u, v = np.meshgrid(steps, steps[: CAMERA.height * samples])
    plane = np.stack([u, v, np.ones_like(u)], axis=-1) @ np.linalg.inv(camera_from_plane).T
    on_print = ((plane[..., :2] / plane[..., 2:]) * (1, -1) + np.array(BOARD.size) / 2) * FINE - 0.5
    x, y = on_print.astype(np.float32).transpose(2, 0, 1)
    ink = cv2.remap(BOARD.picture(FINE), x, y, cv2.INTER_NEAREST, borderValue=255) / 255.0
    light = 0.02 + ink * (0.2 + 0.5 * u / CAMERA.width if gradient else 0.6)
    mean = light.reshape(CAMERA.height, samples, CAMERA.width, samples).mean(axis=(1, 3))
    return np.rint(255 * np.where(mean <= 0.0031308, 12.92 * mean, 1.055 * mean ** (1 / 2.4) - 0.055)).astype(np.uint8)


def view(azimuth: float, elevation: float, distance: float = 0.5) -> np.ndarray:
    return inverse(turntable_views([azimuth], [elevation], distance)[0].board_from_camera)


def true_pixels(pose: np.ndarray, ids: tuple[int, ...]) -> np.ndarray:
    return np.stack([project(CAMERA.K, transform_points(pose, BOARD.corners(k))) for k in ids])


@pytest.mark.parametrize(("azimuth", "elevation"), [(-90, 88), (-90, 60), (-63, 60), (131, 40)])
@pytest.mark.parametrize("gradient", [False, True])
def test_corners_are_found_to_a_fraction_of_a_pixel(azimuth, elevation, gradient):
    pose = view(azimuth, elevation)
    seen = detect(picture_of(pose, gradient), BOARD)
    assert len(seen.ids) >= 12
    off = seen.pixels - true_pixels(pose, seen.ids)
    assert np.linalg.norm(off, axis=-1).mean() < 0.06
    assert np.abs(off.mean(axis=(0, 1))).max() < 0.03
    found = camera_pose(seen, BOARD, CAMERA)
    assert found.rms_px < 0.1
    error = found.camera_from_board @ inverse(pose)
    assert np.linalg.norm(error[:3, 3]) < 0.0004
    assert np.degrees(rotation_error(error[:3, :3], np.eye(3))) < 0.05


def test_colour_images_are_found_as_gray_ones():
    gray = picture_of(view(-70, 65))
    one, three = detect(gray, BOARD), detect(np.repeat(gray[..., None], 3, axis=2), BOARD)
    assert one.ids == three.ids
    np.testing.assert_allclose(one.pixels, three.pixels, atol=0.01)


def test_hidden_and_cut_off_markers_are_left_out_and_the_rest_stay():
    pose = view(-90, 70)
    image = picture_of(pose)
    before = detect(image, BOARD)
    hidden = true_pixels(pose, (5,))[0].mean(axis=0).astype(int)
    image[hidden[1] - 9 : hidden[1] + 9, hidden[0] - 9 : hidden[0] + 9] = 120
    after = detect(image, BOARD)
    assert set(before.ids) - set(after.ids) == {5}
    np.testing.assert_allclose(after.pixels[0], before.pixels[0], atol=1e-6)


def test_wrong_markers_do_not_spoil_the_pose():
    pose = view(-60, 80)  # OpenCV's own RANSAC fails on boards seen from above
    ids = BOARD.ids
    pixels = true_pixels(pose, ids) + np.random.default_rng(0).normal(0, 0.1, (16, 4, 2))
    pixels[[2, 7, 8, 13]] += np.random.default_rng(1).uniform(20, 60, (4, 1, 2))
    found = camera_pose(Detections(ids, pixels), BOARD, CAMERA)
    assert found.inliers.all(axis=1).tolist() == [k not in (2, 7, 8, 13) for k in ids]
    assert found.errors_px[found.inliers].max() < 0.5
    assert np.linalg.norm((found.camera_from_board @ inverse(pose))[:3, 3]) < 0.001


def test_too_few_markers_and_a_wrong_board_are_told():
    pose = view(-60, 70)
    with pytest.raises(NoBoardError, match="0 of 16 markers seen; at least 2 are needed"):
        camera_pose(detect(np.full((240, 320), 128, np.uint8), BOARD), BOARD, CAMERA)
    with pytest.raises(NoBoardError, match="1 of 16 markers seen"):
        camera_pose(Detections((3,), true_pixels(pose, (3,))), BOARD, CAMERA)
    shuffled = np.random.default_rng(0).permutation(16)
    wrong = replace(BOARD, corner_points=BOARD.corner_points[shuffled])
    with pytest.raises(NoBoardError, match="of 64 corners fit one pose of the camera; check the camera matrix"):
        camera_pose(Detections(BOARD.ids, true_pixels(pose, BOARD.ids)), wrong, CAMERA)


def test_ids_seen_twice_are_left_out():
    image = np.full((240, 320), 255, np.uint8)
    marker = cv2.resize((~BOARD.modules(3)).astype(np.uint8) * 255, (60, 60), interpolation=cv2.INTER_NEAREST)
    other = cv2.resize((~BOARD.modules(4)).astype(np.uint8) * 255, (60, 60), interpolation=cv2.INTER_NEAREST)
    image[20:80, 20:80] = image[20:80, 200:260] = marker
    image[140:200, 100:160] = other
    assert detect(image, BOARD).ids == (4,)
    np.testing.assert_allclose(detect(image, BOARD).pixels[0][0], (99.5, 139.5), atol=0.05)
