"""The model with its fragments: seen from two sides in the tab, and cut into pieces for the scene."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from tiny_dataset import CAMERA, box

from inspector.epos.drawing_search import outline
from inspector.epos.pieces import cut
from inspector.epos.sides import SIZE, sides_of, with_points
from pipeline.geometry import project, transform_points
from pipeline.rendering import render

MODEL = box(1)
CENTERS = MODEL.vertices
TURNED = Rotation.from_euler("xyz", [20, 30, 10], degrees=True).as_matrix()


def test_both_sides_together_show_the_fragments_of_all_corners():
    front, back = sides_of(MODEL, CENTERS, TURNED)
    assert set(np.unique(front.fragment_ids)) | set(np.unique(back.fragment_ids)) == {-1, *range(8)}
    assert (front.fragment_ids >= 0).mean() == pytest.approx(front.mask.mean())
    assert 0.1 < front.mask.mean() < 0.8


def test_a_side_shows_what_a_camera_sees_in_that_pose():
    front = sides_of(MODEL, CENTERS, TURNED)[0]
    nearest = int(transform_points(front.camera_from_model, CENTERS)[:, 2].argmin())
    u, v = project(front.camera.K, transform_points(front.camera_from_model, CENTERS[nearest]))
    inside = (np.array([u, v]) - SIZE / 2) * 0.98 + SIZE / 2  # a corner itself is on the edge
    assert front.fragment_at(*inside / SIZE) == nearest
    assert front.fragment_at(0.0, 0.0) is None


def test_the_pictures_have_the_fragments_colours():
    front = sides_of(MODEL, CENTERS, np.eye(3))[0]
    colors = np.zeros((8, 3), np.uint8)
    colors[:, 0] = 200
    picture = front.painted(colors)
    assert picture[front.mask][:, 1:3].max() == 0
    assert picture[front.mask][:, 0].max() > 100
    assert picture[0, 0, 3] == 0, "transparent beside the model"


def test_dots_stand_on_what_is_seen_only():
    front = sides_of(MODEL, CENTERS, np.eye(3))[0]
    plain = front.painted(np.full((8, 3), 90, np.uint8))
    near, far = np.array([[0.0, 0, -0.01]]), np.array([[0.0, 0, 0.01]])
    changed = [(with_points(front, plain.copy(), p, np.ones(1)) != plain).any() for p in (near, far)]
    assert changed == [True, False]


@pytest.mark.parametrize("rotation", [np.zeros((3, 3)), np.full((3, 3), np.nan), -np.eye(3)])
def test_a_damaged_rotation_shows_the_model_all_the_same(rotation):
    assert all(side.mask.any() for side in sides_of(MODEL, CENTERS, rotation))


def test_pieces_are_the_whole_surface_cut_at_the_borders():
    pieces = cut(MODEL, CENTERS)
    corners = pieces.vertices[pieces.faces]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    size = np.ptp(MODEL.vertices, axis=0)
    assert areas.sum() == pytest.approx(2 * (size[0] * size[1] + size[1] * size[2] + size[0] * size[2]))
    ids = pieces.fragment_of_vertex[pieces.faces]
    assert (ids == ids[:, :1]).all(), "each face has one colour"
    eighths = np.bincount(ids[:, 0], weights=areas) / areas.sum()
    assert eighths == pytest.approx(np.full(8, 1 / 8), abs=0.01)


def test_a_contour_runs_around_the_silhouette():
    pose = np.eye(4)
    pose[:3, 3] = (0.0, 0.0, 0.4)
    segments = outline(render(MODEL, CAMERA, pose, pixel_center=0.0), 1)
    corners = project(CAMERA.K, transform_points(pose, MODEL.vertices))
    assert segments.reshape(-1, 2).min(axis=0) == pytest.approx(corners.min(axis=0), abs=1.0)
    assert segments.reshape(-1, 2).max(axis=0) == pytest.approx(corners.max(axis=0), abs=1.0)


def test_a_pose_out_of_sight_has_no_contour():
    pose = np.eye(4)
    pose[2, 3] = -1.0
    assert len(outline(render(MODEL, CAMERA, pose, pixel_center=0.0), 1)) == 0
