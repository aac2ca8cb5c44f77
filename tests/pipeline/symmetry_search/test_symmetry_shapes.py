"""Symmetries of made shapes, turned and moved about: the right set, closed exactly, each axis with its distance."""

from itertools import pairwise

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from pipeline.bop.models import diameter_of
from pipeline.geometry import inverse, transform
from pipeline.scene import Model
from pipeline.symmetry_search.groups import Extent
from pipeline.symmetry_search.search import SymmetrySearch, candidate_bound, find_symmetries

MODEL_FROM_SHAPE = transform(Rotation.from_euler("xyz", [0.4, -0.9, 1.3]).as_matrix(), np.array([0.03, -0.02, 0.05]))
"""Shapes are designed about their own origin; their model frame is elsewhere."""


def prism(corners: int, radius: float = 0.03, height: float = 0.1) -> trimesh.Trimesh:
    return trimesh.creation.cylinder(radius, height, sections=corners)


def mug() -> trimesh.Trimesh:
    handle = trimesh.creation.torus(0.025, 0.006, 24, 12)
    handle.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, (1, 0, 0)))
    handle.apply_translation((0.045, 0.0, 0.012))
    return trimesh.util.concatenate([prism(48, 0.04, 0.09), handle])


SHAPES = {
    "cube": (trimesh.creation.box((0.06, 0.06, 0.06)), "O: cube", 23, 0),
    "box": (trimesh.creation.box((0.06, 0.04, 0.02)), "D2: three 2-fold axes", 3, 0),
    "almost square": (trimesh.creation.box((0.06, 0.053, 0.03)), "D2: three 2-fold axes", 3, 0),
    "cylinder": (prism(64), "D∞: continuous and flip", 1, 1),
    "pentagon": (prism(5), "D5: 5-fold and flips", 9, 0),
    "mug": (mug(), "no symmetry", 0, 0),
}
"""Mesh, the group's name, and how many turns and axes are listed."""


@pytest.fixture(scope="module")
def searched() -> dict[str, tuple[Model, SymmetrySearch]]:
    found = {}
    for name, (mesh, *_) in SHAPES.items():
        moved = mesh.copy()
        moved.apply_transform(MODEL_FROM_SHAPE)
        vertices = np.asarray(moved.vertices, float)
        model = Model(1, vertices, np.asarray(moved.faces, np.int32), diameter_of(vertices))
        found[name] = (model, find_symmetries(model))
    return found


@pytest.mark.parametrize("name", SHAPES)
def test_the_suggested_set_is_the_shape_s(searched, name: str):
    _, group_name, turns, axes = SHAPES[name]
    group = searched[name][1].group
    assert group.name == group_name
    assert (len(group.discrete), len(group.continuous)) == (turns, axes)


@pytest.mark.parametrize("name", SHAPES)
def test_the_axes_are_where_they_were_designed(searched, name: str):
    """In the shape's own frame every turn keeps the origin and is one of a signed permutation or about z."""
    for turn in searched[name][1].group.turns():
        own = inverse(MODEL_FROM_SHAPE) @ turn @ MODEL_FROM_SHAPE
        assert np.abs(own[:3, 3]).max() < 2e-5
        if name in ("cube", "box", "almost square"):
            assert np.abs(own[:3, :3] - np.round(own[:3, :3])).max() < 5e-4
        else:
            assert abs(abs(own[2, 2]) - 1) < 1e-6


@pytest.mark.parametrize("name", ["cube", "box", "pentagon"])
def test_the_set_is_closed_to_the_last_digits(searched, name: str):
    elements = [np.eye(4), *searched[name][1].group.discrete]
    for first in elements:
        for second in elements:
            product = first @ second
            assert min(np.abs(product - element).max() for element in elements) < 1e-9


def test_a_turn_of_few_faces_is_measured_between_their_vertices(searched):
    """An almost square box of eight vertices, turned by 90 degrees: its long sides stand out by half the difference."""
    quarter = [c for c in searched["almost square"][1].candidates if c.fold == 4]
    assert quarter[0].distance == pytest.approx(0.0035, abs=2e-5)


def test_candidates_lie_below_the_bound_the_best_first(searched):
    for model, search in searched.values():
        distances = [candidate.distance for candidate in search.candidates]
        assert all(distance < candidate_bound(model.diameter) for distance in distances)
        level = 0.002 * model.diameter  # below that all fit equally well
        assert all(a <= max(b, level) for a, b in pairwise(distances))


def test_a_prism_is_no_cylinder_although_turning_it_freely_is_a_candidate(searched):
    candidates = searched["pentagon"][1].candidates
    free = next(candidate for candidate in candidates if candidate.kind == "continuous")
    assert free.distance == pytest.approx(0.03 * (1 - np.cos(np.pi / 5)), rel=0.03)
    assert "continuous" not in {candidates[i].kind for i in searched["pentagon"][1].suggested}


def test_a_cylinder_s_flips_are_one_candidate(searched):
    search = searched["cylinder"][1]
    assert sorted(candidate.kind for candidate in search.candidates) == ["continuous", "discrete"]


def test_the_distance_of_any_motion_can_be_asked_for(searched):
    shift = np.eye(4)
    shift[0, 3] = 0.002
    model, search = searched["box"]
    assert search.distance(shift) <= 0.002 + 1e-7
    assert search.distance(shift) > 0.001
    assert isinstance(search.surface.extent, Extent)
    assert search.surface.extent.radius == pytest.approx(model.diameter / 2, rel=1e-6)
