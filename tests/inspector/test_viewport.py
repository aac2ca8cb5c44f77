"""Where pixels are seen in the window: by the formulas, and by an independent projection of the image plane."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from inspector.layers import supersampled
from inspector.viewport import Viewport, image_center, plane_of
from pipeline.geometry import project, unproject
from pipeline.scene import Camera


def camera(fx: float, fy: float, cx: float, cy: float, width: int, height: int) -> Camera:
    return Camera(np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), width, height)


CAMERAS = {
    "LM-O": camera(572.4114, 573.57043, 325.2611, 242.04899, 640, 480),
    "principal point far off": camera(700.0, 700.0, 150.0, 400.0, 640, 480),
    "fx is not fy": camera(600.0, 660.0, 310.0, 250.0, 640, 480),
    "portrait": camera(900.0, 905.0, 360.5, 642.0, 720, 1280),
}
WINDOWS = [(332, 700), (1200, 700), (800, 800), (1920, 300)]
ZOOMS = [0.5, 1.0, 3.7, 60.0]

cases = pytest.mark.parametrize("name", CAMERAS)
windows = pytest.mark.parametrize("window", WINDOWS, ids=str)
zooms = pytest.mark.parametrize("zoom", ZOOMS)


def seen_at(viewport: Viewport, point: np.ndarray) -> np.ndarray:
    """CSS pixel at which the browser's camera shows a point.

    It is given a position (the origin), a point to look at, an up direction and a vertical field of view.
    """
    up = -viewport.camera_from_view[:, 1]
    forward = viewport.look_at / np.linalg.norm(viewport.look_at)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    x, y, z = right @ point, down @ point, forward @ point
    focal = viewport.window_height / 2 / np.tan(viewport.fov / 2)
    return np.array([viewport.window_width / 2 + focal * x / z, viewport.window_height / 2 + focal * y / z])


def on_the_plane(camera: Camera, u: float, v: float, z: float) -> np.ndarray:
    """Point of the textured plane that carries the centre of a pixel of the image."""
    width, height, position = plane_of(camera, z)
    share = np.array([(u + 0.5) / camera.width - 0.5, (v + 0.5) / camera.height - 0.5])
    return np.array(position) + np.array([share[0] * width, share[1] * height, 0.0])


def css(viewport: Viewport, u: float, v: float) -> np.ndarray:
    return np.array(viewport.window_at(u, v)) * (viewport.window_width, viewport.window_height)


@cases
@windows
@zooms
def test_window_and_pixel_are_inverse(name: str, window: tuple[int, int], zoom: float):
    view = Viewport(CAMERAS[name], *window, zoom, (200.25, 111.0))
    for u, v in ((0.0, 0.0), (639.0, 3.3), (200.25, 111.0), (12.3, 470.0)):
        np.testing.assert_allclose(view.pixel_at(*view.window_at(u, v)), (u, v), atol=1e-8)
    np.testing.assert_allclose(view.window_at(200.25, 111.0), (0.5, 0.5), atol=1e-12)


@cases
@windows
@zooms
def test_a_pixel_of_the_plane_and_the_point_that_projects_to_it_are_seen_at_one_place(
    name: str, window: tuple[int, int], zoom: float
):
    found = CAMERAS[name]
    view = Viewport(found, *window, zoom, (found.width * 0.7, found.height * 0.4))
    for u, v in ((0.0, 0.0), (found.width - 1, 0.0), (37.3, 251.9), (found.width * 0.7, found.height * 0.4)):
        point = unproject(found.K, np.array([u, v]), np.array(0.637))
        np.testing.assert_allclose(project(found.K, point), (u, v), atol=1e-9)
        expected = seen_at(view, point)
        np.testing.assert_allclose(seen_at(view, on_the_plane(found, u, v, 5.0)), expected, atol=1e-6)
        np.testing.assert_allclose(css(view, u, v), expected, atol=1e-6)


@cases
@windows
def test_the_middle_of_the_window_has_the_stated_scale(name: str, window: tuple[int, int]):
    found = CAMERAS[name]
    principal = (float(found.K[0, 2]), float(found.K[1, 2]))  # there the image is not seen at a slant
    view = Viewport(found, *window, 2.0, principal)
    step = css(view, principal[0], principal[1] + 1e-3) - css(view, *principal)
    assert step[1] / 1e-3 == pytest.approx(view.scale, rel=1e-6)
    assert step[0] == pytest.approx(0, abs=1e-9)


def test_zoom_1_fits_the_image_into_the_window_and_2_shows_half_of_it():
    centred = camera(572.0, 572.0, 319.5, 239.5, 640, 480)
    view = Viewport(centred, 640, 480, 1.0, image_center(centred))
    assert view.scale == pytest.approx(1.0)
    assert view.fov == pytest.approx(2 * np.arctan(240 / 572.0))
    assert view._replace(zoom=2.0).fov == pytest.approx(2 * np.arctan(120 / 572.0))
    assert view._replace(window_width=1920).scale == pytest.approx(1.0)
    assert view._replace(window_width=320, window_height=900).scale == pytest.approx(0.5)
    slanted = Viewport(CAMERAS["LM-O"], 640, 480, 1.0, image_center(CAMERAS["LM-O"]))
    assert slanted.scale == pytest.approx(1.0, abs=0.02)


@cases
@windows
def test_zoom_1_shows_the_whole_image(name: str, window: tuple[int, int]):
    found = CAMERAS[name]
    view = Viewport(found, *window, 1.0, image_center(found))
    w, h = found.width - 0.5, found.height - 0.5
    corners = np.array([css(view, u, v) for u, v in ((-0.5, -0.5), (w, -0.5), (w, h), (-0.5, h))])
    slack = 0.01 * np.array(window)
    assert (corners >= -slack).all()
    assert (corners <= np.array(window) + slack).all()


@given(st.floats(-1e4, 1e4), st.floats(-1e4, 1e4), st.floats(1e-3, 1e3))
def test_whatever_is_asked_the_field_of_view_is_one_that_a_camera_can_have(u: float, v: float, zoom: float):
    view = Viewport(CAMERAS["LM-O"], 332, 700, zoom, (u, v))
    assert 0 < view.fov < np.pi
    assert np.isfinite(view.look_at).all()


def test_what_lies_behind_has_no_pixel():
    wide = camera(10.0, 10.0, 320.0, 240.0, 640, 480)
    view = Viewport(wide, 1200, 700, 0.5, (2000.0, 240.0))
    assert np.isnan(view.pixel_at(1.0, 0.5)).all()


@cases
def test_the_picture_is_turned_as_little_as_possible(name: str):
    found = CAMERAS[name]
    for center in ((found.width * 0.9, found.height * 0.8), (float(found.K[0, 2]), float(found.K[1, 2]))):
        rotation = Viewport(found, 800, 600, 1.0, center).camera_from_view
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1)
        angle = np.arccos((np.trace(rotation) - 1) / 2)
        assert angle == pytest.approx(np.arccos(rotation[2, 2]), abs=1e-7)  # no more than the direction needs


@cases
def test_a_part_of_the_image_lies_where_it_does_in_the_whole(name: str):
    found = CAMERAS[name]
    left, top, right, bottom = edges = (99.5, 19.5, 150.5, 119.5)
    width, height, position = plane_of(found, 5.0, edges)
    for share_x, share_y, u, v in ((-0.5, -0.5, left, top), (0.5, 0.5, right, bottom), (0.0, 0.5, 125.0, bottom)):
        corner = np.add(position, (share_x * width, share_y * height, 0.0))
        np.testing.assert_allclose(corner, on_the_plane(found, u, v, 5.0), atol=1e-12)


@cases
def test_finer_layers_lie_on_the_same_plane(name: str):
    found = CAMERAS[name]
    fine = supersampled(found, 2)
    np.testing.assert_allclose(plane_of(fine, 5.0)[0], plane_of(found, 5.0)[0])
    np.testing.assert_allclose(plane_of(fine, 5.0)[1], plane_of(found, 5.0)[1])
    np.testing.assert_allclose(plane_of(fine, 5.0)[2], plane_of(found, 5.0)[2], atol=1e-12)
