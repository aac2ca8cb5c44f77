"""Symmetries that are found: those that shapes have by design, anywhere in the model frame, and no other."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from open3d.t.geometry import RaycastingScene

from pipeline.bop.models import diameter_of, read_model, read_models_info
from pipeline.exceptions import FormatError
from pipeline.geometry import inverse, transform_points
from pipeline.scene import Model
from pipeline.symmetry_search.search import SymmetrySearch, candidate_bound, find_symmetries

PARTS = Path(__file__).resolve().parent.parent.parent.parent / "assets" / "models"
OFFSET = np.array([0.01, -0.02, 0.005])
"""Where the middle of the shapes is in their model frame."""


def model_of(mesh: trimesh.Trimesh) -> Model:
    vertices = np.asarray(mesh.vertices, float) + OFFSET
    return Model(1, vertices, np.asarray(mesh.faces, np.int32), diameter_of(vertices))


def shape(name: str) -> trimesh.Trimesh:
    match name:
        case "box":
            return trimesh.creation.box((0.06, 0.04, 0.02))
        case "hexagon":
            return trimesh.creation.cylinder(0.03, 0.02, sections=6)
        case "sphere":
            return trimesh.creation.icosphere(3, 0.03)
    handle = trimesh.creation.box((0.01, 0.02, 0.03))
    handle.apply_translation((0.035, 0.015, 0.012))
    return trimesh.util.concatenate([shape("box"), handle])


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("hexagon", "D6: 6-fold and flips"),
        ("sphere", "sphere: any rotation"),
        ("box with a handle", "no symmetry"),
    ],
)
def test_the_suggested_set_is_that_of_the_shape(name: str, expected: str):
    model = model_of(shape(name))
    search = find_symmetries(model)
    assert search.group.name == expected
    check_suggested(search, model)
    assert all(candidate.distance <= candidate_bound(model.diameter) for candidate in search.candidates)


def check_suggested(search: SymmetrySearch, model: Model) -> None:
    """All suggested turns carry points of the surface onto the surface."""
    caster = RaycastingScene()
    caster.add_triangles(model.vertices.astype(np.float32), model.faces.astype(np.uint32))
    mesh = trimesh.Trimesh(model.vertices, model.faces, process=False)
    points = np.asarray(trimesh.sample.sample_surface(mesh, 300, seed=0)[0])
    for turn in search.group.turns():
        for moved in (transform_points(turn, points), transform_points(inverse(turn), points)):
            assert caster.compute_distance(moved.astype(np.float32)).numpy().max() <= search.epsilon + 1e-6


@pytest.mark.parametrize("obj_id", [1, 2])
def test_a_part_has_the_symmetries_that_it_was_designed_with(obj_id: int):
    designed = read_models_info(PARTS / "models_info.json")[obj_id]
    model = read_model(PARTS / f"obj_{obj_id:06d}.ply", obj_id, designed)
    found = find_symmetries(model).group
    listed = model.symmetries[1::40] if "symmetries_continuous" in designed else model.symmetries[1:]
    size = model.diameter / 2
    for turn in listed:
        nearest = min(
            np.abs(turn[:3, :3] - other[:3, :3]).max() + np.abs(turn[:3, 3] - other[:3, 3]).max() / size
            for other in found.turns(steps=315)
        )
        assert nearest < 0.03
    assert len(found.discrete) == len(designed.get("symmetries_discrete", ()))
    assert len(found.continuous) == len(designed.get("symmetries_continuous", ()))


def test_the_egg_box_of_lm_o_has_the_listed_symmetry(lmo: Path):
    folder = lmo / "models_eval"
    listed = read_models_info(folder / "models_info.json")[10]
    (turn,) = find_symmetries(read_model(folder / "obj_000010.ply", 10, listed)).group.discrete
    official = np.array(listed["symmetries_discrete"][0]).reshape(4, 4)
    apart = turn[:3, :3].T @ official[:3, :3]
    assert np.degrees(np.arccos((np.trace(apart) - 1) / 2)) < 4  # it was listed by eye, of a scan with dents


def test_the_bound_of_candidates_is_the_thesis_s():
    assert candidate_bound(0.1) == 0.015
    assert candidate_bound(0.3) == pytest.approx(0.03)


def test_progress_goes_up_to_the_end():
    shares: list[float] = []
    find_symmetries(model_of(shape("sphere")), progress=shares.append)
    assert shares == sorted(shares)
    assert 0 < shares[0] <= shares[-1] <= 1


def test_faces_without_area_are_refused():
    flat = Model(7, np.zeros((3, 3)), np.array([[0, 1, 2]], np.int32), 0.1)
    with pytest.raises(FormatError, match="object 7: the faces of its model have no area"):
        find_symmetries(flat)
