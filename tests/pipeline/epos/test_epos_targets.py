"""Targets against the surface that the camera sees."""

from dataclasses import replace

import numpy as np
import pytest
from epos_cases import CAMERA, cone, labelled, pose, wedge

from pipeline.epos.fragments import fragments_of
from pipeline.epos.grid import cell_pixels, grid_camera
from pipeline.epos.targets import KnownObject, make_targets
from pipeline.geometry import project, transform_points

OBJECTS = (KnownObject(wedge(), fragments_of(wedge(), 32)), KnownObject(cone(), fragments_of(cone(), 16)))
NEAR, FAR = pose(-0.02, 0.0, 0.2), pose(0.03, 0.02, 0.22, (1.2, 0.3, -0.4))


@pytest.fixture(scope="module")
def image():
    return labelled([(OBJECTS[0].model, NEAR), (OBJECTS[1].model, FAR)])


@pytest.fixture(scope="module")
def targets(image):
    return make_targets(image, OBJECTS)


def points_of(targets, position):
    rows, columns = np.nonzero(targets.objects == position + 1)
    fragments = OBJECTS[position].fragments
    points = fragments.points(targets.fragments[rows, columns], targets.coordinates[rows, columns])
    return np.stack([columns, rows], axis=1), points


def test_grid_camera_sees_the_centers_of_cells():
    points = np.array([[0.01, 0.02, 0.3], [-0.05, 0.01, 0.5]])
    cells = project(grid_camera(CAMERA).K, points)
    np.testing.assert_allclose(cells * 4 + 1.5, project(CAMERA.K, points))
    assert (grid_camera(CAMERA).width, grid_camera(CAMERA).height) == (32, 24)


@pytest.mark.parametrize(("position", "camera_from_model"), [(0, NEAR), (1, FAR)])
def test_targets_are_the_surface_points_that_cells_see(image, targets, position, camera_from_model):
    cells, points = points_of(targets, position)
    assert len(cells) > 30
    in_camera = transform_points(camera_from_model, points)
    np.testing.assert_allclose(project(CAMERA.K, in_camera), cell_pixels(cells), atol=2e-3)
    ids = OBJECTS[position].fragments.locate(points).fragment_ids
    assert (ids == targets.fragments[cells[:, 1], cells[:, 0]]).mean() > 0.99  # float32 at a border, at most


def test_points_lie_on_the_model_to_float_precision(targets):
    import open3d as o3d

    for position in (0, 1):
        model, (_, points) = OBJECTS[position].model, points_of(targets, position)
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(model.vertices.astype(np.float32), model.faces.astype(np.uint32))
        distance = scene.compute_distance(points.astype(np.float32)).numpy()
        assert distance.max() < 1e-7  # 0.1 micrometres, of parts of 8 cm


def test_cells_show_the_visible_instance_or_background(image, targets):
    middle = image.instance_ids.reshape(24, 4, 32, 4)[:, 1:3, :, 1:3].transpose(0, 2, 1, 3).reshape(24, 32, 4)
    clear = (middle == middle[..., :1]).all(axis=-1)
    expected = np.where(middle[..., 0] >= 0, middle[..., 0] + 1, 0)
    np.testing.assert_array_equal(targets.objects[clear], expected[clear])
    background = targets.objects == 0
    assert not targets.fragments[background].any()
    assert not targets.coordinates[background].any()


def test_what_something_hides_is_background(image):
    ids = image.instance_ids.copy()
    ids[:, :64] = -1
    hidden = make_targets(replace(image, instance_ids=ids), OBJECTS)
    assert not hidden.objects[:, :16].any()
    assert hidden.objects[:, 16:].any()


def test_object_that_is_not_learned_is_background(image, targets):
    only = make_targets(image, OBJECTS[1:])
    assert (only.objects > 0)[targets.objects == 2].all()
    assert np.count_nonzero((only.objects > 0) != (targets.objects == 2)) <= 3  # cells that show both alike
    assert only.objects.max() == 1


def test_image_without_instances_is_background():
    empty = make_targets(labelled([]), OBJECTS)
    assert not empty.objects.any()
    assert empty.coordinates.shape == (24, 32, 3)
