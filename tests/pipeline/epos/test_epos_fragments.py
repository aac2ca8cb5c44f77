"""Fragments: farthest-point sampling, partition, sizes, coordinates; against brute force."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from epos_cases import cone, meshed, wedge
from tiny_dataset import box

from pipeline.epos.fragments import fragments_of
from pipeline.exceptions import InputError


def surface(model, count=40_000):
    mesh = trimesh.Trimesh(model.vertices, model.faces, process=False)
    return np.asarray(trimesh.sample.sample_surface(mesh, count, seed=1)[0])


def slow_centers(vertices, count):
    chosen = [vertices.mean(axis=0)]
    for _ in range(count):
        chosen.append(max(vertices, key=lambda v: min(np.linalg.norm(v - c) for c in chosen)))
    return np.array(chosen[1:])


@pytest.mark.parametrize("model", [wedge(), cone()])
def test_centers_are_farthest_points_from_the_centroid_on(model):
    rng = np.random.default_rng(0)
    jittered = replace(model, vertices=model.vertices + rng.normal(0, 1e-4, model.vertices.shape))  # no ties
    np.testing.assert_allclose(fragments_of(jittered, 12).centers, slow_centers(jittered.vertices, 12))


def test_centers_are_different_vertices_without_the_centroid():
    model = wedge()
    centers = fragments_of(model, 64).centers
    assert len(np.unique(centers, axis=0)) == 64
    assert all((model.vertices == center).all(axis=1).any() for center in centers)


def test_every_surface_point_belongs_to_the_nearest_center():
    fragments, points = fragments_of(wedge(), 30), surface(wedge(), 3000)
    distances = np.linalg.norm(points[:, None] - fragments.centers, axis=2)
    ids = fragments.locate(points).fragment_ids
    np.testing.assert_allclose(distances[np.arange(len(points)), ids], distances.min(axis=1))
    assert set(ids) == set(range(30))  # all of them have some surface


def test_size_is_the_longest_side_of_the_bounding_box():
    model, points = wedge(), surface(wedge())
    fragments = fragments_of(model, 20)
    ids = fragments.locate(points).fragment_ids
    sides = np.array([np.ptp(points[ids == f], axis=0).max() for f in range(20)])
    np.testing.assert_allclose(fragments.sizes, sides, atol=0.015 * model.diameter)
    assert np.abs(fragments.locate(points).coordinates).max() <= 1.1


def test_coordinates_and_points_are_inverse():
    fragments, points = fragments_of(cone(), 64), surface(cone(), 2000)
    np.testing.assert_allclose(fragments.points(*fragments.locate(points)), points, atol=1e-15)


def test_one_fragment_is_the_whole_object():
    model = wedge()
    fragments = fragments_of(model, 1)
    assert len(fragments) == 1
    assert fragments.sizes[0] == pytest.approx(np.ptp(model.vertices, axis=0).max())


def test_box_of_eight_vertices_gets_64_fragments():
    fragments = fragments_of(box(1), 64)
    assert len(np.unique(fragments.centers, axis=0)) == 64
    half = np.abs(box(1).vertices).max(axis=0)
    assert np.isclose(np.abs(fragments.centers) / half, 1).any(axis=1).all()  # on the surface
    assert (fragments.sizes < 0.6 * 2 * half.max()).all()


def test_same_content_is_computed_once():
    first, second = wedge(), wedge(obj_id=7)
    assert fragments_of(first, 16) is fragments_of(second, 16)
    moved = replace(first, vertices=first.vertices + 1e-3)
    assert fragments_of(moved, 16) is not fragments_of(first, 16)
    with pytest.raises(ValueError, match="read-only"):
        fragments_of(first, 16).centers[0] = 0


def test_vertices_of_no_face_are_no_surface():
    model = wedge()
    stray = replace(model, vertices=np.vstack([model.vertices, [[1.0, 1.0, 1.0]]]))
    np.testing.assert_array_equal(fragments_of(stray, 8).centers, fragments_of(model, 8).centers)


@pytest.mark.parametrize(
    ("change", "count", "message"),
    [
        ({}, 0, "object 1: 0 fragments; expected 1 or more"),
        ({"faces": np.zeros((0, 3), np.int32)}, 4, "object 1: the model has no faces"),
        ({"vertices": np.full((3, 3), np.nan)}, 4, "vertices that are not finite"),
        ({"vertices": np.ones((3, 3))}, 4, "all vertices are in one place"),
    ],
)
def test_bad_input_is_named(change, count, message):
    triangle = meshed(1, trimesh.Trimesh(np.eye(3), [[0, 1, 2]], process=False))
    with pytest.raises(InputError, match=message) as error:
        fragments_of(replace(triangle, **change), count)
    assert "\n" not in str(error.value)
