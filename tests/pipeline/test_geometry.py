import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.geometry import (
    distance_from_depth,
    inverse,
    points_from_depth,
    project,
    rotation_error,
    transform,
    transform_points,
    unproject,
)

K = np.array([[572.4, 0.0, 325.3], [0.0, 573.6, 242.0], [0.0, 0.0, 1.0]])


def sheared_pose() -> np.ndarray:
    """A pose like LM-O's, whose rotations are not quite orthonormal."""
    rotation = Rotation.from_euler("xyz", [0.3, -1.2, 2.0]).as_matrix()
    return transform(rotation + 5e-3 * np.arange(9).reshape(3, 3) / 9, np.array([0.1, -0.2, 0.8]))


def test_transform_keeps_the_rotation_as_given():
    matrix = np.arange(9.0).reshape(3, 3)
    pose = transform(matrix, np.array([1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(pose[:3, :3], matrix)
    np.testing.assert_array_equal(pose[:, 3], [1, 2, 3, 1])
    np.testing.assert_array_equal(pose[3], [0, 0, 0, 1])


def test_inverse_is_the_true_inverse_where_the_rotation_is_not_orthonormal():
    pose = sheared_pose()
    np.testing.assert_allclose(inverse(pose) @ pose, np.eye(4), atol=1e-14)


def test_inverse_of_many_is_each_inverse():
    poses = np.stack([sheared_pose(), np.eye(4), sheared_pose() @ sheared_pose()])
    np.testing.assert_allclose(inverse(poses), [inverse(pose) for pose in poses], atol=1e-14)


def test_a_transform_and_its_inverse_bring_points_back():
    points = np.random.default_rng(0).normal(size=(5, 7, 3))
    there = transform_points(sheared_pose(), points)
    assert there.shape == points.shape
    np.testing.assert_allclose(transform_points(inverse(sheared_pose()), there), points, atol=1e-13)


def test_project_then_unproject_gives_the_point_back():
    points = np.random.default_rng(1).uniform([-1, -1, 0.3], [1, 1, 3], size=(50, 3))
    np.testing.assert_allclose(unproject(K, project(K, points), points[:, 2]), points, atol=1e-13)


def test_a_point_on_the_axis_projects_to_the_principal_point():
    np.testing.assert_allclose(project(K, np.array([0.0, 0.0, 2.0])), K[:2, 2])


def test_a_point_in_the_camera_plane_projects_to_infinity_without_a_warning():
    assert np.isinf(project(K, np.array([1.0, 1.0, 0.0]))).all()


def test_points_from_depth_are_the_measured_pixels_row_by_row():
    depth = np.zeros((4, 5), np.float32)
    depth[1, 3], depth[2, 0] = 0.5, 2.0
    points, measured = points_from_depth(K, depth)
    assert measured.sum() == 2
    np.testing.assert_allclose(project(K, points), [[3, 1], [0, 2]], atol=1e-12)
    np.testing.assert_allclose(points[:, 2], [0.5, 2.0])


def test_distance_is_the_length_of_the_point_and_zero_without_depth():
    depth = np.full((6, 7), 0.7, np.float32)
    depth[0, 0] = 0
    distance = distance_from_depth(K, depth)
    assert distance.dtype == np.float64
    assert distance[0, 0] == 0
    points, measured = points_from_depth(K, depth)
    np.testing.assert_allclose(distance[measured], np.linalg.norm(points, axis=1), rtol=1e-12)


@pytest.mark.parametrize("angle", [0.0, 1e-3, 1.0, np.pi])
def test_rotation_error_is_the_angle_between(angle: float):
    R = Rotation.from_euler("xyz", [0.3, -1.2, 2.0]).as_matrix()
    turned = Rotation.from_rotvec(angle * np.array([0.6, 0.0, 0.8])).as_matrix() @ R
    assert rotation_error(turned, R) == pytest.approx(angle, abs=1e-7)
    assert rotation_error(R, turned) == pytest.approx(angle, abs=1e-7)
