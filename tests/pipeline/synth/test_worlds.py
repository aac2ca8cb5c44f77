"""The scenes: all build, stages are flat, free and supported, nothing floats, the seed decides, hulls contain."""

from functools import cache

import numpy as np
import pytest

from pipeline.exceptions import UnknownIdError
from pipeline.geometry import inverse, transform_points
from pipeline.ray_casting import _raycaster
from pipeline.synth.materials import (
    METAL,
    PAINTED_METAL,
    PLASTIC,
    Material,
    fixed_material,
    random_material,
    randomized,
)
from pipeline.synth.worlds import FURNISHED, WORLDS, build_world, prints, shapes, surfaces
from pipeline.synth.worlds.noise import clouds
from pipeline.synth.worlds.world import AreaLight, Stage, World


@cache
def world_of(name: str, seed: int = 0) -> World:
    """A scene with coarse textures, which are most of the work."""
    full, surfaces.SIZE = surfaces.SIZE, 64
    try:
        return build_world(name, seed)
    finally:
        surfaces.SIZE = full


def points_on(stage: Stage, height: float, margin: float = 0.0) -> np.ndarray:
    """A grid of points above the stage, in the world."""
    low, high = stage.polygon.min(axis=0), stage.polygon.max(axis=0)
    grid = np.stack(np.meshgrid(*np.linspace(low, high, 15).T), axis=-1).reshape(-1, 2)
    inside = grid[stage.contains(grid, margin)]
    return transform_points(stage.world_from_stage, np.c_[inside, np.full(len(inside), height)])


def distances(world: World, origins: np.ndarray, direction: np.ndarray | tuple[float, float, float]) -> np.ndarray:
    """How far rays go until they meet something."""
    from open3d.core import Tensor

    rays = np.c_[origins, np.broadcast_to(direction, origins.shape)].astype(np.float32)
    return _raycaster(world.model).cast_rays(Tensor.from_numpy(rays))["t_hit"].numpy()


@pytest.mark.parametrize("name", WORLDS)
@pytest.mark.parametrize("seed", [0, 1])
def test_stages_are_supported_flat_and_free(name, seed):
    world = world_of(name, seed)
    assert len(world.stages) >= (2 if name in FURNISHED else 1)
    assert len({stage.name for stage in world.stages}) == len(world.stages)
    for stage in world.stages:
        assert stage.free_height > 0.1
        assert stage.area > 0.02
        np.testing.assert_allclose(stage.world_from_stage[:3, 2], (0, 0, 1), atol=1e-12)
        down = distances(world, points_on(stage, 0.02), (0.0, 0.0, -1.0))
        assert np.abs(down - 0.02).max() < 0.002, f"{stage.name} is not flat or not supported"
        up = distances(world, points_on(stage, 0.003), (0.0, 0.0, 1.0))
        assert up.min() > stage.free_height - 0.004, f"something stands on or hangs low over {stage.name}"


@pytest.mark.parametrize("name", WORLDS)
def test_stages_do_not_overlap_and_lie_in_the_room(name):
    world = world_of(name)
    for i, stage in enumerate(world.stages):
        points = points_on(stage, 0.05)
        assert (points > world.room[0] - 0.1).all()  # a window sill reaches into the wall
        assert (points < world.room[1] + 0.1).all()
        for other in world.stages[i + 1 :]:
            local = transform_points(inverse(other.world_from_stage), points)
            assert not (other.contains(local[:, :2]) & (np.abs(local[:, 2]) < 0.1)).any()


@pytest.mark.parametrize("name", WORLDS)
def test_every_scene_is_lit_and_closed(name):
    world = world_of(name)
    assert any(isinstance(lamp, AreaLight) for lamp in world.lights)
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(500, 3))
    centre = world.room.mean(axis=0)
    assert np.isfinite(distances(world, np.tile(centre, (500, 1)), directions)).all()


@pytest.mark.parametrize("name", FURNISHED)
def test_the_seed_decides(name):
    again, other = build_small(name, 0), world_of(name, 1)
    first = world_of(name, 0)
    np.testing.assert_array_equal(first.model.vertices, again.model.vertices)
    for one, two in zip(first.pieces, again.pieces, strict=True):
        assert one.material.color == two.material.color
        if one.material.texture is not None and two.material.texture is not None:
            np.testing.assert_array_equal(one.material.texture.image, two.material.texture.image)
    assert first.lights == again.lights
    assert first.lights != other.lights
    assert not np.array_equal(first.model.vertices, other.model.vertices)


def build_small(name: str, seed: int) -> World:
    return world_of.__wrapped__(name, seed)


@pytest.mark.parametrize("name", WORLDS)
def test_nothing_floats(name):
    """Every piece but lamps and what hangs on walls touches another piece, or the floor, within 2 mm."""
    world = world_of(name)
    boxes = [(p.name, p.vertices.min(axis=0), p.vertices.max(axis=0)) for p in world.pieces]
    low = np.array([b[1] for b in boxes])
    high = np.array([b[2] for b in boxes])
    for i, (piece, lowest, highest) in enumerate(boxes):
        near = (low <= highest + 0.002).all(axis=1) & (high >= lowest - 0.002).all(axis=1)
        near[i] = False
        assert near.any(), f"{piece} at {lowest.round(3)} touches nothing"


@pytest.mark.parametrize("name", WORLDS)
def test_hulls_are_solid_and_contain_their_pieces(name):
    from scipy.spatial import ConvexHull

    world = world_of(name)
    stage = world.stages[0]
    near = world.hulls_near(stage)
    assert near
    for hull in near:
        assert ConvexHull(hull).volume > 1e-9
    floor = min(points[:, 2].min() for points in near)
    assert floor < -stage.world_from_stage[2, 3] + 1e-6  # the floor is among them
    for piece in world.pieces:
        if piece.name in ("table top", "worktop", "bench top", "shelf", "floor"):
            inside = np.zeros(len(piece.vertices), bool)
            for hull in piece.hulls:
                equations = ConvexHull(hull).equations
                inside |= (piece.vertices @ equations[:, :3].T + equations[:, 3] < 1e-6).all(axis=1)
            assert inside.all(), piece.name


def test_stage_polygons_contain_and_sample():
    stage = Stage("s", np.array([[-0.2, -0.1], [0.2, -0.1], [0.2, 0.1], [-0.2, 0.1]]), np.eye(4), 0.5)
    assert stage.area == pytest.approx(0.08)
    assert stage.contains(np.array([[0.0, 0.0], [0.19, 0.09], [0.21, 0.0]])).tolist() == [True, True, False]
    assert stage.contains(np.array([[0.19, 0.0]]), margin=0.02).tolist() == [False]
    points = stage.sample(np.random.default_rng(0), 500, margin=0.05)
    assert points.shape == (500, 2)
    assert np.abs(points[:, 0]).max() <= 0.15
    assert abs(points[:, 0].std() - 0.3 / np.sqrt(12)) < 0.01  # uniform
    with pytest.raises(ValueError, match=r"stage s: a margin of 0.2 m leaves no room in \[0.4 0.2\] m"):
        stage.sample(np.random.default_rng(0), 1, margin=0.2)


def test_unknown_names_are_told_with_those_there_are():
    with pytest.raises(UnknownIdError, match="scene attic is not in the scenes; available: cube_room, kitchen"):
        build_world("attic")
    with pytest.raises(KeyError, match="cube_room has no stage 'shelf'; it has: floor"):
        world_of("cube_room").stage("shelf")


def test_clearance_is_the_distance_to_the_nearest_surface():
    world = world_of("cube_room")
    above = np.array([[2.0, 2.0, 0.25], [2.0, 2.0, 2.5]])
    assert world.clearance(above)[0] == pytest.approx(0.25, abs=0.01)
    assert world.clearance(above)[1] == pytest.approx(1.5, abs=0.2)


# ---- materials and shapes


def test_materials_keep_to_their_ranges():
    with pytest.raises(ValueError, match=r"outside 0\.\.1"):
        Material(color=(255.0, 0.0, 0.0))
    with pytest.raises(ValueError, match=r"outside 0\.\.1"):
        Material(roughness=1.5)
    rng = np.random.default_rng(0)
    made = [random_material(rng) for _ in range(300)]  # the constructor checks the ranges
    assert {m.metallic > 0.9 for m in made} == {True, False}
    assert random_material(rng, METAL).metallic == 1.0
    assert random_material(rng, PLASTIC).metallic == 0.0
    assert 0 < random_material(rng, PAINTED_METAL).metallic < 0.5
    assert fixed_material(PLASTIC).color is None
    assert fixed_material(METAL).metallic == 1.0
    kept = Material((0.1, 0.2, 0.3))
    spread = [randomized(kept, rng) for _ in range(100)]
    assert {m.color for m in spread} == {kept.color}
    assert np.ptp([m.roughness for m in spread]) > 0.7


def test_textures_repeat_without_a_seam():
    rng = np.random.default_rng(1)
    field = clouds(rng, 128)
    inner = np.abs(np.diff(field, axis=1)).mean()
    assert np.abs(field[:, 0] - field[:, -1]).mean() < 2 * inner
    assert field.min() >= 0.0
    assert field.max() <= 1.0


@pytest.mark.parametrize("maker", [surfaces.wood, surfaces.planks, surfaces.tiles, surfaces.stone, surfaces.marble,
    surfaces.fabric, surfaces.carpet, surfaces.brushed_metal, surfaces.concrete, surfaces.plaster, surfaces.bricks,
    surfaces.speckled, surfaces.worn_metal, surfaces.cardboard, surfaces.pegboard])  # fmt: skip
def test_surfaces_are_seeded_pictures_with_a_size(maker, monkeypatch):
    monkeypatch.setattr(surfaces, "SIZE", 128)
    first, again, other = (maker(np.random.default_rng(seed)) for seed in (0, 0, 1))
    assert first.image.shape == (128, 128, 3)
    assert min(first.size) > 0.02
    np.testing.assert_array_equal(first.image, again.image)
    assert (first.image != other.image).any()
    assert 15 < first.image.mean() < 250
    assert first.image.std() > 0.8


def test_prints_have_the_proportions_of_what_they_are_on():
    rng = np.random.default_rng(0)
    for texture in (prints.page(rng), prints.cover(rng, 0.2, 0.28), prints.label(rng, 0.24, 0.08),
                    prints.screen(rng, 0.5, 0.28), prints.painting(rng, 0.6, 0.4), prints.spines(rng, 4, 0.12, 0.22)):  # fmt: skip
        rows, columns = texture.image.shape[:2]
        assert texture.image.std() > 4
        assert 0.2 < (columns / rows) / (texture.size[0] / texture.size[1]) < 5


@pytest.mark.parametrize("shape", [shapes.box(0.4, 0.3, 0.02), shapes.box(0.2, 0.1, 0.1, 0.03, 3), shapes.cylinder(0.1, 0.2),
    shapes.ball(0.1, 0.8), shapes.tube(np.array([[0, 0, 0], [0, 0, 0.1], [0.1, 0, 0.2]]), 0.01)])  # fmt: skip
def test_solids_are_closed_and_their_normals_look_outward(shape):
    import trimesh

    mesh = trimesh.Trimesh(shape.vertices.round(9), shape.faces)
    mesh.merge_vertices(merge_norm=True, merge_tex=True)
    mesh.update_faces(mesh.nondegenerate_faces())
    assert mesh.is_watertight
    assert mesh.volume > 0
    a, b, c = (shape.vertices[shape.faces[:, k]] for k in range(3))
    face_normals = np.cross(b - a, c - a)
    real = np.linalg.norm(face_normals, axis=1) > 1e-10
    shading = shape.normals[shape.faces].mean(axis=1)
    assert (np.einsum("ij,ij->i", face_normals, shading)[real] > 0).all()
    np.testing.assert_allclose(np.linalg.norm(shape.normals, axis=1), 1.0, atol=1e-9)


def test_turned_hulls_contain_the_body():
    from scipy.spatial import ConvexHull

    shape = shapes.turned([(0, 0), (0.05, 0), (0.08, 0.1), (0.02, 0.2), (0, 0.2)])
    equations = ConvexHull(shape.hulls[0]).equations
    assert (shape.vertices @ equations[:, :3].T + equations[:, 3]).max() < 1e-9
