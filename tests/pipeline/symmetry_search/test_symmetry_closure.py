"""Sets of accepted symmetries: closed, exact, or refused in words."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.symmetry_search.closure import NoGroupError, group_of
from pipeline.symmetry_search.groups import NO_SYMMETRY, Axis, Candidate, Extent, SymmetryGroup, axis_of

EXTENT = Extent(np.array([0.01, 0.0, 0.02]), 0.05)


def candidate(fold: int, direction: tuple[float, float, float], through: np.ndarray = EXTENT.center) -> Candidate:
    unit = np.array(direction, float) / np.linalg.norm(direction)
    kind = "discrete" if fold else "continuous"
    return Candidate(kind, fold, Axis(unit, through - unit * (unit @ through)), 0.001, 0.001, 0.0005)


def tilted(fold: int, direction: tuple[float, float, float], degrees: float) -> Candidate:
    """As from a scan: a little tilted, and a little beside the centre."""
    off = Rotation.from_rotvec(np.radians(degrees) * np.array([0.5, -0.7, 0.5])).apply(direction)
    return candidate(fold, tuple(off), EXTENT.center + np.array([0.0005, -0.0004, 0.0003]))


def is_closed(group: SymmetryGroup) -> bool:
    elements = [np.eye(4), *group.discrete]
    return all(min(np.abs(a @ b - c).max() for c in elements) < 1e-12 for a in elements for b in elements)


def test_a_fold_brings_all_its_turns():
    group = group_of([candidate(6, (0, 0, 1))], EXTENT)
    assert group.name == "C6: 6-fold"
    angles = sorted(np.degrees(Rotation.from_matrix(group.discrete[:, :3, :3]).magnitude()))
    assert angles == pytest.approx([60, 60, 120, 120, 180])


@pytest.mark.parametrize(
    ("candidates", "name", "turns"),
    [
        ([tilted(2, (1, 0, 0), 2), tilted(2, (0, 1, 0), -2)], "D2: three 2-fold axes", 3),
        ([tilted(4, (0, 0, 1), 1), tilted(2, (1, 0, 0), -2)], "D4: 4-fold and flips", 7),
        ([tilted(3, (1, 1, 1), 1), tilted(2, (0, 0, 1), -1)], "T: tetrahedron", 11),
        ([tilted(4, (0, 0, 1), 1), tilted(3, (1, 1, 1), -1)], "O: cube", 23),
        ([tilted(5, (0, 1, (1 + 5**0.5) / 2), 1), tilted(3, (1, 1, 1), 0)], "I: icosahedron", 59),
    ],
)
def test_generators_that_nearly_fit_give_an_exact_group(candidates: list[Candidate], name: str, turns: int):
    group = group_of(candidates, EXTENT)
    assert (group.name, len(group.discrete)) == (name, turns)
    assert is_closed(group)
    for one in candidates:
        nearest = min(np.linalg.norm(np.cross(axis_of(t).direction, one.axis.direction)) for t in group.discrete)
        assert nearest < np.sin(np.radians(4))


def test_a_flip_is_brought_to_right_angles_with_the_continuous_axis():
    group = group_of([candidate(0, (0, 0, 1)), tilted(2, (1, 0.3, 0), 3)], EXTENT)
    assert group.name == "D∞: continuous and flip"
    (flip,) = group.discrete
    assert flip[:3, :3] @ group.continuous[0].direction == pytest.approx([0, 0, -1], abs=1e-12)


def test_turns_about_the_continuous_axis_are_not_listed():
    group = group_of([candidate(0, (0, 0, 1)), candidate(6, (0, 0, 1))], EXTENT)
    assert group.name == "C∞: continuous"
    assert group.contains(candidate(7, (0, 0, 1)).turns()[2], EXTENT)
    assert not group.contains(candidate(2, (1, 0, 0)).turns()[0], EXTENT)


def test_nothing_accepted_is_no_symmetry():
    assert group_of([], EXTENT) is NO_SYMMETRY


@pytest.mark.parametrize(
    ("candidates", "message"),
    [
        ([candidate(0, (0, 0, 1)), candidate(0, (1, 0, 0))], "with two continuous axes every rotation"),
        ([candidate(0, (0, 0, 1)), candidate(3, (1, 0, 0))], "a 3-fold axis across it every rotation"),
        ([candidate(5, (0, 0, 1)), candidate(4, (1, 0, 0))], "5-fold, 4-fold do not close; refuse one of them"),
        (
            [candidate(2, (0, 0, 1)), candidate(2, (0, 0, 1), EXTENT.center + np.array([0.02, 0, 0]))],
            "the axes miss each other by too much",
        ),
    ],
)
def test_what_cannot_be_together_is_refused(candidates: list[Candidate], message: str):
    with pytest.raises(NoGroupError, match=message):
        group_of(candidates, EXTENT)


def test_sets_are_equal_if_their_turns_are():
    flip, other = candidate(2, (1, 0, 0)), candidate(2, (0.6, 0.8, 0))
    first = group_of([candidate(0, (0, 0, 1)), flip], EXTENT)
    second = group_of([candidate(0, (0, 0, -1)), other], EXTENT)  # another flip about the same axis
    assert first.equals(second, EXTENT)
    assert not first.equals(group_of([flip], EXTENT), EXTENT)
