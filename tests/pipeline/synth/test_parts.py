"""The eight parts: the committed files are sound, symmetric exactly as declared, and what the code makes."""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.bop.models import read_model, read_models_info
from pipeline.scene import Model
from pipeline.symmetry import symmetry_transforms

MODELS = Path(__file__).parents[3] / "assets" / "models"
OBJ_IDS = range(1, 9)
SYMMETRIC = (1, 2, 3)
ASYMMETRIC = (4, 5, 6, 7, 8)


@cache
def model(obj_id: int) -> Model:
    info = read_models_info(MODELS / "models_info.json")[obj_id]
    return read_model(MODELS / f"obj_{obj_id:06d}.ply", obj_id, info)


@cache
def surface(obj_id: int):
    """The part's mesh and points on it (mm, vertices joined by position)."""
    import trimesh

    mesh = trimesh.Trimesh(model(obj_id).vertices * 1000.0, model(obj_id).faces, process=False)
    mesh.merge_vertices(merge_norm=True, merge_tex=True)
    return mesh, np.asarray(trimesh.sample.sample_surface_even(mesh, 4000, seed=1)[0])


def distance_mm(points: np.ndarray, obj_id: int) -> np.ndarray:
    """Distance of points from the surface of a part."""
    import open3d as o3d

    mesh, _ = surface(obj_id)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(np.asarray(mesh.vertices, np.float32)), o3d.core.Tensor(np.asarray(mesh.faces, np.uint32))
    )
    return scene.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy()


def asymmetry_mm(obj_id: int, rotation: np.ndarray) -> float:
    """Largest distance between a part and itself rotated about its origin, with the bounding boxes centred."""
    mesh, points = surface(obj_id)
    moved = np.concatenate([points, np.asarray(mesh.vertices)]) @ rotation.T
    moved -= (moved.max(axis=0) + moved.min(axis=0)) / 2
    return float(distance_mm(moved, obj_id).max())


@pytest.mark.parametrize("obj_id", OBJ_IDS)
def test_is_watertight_centred_and_of_the_declared_size(obj_id: int) -> None:
    mesh, _ = surface(obj_id)
    info = read_models_info(MODELS / "models_info.json")[obj_id]
    assert mesh.is_watertight
    assert mesh.is_winding_consistent
    assert mesh.volume > 0
    assert mesh.body_count == 1
    assert 3000 <= len(mesh.faces) <= 12500
    assert np.abs(mesh.bounds.sum(axis=0)).max() < 1e-3
    assert 40 <= max(mesh.extents) <= 150
    np.testing.assert_allclose(mesh.extents, [info[f"size_{axis}"] for axis in "xyz"], atol=1e-4)
    distances = np.linalg.norm(mesh.convex_hull.vertices[:, None] - mesh.convex_hull.vertices, axis=-1)
    assert distances.max() == pytest.approx(info["diameter"], abs=1e-4)


@pytest.mark.parametrize("obj_id", OBJ_IDS)
def test_has_unit_normals_outwards_and_plain_colours(obj_id: int) -> None:
    part = model(obj_id)
    assert part.normals is not None
    assert part.colors is not None
    np.testing.assert_allclose(np.linalg.norm(part.normals, axis=1), 1.0, atol=1e-5)
    a, b, c = (part.vertices[part.faces[:, k]] for k in range(3))
    flat = np.cross(b - a, c - a)
    agree = np.einsum("ij,ij->i", flat, part.normals[part.faces].mean(axis=1)) > 0
    assert np.average(agree, weights=np.linalg.norm(flat, axis=1)) > 0.999
    assert len(np.unique(part.colors, axis=0)) <= 5
    assert np.ptp(part.colors.astype(int), axis=1).max() <= 25  # gray, steel or ivory: no distinctive colour


@pytest.mark.parametrize("obj_id", SYMMETRIC)
def test_is_symmetric_as_declared(obj_id: int) -> None:
    declared = symmetry_transforms(read_models_info(MODELS / "models_info.json")[obj_id], max_step=0.2)
    assert len(declared) == {1: 16, 2: 2, 3: 4}[obj_id]
    assert max(asymmetry_mm(obj_id, turn[:3, :3]) for turn in declared) < 0.1


@pytest.mark.parametrize("obj_id", SYMMETRIC)
def test_symmetric_parts_have_no_further_symmetry(obj_id: int) -> None:
    declared = symmetry_transforms(read_models_info(MODELS / "models_info.json")[obj_id])[:, :3, :3]
    others = [R for R in candidates() if np.abs(declared - R).max(axis=(1, 2)).min() > 0.05]
    assert len(others) > 30
    assert min(asymmetry_mm(obj_id, R) for R in others) > 2.0


@pytest.mark.parametrize("obj_id", ASYMMETRIC)
def test_asymmetric_parts_have_no_symmetry(obj_id: int) -> None:
    info = read_models_info(MODELS / "models_info.json")[obj_id]
    assert not {"symmetries_discrete", "symmetries_continuous"} & info.keys()
    # Well above what a good pose is off by, so that a flipped pose is an error and not a matter of taste.
    assert min(asymmetry_mm(obj_id, R) for R in candidates()) > 5.0


def candidates() -> list[np.ndarray]:
    """The rotations of a cube, and turns about the axes by multiples of 15 degrees; without the identity."""
    turns = [Rotation.from_euler(axis, 15.0 * k, degrees=True) for axis in "xyz" for k in range(1, 24)]
    found = [*Rotation.create_group("O"), *turns]
    return [R.as_matrix() for R in found if R.magnitude() > 0.01]


def test_near_twins_differ_little() -> None:
    first, second = surface(6)[0], surface(7)[0]
    np.testing.assert_allclose(first.extents, second.extents, atol=3.0)
    assert first.volume == pytest.approx(second.volume, rel=0.04)
    shift = np.array([0, 0, (first.extents[2] - second.extents[2]) / 2])  # stand them on the same back
    distances = distance_mm(surface(6)[1] + shift, 7)
    assert np.median(distances) < 0.05
    assert 3.0 < distances.max() < 12.0


def test_composition_holds_both_parts() -> None:
    low, high = surface(8)[0].bounds
    half = {obj_id: surface(obj_id)[0].extents / 2 for obj_id in (4, 6)}
    # Both stand on the same back and end at the same length; each forms one side.
    centre_x = {4: low[0] + half[4][0], 6: high[0] - half[6][0]}
    for obj_id, x in centre_x.items():
        moved = surface(obj_id)[1] + (x, high[1] - half[obj_id][1], low[2] + half[obj_id][2])
        assert np.mean(distance_mm(moved, 8) < 0.1) > 0.7
    volumes = surface(6)[0].volume + surface(4)[0].volume
    assert surface(8)[0].volume == pytest.approx(volumes, rel=0.01)


@pytest.mark.parametrize("obj_id", [1, 5])
def test_code_makes_the_committed_files(obj_id: int) -> None:
    pytest.importorskip("manifold3d")
    from pipeline.synth.demo.parts import part_mesh

    made = part_mesh(obj_id)
    assert len(made.faces) == pytest.approx(len(model(obj_id).faces), rel=0.02)
    assert distance_mm(made.vertices_mm, obj_id).max() < 0.01


def test_demo_has_the_same_models() -> None:
    demo = MODELS.parent / "demo"
    for file in [*sorted(MODELS.glob("obj_*.ply")), MODELS / "models_info.json"]:
        assert (demo / "models" / file.name).read_bytes() == file.read_bytes()


def test_evaluation_models_are_watertight_as_they_are() -> None:
    import trimesh

    for obj_id in OBJ_IDS:
        mesh = trimesh.load(MODELS.parent / "demo" / "models_eval" / f"obj_{obj_id:06d}.ply")
        assert mesh.is_watertight
        assert mesh.volume == pytest.approx(surface(obj_id)[0].volume, rel=1e-5)
