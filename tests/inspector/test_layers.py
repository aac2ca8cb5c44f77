"""Overlays as images."""

import cv2
import numpy as np
import pytest

from inspector import layers
from pipeline.geometry import project
from pipeline.scene import Camera

RED, BLUE = (255, 0, 0), (0, 0, 255)


def disk(size: int = 40, radius: int = 10) -> np.ndarray:
    mask = np.zeros((size, size), np.uint8)
    return cv2.circle(mask, (size // 2, size // 2), radius, 1, -1).astype(bool)


@pytest.mark.parametrize("factor", [1, 2, 3])
def test_a_finer_camera_sees_the_same(factor: int):
    camera = Camera(np.array([[60.0, 0, 23.3], [0, 61.0, 17.8], [0, 0, 1]]), 48, 36)
    fine = layers.supersampled(camera, factor)
    point = np.array([0.1, -0.05, 0.7])
    # Pixel borders, not centres, scale: the left border lies at -0.5.
    np.testing.assert_allclose(project(fine.K, point) + 0.5, (project(camera.K, point) + 0.5) * factor)
    assert (fine.width, fine.height) == (48 * factor, 36 * factor)
    assert camera.K[0, 0] == 60.0


@pytest.mark.parametrize("thickness", [1, 2, 4])
def test_a_contour_is_the_rim_of_the_mask(thickness: int):
    mask = disk()
    contour = layers.contour_of(mask, thickness)
    assert not contour[~mask].any()
    distance = cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_C, 3)
    np.testing.assert_array_equal(contour, mask & (distance <= thickness))


def test_a_contour_closes_at_the_border_of_the_image():
    contour = layers.contour_of(np.ones((6, 8), bool))
    assert contour[0].all()
    assert contour[:, -1].all()
    assert not contour[1:-1, 1:-1].any()


@pytest.mark.parametrize("shape", [(0, 0), (0, 5), (4, 4)])
def test_the_contour_of_nothing_is_nothing(shape: tuple[int, int]):
    assert layers.contour_of(np.zeros(shape, bool)).shape == shape
    assert not layers.contour_of(np.zeros(shape, bool)).any()


def test_a_silhouette_is_filled_and_framed():
    layer = layers.silhouette(disk(), RED, fill=0.4, opacity=0.8, thickness=1)
    assert layer[20, 20].tolist() == [255, 0, 0, 102]
    assert layer[20, 30].tolist() == [255, 0, 0, 204]
    assert layer[0, 0].tolist() == [0, 0, 0, 0]
    assert layers.silhouette(disk(), RED, fill=0, opacity=0.8, thickness=1)[20, 20, 3] == 0


@pytest.mark.parametrize("position", [0.0, 0.25, 1.0])
def test_a_wipe_shows_one_layer_left_and_the_other_right_of_its_line(position: float):
    left, right = np.full((4, 8, 4), 10, np.uint8), np.full((4, 8, 4), 20, np.uint8)
    wiped = layers.wiped(left, right, position)
    column = min(round(position * 8), 7)
    assert (wiped[:, :column] == 10).all()
    assert (wiped[:, column] == (255, 255, 255, 200)).all()
    assert (wiped[:, column + 1 :] == 20).all()
    assert (right == 20).all()


def test_depth_is_transparent_where_it_was_not_measured():
    depth = np.array([[0.0, 0.5, 1.5]], np.float32)
    layer, scale = layers.depth_layer(depth, opacity=0.5)
    assert layer[0, :, 3].tolist() == [0, 128, 128]
    assert layer[0, 1, 0] > layer[0, 1, 2]  # near is warm
    assert (scale.low, scale.high) == ("0.51 m", "1.49 m")
    layers.depth_layer(np.zeros((2, 2), np.float32))  # nothing measured: no error


def test_differences_are_blue_below_and_red_above_zero():
    layer, scale = layers.difference_layer(np.array([[-1.0, 0.0, 1.0, 0.0]]), np.array([[1, 1, 1, 0]], bool), 0.02)
    blue, white, red, outside = layer[0].astype(int)
    assert blue[2] - blue[0] > 100
    assert red[0] - red[2] > 100
    assert white[:3].min() > 230
    assert outside[3] == 0
    assert (scale.low, scale.high) == ("-20 mm", "+20 mm")


def test_heat_is_transparent_at_zero_and_where_it_is_unknown():
    layer, scale = layers.heat_layer(np.array([[0.0, np.nan, np.inf, 2.0]]), "edgels")
    assert layer[0, :, 3].tolist() == [0, 0, 0, 255]
    assert scale == scale._replace(label="edgels", low="0", high="2")


def test_labels_have_different_colours():
    assert len(set(layers.label_colors(30))) == 30


def test_upsampling_repeats_pixels():
    layer = np.arange(16, dtype=np.uint8).reshape(2, 2, 4)
    assert layers.upsampled(layer, 1) is layer
    assert (layers.upsampled(layer, 3)[3:, :3] == layer[1, 0]).all()
