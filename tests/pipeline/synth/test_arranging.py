"""Arrangements: at rest, free of overlap, on the stage, in every scene; what cannot be arranged is told in one line."""

from dataclasses import replace
from functools import cache
from itertools import combinations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from pipeline.geometry import inverse, transform_points
from pipeline.scene import Model
from pipeline.synth.arranging import (
    Arrangement,
    EmptyStageError,
    Falling,
    NoRestError,
    NothingToArrangeError,
    Standing,
    arrange,
    check,
    falling,
)
from pipeline.synth.arranging.arrangement import MAX_OVERLAP, REST_SPEED
from pipeline.synth.arranging.convex_pieces import pieces_of
from pipeline.synth.arranging.interpenetration import surface_points
from pipeline.synth.arranging.simulation import Simulation
from pipeline.synth.demo.part_files import merged, part_model
from pipeline.synth.demo.parts import part_mesh
from pipeline.synth.materials import Material
from pipeline.synth.worlds import WORLDS, build_world, surfaces
from pipeline.synth.worlds.shapes import box, joined
from pipeline.synth.worlds.world import Stage, World

pytest.importorskip("mujoco")


@cache
def world_of(name: str) -> World:
    """A scene with coarse textures, which are most of the work."""
    full, surfaces.SIZE = surfaces.SIZE, 64
    try:
        return build_world(name, 0)
    finally:
        surfaces.SIZE = full


def pedestal(width: float = 0.5, height: float = 0.4) -> World:
    """A block on a floor, its top a stage."""
    shapes = [box(4.0, 4.0, 0.1).moved(z=-0.1), box(width, width, height, 0.001)]
    half = width / 2 - 0.002
    polygon = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1.0]])
    place = np.eye(4)
    place[2, 3] = height
    pieces = (joined(shapes).piece("block", Material()),)
    room = np.array([[-2, -2, 0], [2, 2, 3.0]])
    return World("pedestal", 0, pieces, (), (Stage("top", polygon, place, 1.0),), room)


def parts(*ids: int) -> list[Model]:
    return [part_model(obj_id) for obj_id in ids]


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def cuboid(*size: float, obj_id: int = 50) -> Model:
    """A box without bevels, about the origin."""
    import trimesh

    mesh = trimesh.creation.box(size)
    return Model(obj_id, np.array(mesh.vertices), np.array(mesh.faces, np.int32), float(np.linalg.norm(size)))


def in_stage(arrangement: Arrangement) -> list[np.ndarray]:
    """Vertices of all objects, stage frame."""
    stage_from_world = inverse(arrangement.stage.world_from_stage)
    pairs = zip(arrangement.models, arrangement.world_from_models, strict=True)
    return [transform_points(stage_from_world @ pose, model.vertices) for model, pose in pairs]


def shifted(arrangement: Arrangement, index: int, by: tuple[float, float, float]) -> Arrangement:
    """With one object moved."""
    poses = [pose.copy() for pose in arrangement.world_from_models]
    poses[index][:3, 3] += by
    return replace(arrangement, world_from_models=tuple(poses))


@pytest.mark.parametrize("name", WORLDS)
def test_objects_come_to_rest_in_every_scene(name):
    world = world_of(name)
    arrangement = arrange(world, world.stages[0], parts(2, 4, 5), Falling(), rng())
    found = check(world, arrangement)
    assert found.faults == []
    assert found.overlap < 1e-4
    assert 0.0 < found.lowest < 4e-4  # neither in the stage nor to be seen above it
    assert found.speed <= REST_SPEED
    assert len(arrangement.models) + len(arrangement.left_off) == 3
    for points in in_stage(arrangement):
        assert arrangement.stage.contains((points.min(axis=0) + points.max(axis=0))[:2] / 2)
    for pose in arrangement.world_from_models:
        np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-9)


@pytest.mark.parametrize("name", ["cube_room", "kitchen"])
def test_objects_stand_densely(name):
    world, how = world_of(name), Standing(gap=(0.002, 0.01))
    stage = world.stages[-1]
    arrangement = arrange(world, stage, parts(2, 3, 4, 5), how, rng())
    assert len(arrangement.models) == 4
    assert check(world, arrangement).faults == []
    assert check(world, arrangement).overlap < 1e-6
    clouds = [transform_points(pose, surface_points(model)) for model, pose in zip(arrangement.models, arrangement.world_from_models, strict=True)]  # fmt: skip
    between = [min(cKDTree(a).query(b)[0].min() for b in clouds if b is not a) for a in clouds]
    assert min(between) > how.gap[0]
    assert max(between) < 0.04
    for pose, points in zip(arrangement.world_from_models, in_stage(arrangement), strict=True):
        np.testing.assert_allclose(pose[:3, 2], (0, 0, 1), atol=1e-9)
        assert abs(points[:, 2].min()) < 1e-9
        assert stage.contains(points[:, :2]).all()


def test_the_generator_decides():
    world = pedestal()
    for how in (Falling(), Standing()):
        first, again, other = (arrange(world, world.stages[0], parts(2, 4), how, rng(seed)) for seed in (0, 0, 1))
        np.testing.assert_array_equal(first.world_from_models, again.world_from_models)
        assert not np.allclose(first.world_from_models, other.world_from_models)


def test_a_pile_in_a_bin_is_sound_and_inside():
    world = world_of("storage_shelf")
    stage = world.stage("bin A1")
    arrangement = arrange(world, stage, parts(2, 4), Falling(instances=(5, 5)), rng())
    assert check(world, arrangement).faults == []
    assert len(arrangement.models) >= 8
    points = np.concatenate(in_stage(arrangement))
    assert points[:, 2].max() < stage.free_height + 0.01
    assert (np.abs(points[:, 0]) < 0.15).all()  # the sides of the bin
    assert volume_shared(arrangement) < 0.5e-9


def volume_shared(arrangement: Arrangement) -> float:
    """The largest volume that two of our parts have in common, by boolean operations (cubic metres)."""
    manifold = pytest.importorskip("manifold3d")
    solids = []
    for model, pose in zip(arrangement.models, arrangement.world_from_models, strict=True):
        mesh = merged(part_mesh(model.obj_id))
        vertices = transform_points(pose, mesh.vertices_mm / 1000.0).astype(np.float64)
        solids.append(manifold.Manifold(manifold.Mesh64(vertices, mesh.faces.astype(np.uint64))))
        assert solids[-1].volume() > 1e-6
    return max((a ^ b).volume() for a, b in combinations(solids, 2))


def test_instances_are_counted_per_model():
    world = pedestal()
    twice = arrange(world, world.stages[0], parts(2, 4), Standing(instances=(2, 2)), rng())
    assert sorted(model.obj_id for model in twice.models) == [2, 2, 4, 4]
    counts = {
        len(arrange(world, world.stages[0], parts(2), Standing(instances=(1, 3)), rng(k)).models) for k in (0, 1, 11)
    }
    assert counts == {1, 2, 3}


@pytest.mark.parametrize("orientation", ["canonical", "random"])
def test_objects_start_free_and_in_the_range_of_heights(orientation):
    world, models = pedestal(), parts(5, 2, 3, 4)
    how = Falling(heights=(0.1, 0.3), orientation=orientation)
    poses = [falling._start_pose(world.stages[0], models[0], how, rng(k)) for k in range(200)]
    lowest = np.array([transform_points(pose, models[0].vertices)[:, 2].min() for pose in poses])
    assert lowest.min() >= 0.1 - 1e-9
    assert lowest.max() <= 0.3 + 1e-9
    assert np.ptp(lowest) > 0.18
    tilts = np.array([pose[2, 2] for pose in poses])
    assert (tilts.min() > 1 - 1e-9) if orientation == "canonical" else (tilts.min() < -0.9)
    simulation = Simulation([pieces_of(model) for model in models], world.hulls_near(world.stages[0]))
    left = falling._start(simulation, world.stages[0], models, range(4), how, rng())
    assert left == []
    assert not any(simulation.touched(index) for index in range(4))


def test_a_small_spread_makes_a_denser_pile():
    world = pedestal()
    wide, near = (arrange(world, world.stages[0], parts(2, 3, 4, 5), Falling(spread=s), rng(2)) for s in (None, 0.2))
    spans = [np.ptp(np.array(a.world_from_models)[:, :2, 3], axis=0).max() for a in (wide, near)]
    assert spans[1] < 0.2 < spans[0]


def test_what_falls_off_the_stage_is_named_and_taken_away():
    world = pedestal(width=0.13)
    how = Falling(kept_in=False, instances=(2, 2))
    arrangement = arrange(world, world.stages[0], parts(2, 3, 4, 5), how, rng(1))
    assert arrangement.left_off
    assert sorted([*arrangement.left_off, *(m.obj_id for m in arrangement.models)]) == [2, 2, 3, 3, 4, 4, 5, 5]
    assert check(world, arrangement).faults == []  # also without those that they may have leant on
    assert min(points[:, 2].min() for points in in_stage(arrangement)) > -MAX_OVERLAP


def test_what_rests_stays_for_longer_than_it_was_looked_at():
    world = pedestal()
    arrangement = arrange(world, world.stages[0], parts(2, 3, 4, 5), Falling(spread=0.2), rng(3))
    simulation = Simulation([pieces_of(model) for model in arrangement.models], world.hulls_near(arrangement.stage))
    before = falling.stage_poses(arrangement.stage, arrangement.world_from_models)
    for index, pose in enumerate(before):
        simulation.place(index, pose)
    simulation.run(2.0)
    assert simulation.displacements(before, simulation.poses()).max() < 0.0005


# ---- what is refused


def test_nothing_to_arrange_is_refused():
    world = pedestal()
    stage = world.stages[0]
    with pytest.raises(NothingToArrangeError, match="no models to arrange; give at least one"):
        arrange(world, stage, [], Falling(), rng())
    cloud = replace(part_model(1), faces=np.zeros((0, 3), np.int32))
    with pytest.raises(NothingToArrangeError, match="object 1: no faces; give a mesh"):
        arrange(world, stage, [cloud], Falling(), rng())
    small = replace(part_model(2), vertices=part_model(2).vertices / 1000, diameter=0.0001)
    with pytest.raises(NothingToArrangeError, match=r"object 2: diameter 0\.1 mm; model files are in millimetres"):
        arrange(world, stage, [small], Falling(), rng())
    broken = replace(part_model(2), vertices=np.where(np.arange(3) == 1, np.nan, part_model(2).vertices))
    with pytest.raises(NothingToArrangeError, match="object 2: vertices that are not finite"):
        arrange(world, stage, [broken], Falling(), rng())
    with pytest.raises(EmptyStageError, match=r"stage top: instances \(0, 0\) give no object"):
        arrange(world, stage, parts(1), Falling(instances=(0, 0)), rng())


@pytest.mark.parametrize("polygon", [np.zeros((4, 2)), np.array([[0, 0], [1, 0.0]]), np.full((3, 2), np.nan)])
def test_a_stage_without_room_is_refused(polygon):
    world = pedestal()
    stage = replace(world.stages[0], polygon=polygon)
    with pytest.raises(EmptyStageError, match=rf"stage top: {len(polygon)} corners.*give a convex polygon"):
        arrange(world, stage, parts(1), Falling(), rng())


@pytest.mark.parametrize("how", [Falling(tries=2), Standing(tries=2)])
def test_a_stage_on_which_nothing_can_rest_is_told(how):
    world = world_of("storage_shelf")
    huge = cuboid(0.4, 0.4, 0.4)
    with pytest.raises(EmptyStageError, match=r"stage bin A1 \(270 x \d+ mm\): nothing came to rest on it \(1 objects, 2 tries; the largest, object 50, measures 693 mm\); choose a larger stage"):  # fmt: skip
        arrange(world, world.stage("bin A1"), [huge], how, rng())


def test_objects_that_never_rest_are_told(monkeypatch):
    monkeypatch.setattr(falling, "LONGEST", 0.2)
    world = pedestal()
    with pytest.raises(NoRestError, match=r"stage top .*no arrangement is sound \(1 objects, 2 tries; 2 times: objects still moved"):  # fmt: skip
        arrange(world, world.stages[0], parts(2), Falling(tries=2), rng())


# ---- the check finds what is wrong


@cache
def two_on_a_pedestal() -> tuple[World, Arrangement]:
    world = pedestal()
    return world, arrange(world, world.stages[0], [cuboid(0.05, 0.05, 0.05), cuboid(0.06, 0.06, 0.06, obj_id=51)], Standing(gap=(0.02, 0.02)), rng())  # fmt: skip


def test_check_finds_what_is_sunk_into_the_stage():
    world, arrangement = two_on_a_pedestal()
    assert check(world, arrangement).faults == []
    for depth in (0.002, 0.02, 0.2):
        found = check(world, shifted(arrangement, 0, (0, 0, -depth)))
        assert found.between == "object 50 and the world"
        assert found.lowest == pytest.approx(-depth, abs=1e-6)
        assert found.overlap == pytest.approx(min(depth, 0.25 - 0.05), rel=0.3)
        assert any("below the stage" in fault for fault in found.faults)


def test_check_finds_objects_in_each_other():
    world, arrangement = two_on_a_pedestal()
    first, second = (pose.copy() for pose in arrangement.world_from_models)
    second[:3, :3] = first[:3, :3]
    for overlap in (0.0005, 0.003, 0.01):
        second[:3, 3] = transform_points(first, np.array([0.055 - overlap, 0.0, 0.005]))
        found = check(world, replace(arrangement, world_from_models=(first, second)))
        assert found.overlap == pytest.approx(overlap, abs=1e-5)
        assert found.between == "objects 50 and 51"
        assert bool(found.faults) == (overlap > MAX_OVERLAP)
    second[:3, 3] = first[:3, 3] + (0, 0, 0.005)  # one wholly inside the other
    assert check(world, replace(arrangement, world_from_models=(first, second))).overlap > 0.009


def test_check_finds_thin_sheets_that_cross():
    world = pedestal()
    sheets = (cuboid(0.1, 0.0008, 0.05), cuboid(0.0008, 0.1, 0.05, obj_id=51))
    pose = world.stages[0].world_from_stage.copy()
    pose[2, 3] += 0.0252
    beside = pose.copy()
    beside[0, 3] += 0.06
    apart = Arrangement(world.stages[0], sheets, (pose, beside), fallen=False)
    assert check(world, apart).overlap == 0.0
    crossed = check(world, replace(apart, world_from_models=(pose, pose)))
    assert crossed.overlap > 0.02  # though no point is deeper than 0.4 mm
    assert crossed.faults


def test_check_finds_what_stands_in_a_wall_and_what_moves():
    world = world_of("storage_shelf")
    stage = world.stage("bin A1")
    pose = stage.world_from_stage.copy()
    pose[:3, 3] += pose[:3, :3] @ (0.13, 0.0, 0.0252)  # the bin's side is at 0.15
    cube = (cuboid(0.05, 0.05, 0.05),)
    found = check(world, Arrangement(stage, cube, (pose,)))
    assert found.overlap == pytest.approx(0.005, abs=0.001)
    pose[:3, 3] = stage.world_from_stage[:3, 3] + (0, 0, 0.08)
    hanging = check(world, Arrangement(stage, cube, (pose,)))
    assert hanging.overlap == 0.0
    assert hanging.speed > 0.01
    assert any("moves at" in fault for fault in hanging.faults)
