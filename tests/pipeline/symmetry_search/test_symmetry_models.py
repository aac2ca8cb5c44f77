"""Symmetries of real models: LM-O's listed ones and no other; a part that only nearly looks the same upside down."""

from pathlib import Path

import numpy as np
import pytest

from pipeline.bop.models import read_model, read_models_info
from pipeline.bop.models_info.symmetries import group_from
from pipeline.symmetry_search.groups import axis_of
from pipeline.symmetry_search.search import SymmetrySearch, find_symmetries

PARTS = Path(__file__).resolve().parent.parent.parent.parent / "assets" / "models"


def searched(folder: Path, obj_id: int) -> tuple[dict, SymmetrySearch]:
    info = read_models_info(folder / "models_info.json")[obj_id]
    return info, find_symmetries(read_model(folder / f"obj_{obj_id:06d}.ply", obj_id, info, appearance=False))


@pytest.mark.parametrize("obj_id", [3, 6])
def test_a_part_has_what_it_was_designed_with(obj_id: int):
    info, search = searched(PARTS, obj_id)
    designed = group_from(info)
    assert search.group.equals(designed, search.surface.extent)
    for turn in designed.discrete:  # plain numbers, not nearly plain ones
        assert min(np.abs(turn - found).max() for found in search.group.discrete) < 1e-9


def test_the_glue_of_lm_o_is_2_fold_as_listed(lmo: Path):
    info, search = searched(lmo / "models_eval", 11)
    assert search.group.name == "C2: 2-fold"
    listed, found = axis_of(group_from(info).discrete[0]), axis_of(search.group.discrete[0])
    assert np.degrees(np.arccos(listed.direction @ found.direction)) < 0.5
    assert listed.through == pytest.approx(found.through, abs=5e-4)
    assert search.candidates[0].distance < search.candidates[0].distance_at_axis < search.bound


def test_the_hole_punch_of_lm_o_has_a_candidate_and_no_symmetry(lmo: Path):
    _, search = searched(lmo / "models_eval", 12)
    assert [candidate.fold for candidate in search.candidates] == [2]
    assert search.candidates[0].distance > 0.07 * 0.1455
    assert search.group.name == "no symmetry"
