"""What EPOS adds to the picture in 2D and in 3D, and what a click into it means."""

from collections.abc import Callable

import numpy as np
import pytest
from third_party_method import CELL_PX
from tiny_dataset import CAMERA, FIRST

from inspector.epos.choice import NO_PIXEL
from inspector.epos.drawing import draw
from inspector.epos.picking import picked
from inspector.epos.placing import copy_from, eye_beside
from inspector.epos.row import EposRow
from inspector.nodes import Cloud, ColoredMesh, Lines, Picture
from inspector.planes import image_depth
from inspector.selection import RowKey, Selection
from inspector.views import Click
from pipeline.geometry import project, transform_points, unproject

IMAGE, SCENE = Selection(view="image"), Selection(view="scene")


@pytest.fixture
def pixel(row_of: Callable[..., EposRow]) -> tuple[float, float]:
    """A pixel that shows box 2."""
    fragments = row_of().recording.fragments
    assert fragments is not None
    u, v = fragments.cells[len(fragments.cells) // 2] * CELL_PX
    return float(u), float(v)


def on_copy(row: EposRow, points: np.ndarray) -> np.ndarray:
    """Points of the model where the copy has them."""
    copy = copy_from(row, SCENE)
    assert copy is not None
    return transform_points(copy, points)


def test_in_2d_nothing_but_what_lies_over_the_image_is_added(row_of, pixel):
    nodes = draw(row_of(layer="fragments", links="all", pixel=pixel), IMAGE).nodes
    assert set(nodes) == {"epos/layer", "epos/cell", "epos/cell_edge", "epos/inliers", "epos/errors"}
    assert isinstance(nodes["epos/layer"], Picture)
    assert nodes["epos/layer"].pixels().shape[:2] == (2 * CAMERA.height, 2 * CAMERA.width)


def test_in_3d_the_copy_is_linked_with_the_inliers(row_of):
    row = row_of(links="inliers")
    nodes = draw(row, SCENE).nodes
    lines, copy = nodes["epos/links/inliers"], nodes["epos/model"]
    assert isinstance(copy, ColoredMesh)
    assert isinstance(lines, Lines)
    assert len(lines.segments) == len(row.matches.inliers)
    begins = project(CAMERA.K, lines.segments[:, 0])
    assert begins == pytest.approx(row.matches.links.pixels[row.matches.inliers], abs=1e-6)
    vertices = copy.vertices()
    ends = lines.segments[:, 1]
    assert (ends >= vertices.min(axis=0) - 1e-3).all()
    assert (ends <= vertices.max(axis=0) + 1e-3).all()
    assert len(np.unique(copy.colors(), axis=0)) == 8


def test_a_clicked_pixel_is_linked_with_its_candidates_alone(row_of, pixel):
    nodes = draw(row_of(links="all", pixel=pixel), SCENE).nodes
    assert "epos/links/inliers" not in nodes
    candidates = nodes["epos/candidates"]
    assert isinstance(candidates, Lines)
    assert len(candidates.segments) == 2
    assert isinstance(nodes["epos/candidates_points"], Cloud)


def test_pixels_of_another_instance_stand_apart(row_of):
    row = row_of(RowKey(*FIRST, 1, 0, -1), links="all")
    nodes = draw(row, IMAGE).nodes
    clouds = [nodes["epos/inliers"], nodes["epos/outliers"]]
    points = [len(cloud.points()[0]) for cloud in clouds if isinstance(cloud, Cloud)]
    assert points == [len(row.matches.inliers), row.matches.pixels - len(row.matches.inliers)]
    assert min(points) > 0


def test_what_cannot_be_drawn_is_said(row_of):
    drawing = draw(row_of(layer="coordinates"), IMAGE)
    assert drawing.nodes == {}
    assert "were not recorded" in drawing.warnings[0]


def test_equal_choices_make_equal_tokens(row_of, pixel):
    first, second = (draw(row_of(links="all", pixel=pixel), SCENE).nodes for _ in range(2))
    same = {name for name in first if first[name].token == second[name].token}
    assert same == set(first) - {"epos/model"}, "each row_of reads anew, so the copy counts as another"


def test_the_copy_stands_beside_the_image_about_as_high(row_of):
    row = row_of()
    pixels = project(CAMERA.K, on_copy(row, row.model.vertices))
    assert CAMERA.width - 1 < pixels[:, 0].min()
    assert pixels[:, 0].max() < 3 * CAMERA.width
    assert 0.3 * CAMERA.height < np.ptp(pixels[:, 1]) < 1.3 * CAMERA.height


@pytest.mark.parametrize("window", [(700, 900), (1600, 600)])
def test_the_eye_beside_sees_both_image_and_copy(row_of, window):
    row = row_of()
    eye = np.array(eye_beside(row, window))
    forward = (eye[3:] - eye[:3]) / np.linalg.norm(eye[3:] - eye[:3])
    corners = np.array([[0, 0], [CAMERA.width, 0], [0, CAMERA.height], [CAMERA.width, CAMERA.height]], float)
    image = unproject(CAMERA.K, corners, np.full(4, image_depth(row.frame, SCENE)))
    both = np.concatenate([image, on_copy(row, row.model.vertices)]) - eye[:3]
    right = np.cross([0, 1.0, 0], forward) / np.linalg.norm(np.cross([0, 1.0, 0], forward))
    along, across = both @ forward, both @ right
    assert (along > 0).all()
    assert np.abs(across / along).max() < np.tan(np.radians(22.5)) * window[0] / window[1] * 1.15


# -------------------------------------------------------------------- clicks
def click(pixel: tuple[float, float] | None, origin=(0.0, 0, 0), toward=(0.0, 0, 1)) -> Click:
    return Click(pixel, np.array(origin, float), np.array(toward, float) - np.array(origin, float), False)


def test_a_click_into_the_image_chooses_its_pixel_and_again_none(row_of, pixel):
    u, v = pixel
    assert picked(row_of(), IMAGE, click((u + 0.3, v - 0.2))) == {"pixel": (u, v), "fragment": None}
    again = picked(row_of(pixel=pixel), IMAGE, click((u + 1.0, v)))
    assert again == {"pixel": NO_PIXEL, "fragment": None}, "the other pixel of the same cell"


def test_a_click_beside_the_image_is_left_to_others(row_of):
    assert picked(row_of(), IMAGE, click((-3.0, 10.0))) is None
    assert picked(row_of(), IMAGE, click((10.0, CAMERA.height - 0.4))) is None


def test_a_click_on_the_copy_chooses_a_fragment_and_again_none(row_of):
    row = row_of()
    corner = int(on_copy(row, row.model.vertices)[:, 2].argmin())
    target = on_copy(row, 0.97 * row.model.vertices[corner])
    assert picked(row, SCENE, click(None, toward=target)) == {"fragment": corner}
    assert picked(row_of(fragment=corner), SCENE, click(None, toward=target)) == {"fragment": None}


def test_a_click_on_the_image_in_3d_chooses_the_pixel_there(row_of, pixel):
    row = row_of()
    target = unproject(CAMERA.K, np.array(pixel), np.array(image_depth(row.frame, SCENE)))
    assert picked(row, SCENE, click(None, origin=(-0.05, -0.03, -0.2), toward=target)) == {
        "pixel": pixel,
        "fragment": None,
    }
    assert picked(row, SCENE, click(None, toward=(-5.0, 0, 1))) is None
