"""Convex pieces: they contain the surface of any mesh, keep out of its hollows, and are few."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import ConvexHull
from test_arranging import cuboid, pedestal, rng

from pipeline.bop.models import read_model
from pipeline.scene import Model
from pipeline.synth.arranging import Falling, Standing, arrange, check
from pipeline.synth.arranging.convex_hulls import CHIPPED, few_corners, moments
from pipeline.synth.arranging.convex_pieces import MOST_PIECES, pieces_of
from pipeline.synth.arranging.interpenetration import SPACING, points_on, surface_points
from pipeline.synth.arranging.soup import split
from pipeline.synth.arranging.watertight import is_watertight
from pipeline.synth.demo.part_files import part_model

pytest.importorskip("mujoco")


def of_trimesh(mesh, obj_id: int = 60) -> Model:
    vertices = np.array(mesh.vertices, float)
    return Model(obj_id, vertices, np.array(mesh.faces, np.int32), float(np.linalg.norm(np.ptp(vertices, axis=0))))


def ring() -> Model:
    """A thin ring, 80 mm wide."""
    import trimesh

    return of_trimesh(trimesh.creation.torus(0.036, 0.004, major_sections=48, minor_sections=16))


def open_tray() -> Model:
    """Four walls and a bottom without thickness, open above."""
    box = cuboid(0.08, 0.06, 0.04, obj_id=61)
    low = (box.vertices[box.faces][:, :, 2] < 0.019).any(axis=1)
    return replace(box, faces=box.faces[low])


def outside(model: Model, points: np.ndarray) -> np.ndarray:
    """Metres that each point lies outside of all pieces of a model."""
    found = np.full(len(points), np.inf)
    for hull in pieces_of(model).hulls:
        equations = ConvexHull(hull).equations
        found = np.minimum(found, (points @ equations[:, :3].T + equations[:, 3]).max(axis=1))
    return found


@pytest.mark.parametrize("make", [lambda: part_model(2), lambda: part_model(5), ring, open_tray])
def test_pieces_contain_the_surface_of_any_mesh(make):
    model = make()
    assert 1 <= len(pieces_of(model).hulls) <= MOST_PIECES
    assert outside(model, surface_points(model)).max() <= CHIPPED + 1e-9


def test_pieces_stay_out_of_hollows():
    inside_ring = np.array([[0.0, 0, 0], [0.028, 0, 0], [0, -0.028, 0.001]])
    assert outside(ring(), inside_ring).min() > 0.001
    assert outside(open_tray(), np.array([[0.0, 0, 0], [0.03, 0.02, 0.01]])).min() > 0.001


def test_a_convex_body_is_one_piece_and_weighs_what_it_should():
    pieces = pieces_of(cuboid(0.03, 0.04, 0.05))
    assert len(pieces.hulls) == 1
    assert pieces.volume == pytest.approx(6e-5)
    np.testing.assert_allclose(pieces.centre, 0.0, atol=1e-9)
    np.testing.assert_allclose(np.diag(pieces.inertia), 6e-5 / 12 * np.array([0.0041, 0.0034, 0.0025]))


def test_two_bodies_weigh_as_one():
    corners = np.array(list(np.ndindex(2, 2, 2)), float)
    whole = moments([corners * np.array([2.0, 1, 1])])
    halves = moments([corners, corners + np.array([1.0, 0, 0])])
    for one, two in zip(whole, halves, strict=True):
        np.testing.assert_allclose(one, two, atol=1e-12)


def test_pieces_are_computed_once_per_content():
    model = part_model(2)
    assert pieces_of(replace(model, vertices=model.vertices.copy(), obj_id=99)) is pieces_of(model)


def test_few_corners_fall_short_by_a_tenth_of_a_millimetre():
    directions = rng().normal(size=(4000, 3))
    ball = 0.02 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    kept = few_corners(ball)
    assert len(kept) < 1200
    equations = ConvexHull(kept).equations
    assert (ball @ equations[:, :3].T + equations[:, 3]).max() <= CHIPPED


def test_splitting_keeps_all_of_the_surface():
    def area(soup):
        return np.linalg.norm(np.cross(soup[:, 1] - soup[:, 0], soup[:, 2] - soup[:, 0]), axis=1).sum() / 2

    soup = rng().normal(size=(300, 3, 3))
    soup[:40, 0, 1] = 0.1  # corners and edges on the plane
    soup[20:60, 1, 1] = 0.1
    low, high = split(soup, 1, 0.1)
    assert low[..., 1].max() <= 0.1 + 1e-12
    assert high[..., 1].min() >= 0.1 - 1e-12
    assert area(low) + area(high) == pytest.approx(area(soup))


def test_points_cover_large_and_narrow_triangles():
    triangles = np.array([[[0, 0, 0], [0.05, 0, 0], [0, 0.05, 0]], [[0, 0, 1], [0.08, 0, 1], [0.08, 0.001, 1.0]]])
    points = np.concatenate([points_on(triangles), triangles.reshape(-1, 3)])
    wanted = rng().dirichlet((1, 1, 1), 500)
    for triangle in triangles:
        gaps = np.linalg.norm((wanted @ triangle)[:, None] - points, axis=2).min(axis=1)
        assert gaps.max() < SPACING
    assert len(points) < 1200


def test_watertight_is_told_also_where_vertices_are_repeated():
    assert is_watertight(part_model(2))
    assert is_watertight(cuboid(0.1, 0.1, 0.1))
    assert not is_watertight(open_tray())
    assert not is_watertight(replace(part_model(2), faces=part_model(2).faces[1:]))


def test_an_open_mesh_works_and_warns_once(caplog: pytest.LogCaptureFixture):
    world, tray = pedestal(), open_tray()
    arrangement = arrange(world, world.stages[0], [tray], Falling(instances=(2, 2)), rng())
    assert len(arrangement.models) == 2
    assert check(world, arrangement).faults == []
    arrange(world, world.stages[0], [tray], Standing(), rng())
    assert caplog.text.count("object 61: not watertight") == 1


def test_a_flat_sheet_lies_on_the_stage():
    corners = np.array([[-0.05, -0.04, 0], [0.05, -0.04, 0], [0.05, 0.04, 0], [-0.05, 0.04, 0.0]])
    paper = Model(62, corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32), 0.13)
    world = pedestal()
    arrangement = arrange(world, world.stages[0], [paper], Falling(heights=(0.05, 0.1)), rng())
    assert arrangement.world_from_models[0][2, 3] == pytest.approx(0.4, abs=0.0006)


@pytest.mark.parametrize(("dataset", "ids"), [("lmo", (11,)), ("ycbv", (8, 13))])
def test_models_of_real_datasets_come_to_rest(shared_data: Path, dataset: str, ids: tuple[int, ...]):
    world = pedestal(width=1.0)
    files = [shared_data / dataset / "models" / f"obj_{obj_id:06d}.ply" for obj_id in ids]
    models = [read_model(file, obj_id, appearance=False) for file, obj_id in zip(files, ids, strict=True)]
    arrangement = arrange(world, world.stages[0], models, Falling(spread=0.3), rng())
    assert len(arrangement.models) == len(ids)
    found = check(world, arrangement)
    assert found.faults == []
    assert 0.0 < found.lowest < 4e-4
