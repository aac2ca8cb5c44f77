"""Accepting and refusing: closure, contradictions, undo, and saving to models_info.json."""

import json
import threading
from pathlib import Path

import numpy as np
import pytest
from tiny_dataset import HALF_TURN, box, make_dataset

from inspector.symmetries.review import Review
from inspector.symmetries.searching import BackgroundSearch
from inspector.symmetries.verdicts import Decision
from pipeline.bop.models_info.model_set import open_models
from pipeline.exceptions import FormatError, InputError
from pipeline.scene import Model
from pipeline.symmetry_search.closure import group_of
from pipeline.symmetry_search.groups import NO_SYMMETRY, Axis, Candidate
from pipeline.symmetry_search.search import SymmetrySearch
from pipeline.symmetry_search.surface import Surface

X, Y, Z = np.eye(3)
DIAGONAL = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
AXES = ((4, Z), (2, X), (2, Y), (2, DIAGONAL), (3, Z))
"""Of a square box, which has no 3-fold one: it stands for a candidate above epsilon."""


@pytest.fixture(scope="module")
def surface() -> Surface:
    return Surface.of(box(2))


def search_of(surface: Surface) -> SymmetrySearch:
    candidates = tuple(
        Candidate("discrete", fold, Axis(direction, np.zeros(3)), 1e-6 if fold != 3 else 0.006, 1e-6, 1e-6)
        for fold, direction in AXES
    )
    group = group_of([candidates[0], candidates[1]], surface.extent)
    return SymmetrySearch(candidates, (0, 1), group, 0.001, 0.015, surface, 0.1)


@pytest.fixture
def review(tmp_path: Path, surface: Surface, monkeypatch: pytest.MonkeyPatch) -> Review:
    """Of the tiny dataset, searched; box 2 is listed with a half turn about z."""

    def find(model: Model, *_: object, **__: object) -> SymmetrySearch:
        if model.obj_id == 3:
            raise FormatError("object 3: the faces of its model have no area; export the mesh again")
        return search_of(surface)

    monkeypatch.setattr("inspector.symmetries.searching.find_symmetries", find)
    models = make_dataset(tmp_path / "tiny") / "models"
    (models / "obj_000003.ply").write_bytes((models / "obj_000001.ply").read_bytes())
    return searched(Review(open_models(models)))


def searched(review: Review) -> Review:
    done = threading.Event()
    review.listen(lambda: done.set() if all(r.progress in ("found", "failed") for r in review.objects) else None)
    BackgroundSearch(review).start()
    assert done.wait(20)
    return review


def entry(review: Review, obj_id: int) -> dict:
    assert review.models.info_path is not None
    return json.loads(review.models.info_path.read_text())[str(obj_id)]


def test_accepting_a_4_fold_axis_accepts_its_powers(review: Review):
    review.accept()
    assert review.current.group.name == "C4: 4-fold"
    assert len(review.current.group.discrete) == 3
    assert review.current.standings == ("accepted", "open", "open", "open", "open")
    assert review.selected == (0, 1)  # on to the next open one


def test_products_of_what_is_accepted_follow(review: Review):
    review.accept()
    review.accept()
    assert review.current.group.name == "D4: 4-fold and flips"
    assert review.current.standings == ("accepted", "accepted", "follows", "follows", "open")
    assert review.selected == (0, 4)


def test_what_follows_cannot_be_refused(review: Review):
    review.accept_suggested()
    review.select(2)
    review.refuse()
    assert review.current.standings[2] == "follows"
    assert review.message == ("candidate 3 (2-fold) is refused, but follows from those accepted", "warning")
    review.select(1)
    review.refuse()
    assert review.current.standings[:3] == ("accepted", "refused", "open")


def test_what_cannot_be_together_is_told_and_left(review: Review):
    review.select(4)
    review.accept()
    review.select(3)
    review.accept()
    review.select(0)
    review.accept()  # 3-fold and 4-fold about one axis make it 12-fold
    assert review.current.group.name == "D12: 12-fold and flips"
    review.select(1)
    review.refuse()
    assert review.message[1] == "warning"


def test_a_candidate_that_cannot_be_beside_those_accepted_is_not_taken(review: Review, surface: Surface):
    across = [Candidate("continuous", 0, Axis(direction, np.zeros(3)), 0.004, 0.004, 0.002) for direction in (X, Z)]
    found = SymmetrySearch(tuple(across), (), NO_SYMMETRY, 0.001, 0.015, surface, 0.1)
    review.found(0, box(1), found)
    review.accept()
    review.accept()
    assert review.current.standings == ("accepted", "open")
    assert "with two continuous axes every rotation would be a symmetry" in review.message[0]
    assert review.message[1] == "warning"


def test_steps_go_around(review: Review):
    review.step(-1)
    assert review.selected == (0, 4)
    review.step(1)
    assert review.selected == (0, 0)
    review.step_object(-1)
    assert review.selected == (2, 0)
    review.step(1)  # it has no candidates
    assert review.candidate is None
    review.step_object(1)
    assert review.selected == (0, 0)


def test_undo_goes_back_decision_by_decision_to_the_object_of_each(review: Review):
    review.accept()
    review.step_object(1)
    review.accept_suggested()
    review.undo()
    assert review.objects[1].verdicts == review.objects[1].first_verdicts
    review.step_object(1)
    review.undo()
    assert review.selected[0] == 0
    assert review.current.verdicts == {}
    review.undo()
    assert review.message[0] == "nothing to undo"


def test_what_the_file_lists_counts_as_accepted_also_if_it_is_a_part_of_a_candidate(review: Review):
    half = review.objects[1]
    assert half.listed.discrete[0] == pytest.approx(HALF_TURN)
    assert half.verdicts == {0: Decision("accepted", 2)}
    assert (half.group.name, half.as_listed, half.unsaved, half.problem) == ("C2: 2-fold", True, False, "")
    review.step_object(1)
    review.accept_suggested()
    review.save()
    again = searched(Review(review.models)).objects[1]
    assert (again.group.name, again.as_listed, again.problem) == ("D4: 4-fold and flips", True, "")
    assert not again.unsaved


def test_what_the_file_lists_and_nobody_finds_is_told(review: Review):
    path = review.models.info_path
    assert path is not None
    turn = [0, -1, 0, 30, 1, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]  # about an axis beside the box
    path.write_text(json.dumps({"1": {"diameter": 75.0, "symmetries_discrete": [turn]}}))
    told = searched(Review(review.models)).objects[0]
    assert told.problem == "models_info.json lists symmetries that are no candidates here"
    assert (told.verdicts, told.unsaved) == ({}, False)


def test_a_part_of_the_turns_can_be_accepted_where_colours_forbid_the_others(review: Review):
    review.choose_fold(2)
    assert review.candidate is not None
    assert (review.candidate.fold, review.current.standings[0]) == (2, "open")
    review.accept()
    assert review.current.group.name == "C2: 2-fold"
    review.select(0)
    review.step_fold(-1)
    assert review.current.group.name == "C4: 4-fold"
    review.undo()
    assert review.current.group.name == "C2: 2-fold"
    review.choose_fold(3)  # no part of a 4-fold axis
    assert review.current.group.name == "C2: 2-fold"
    review.save()
    assert len(entry(review, 1)["symmetries_discrete"]) == 1


def test_saving_writes_what_was_decided_and_nothing_else(review: Review):
    path = review.models.info_path
    assert path is not None
    before = path.read_bytes()
    other = entry(review, 2)
    review.accept()
    assert [r.file.obj_id for r in review.unsaved] == [1]
    written = review.save()
    assert written is not None
    assert len(entry(review, 1)["symmetries_discrete"]) == 3
    assert entry(review, 2) == other
    assert path.with_name("models_info.json.bak").read_bytes() == before
    assert review.unsaved == ()
    assert review.message == ("saved 1 object to models_info.json; before: models_info.json.bak", "saved")


def test_where_evaluation_reads_another_file_saving_says_so(review: Review):
    path = review.models.info_path
    assert path is not None
    first = path.parent.with_name("models_eval") / path.name
    first.parent.mkdir()
    first.write_bytes(path.read_bytes())
    review.accept()
    review.save()
    assert review.message[0].endswith("; but evaluation reads models_eval/models_info.json")


def test_a_second_save_of_one_s_own_makes_no_second_copy_but_another_s_does(review: Review):
    path = review.models.info_path
    assert path is not None
    review.accept()
    review.save()
    review.accept()
    review.save()
    assert not path.with_name("models_info.json.bak2").exists()
    path.write_text(path.read_text().replace("{", "{ ", 1))
    review.undo()
    review.save()
    assert path.with_name("models_info.json.bak2").exists()
    assert len(entry(review, 1)["symmetries_discrete"]) == 3


def test_taking_everything_back_removes_it_from_the_file(review: Review):
    review.accept()
    review.save()
    review.undo()
    assert [r.file.obj_id for r in review.unsaved] == [1]
    review.save()
    assert "symmetries_discrete" not in entry(review, 1)


def test_without_a_file_one_is_made_with_all_models(review: Review):
    path = review.models.info_path
    assert path is not None
    path.unlink()
    fresh = searched(Review(review.models))
    fresh.accept()
    fresh.save()
    assert entry(fresh, 1)["size_x"] == 60
    assert len(entry(fresh, 1)["symmetries_discrete"]) == 3
    assert set(json.loads(path.read_text())) == {"1", "2", "3"}
    assert "symmetries_discrete" not in entry(fresh, 2)


def test_an_object_that_another_program_took_out_of_the_file_comes_back_with_its_size(review: Review):
    path = review.models.info_path
    assert path is not None
    review.accept()
    path.write_text(json.dumps({"2": entry(review, 2)}))
    review.save()
    assert entry(review, 1)["size_x"] == 60
    assert len(entry(review, 1)["symmetries_discrete"]) == 3


def test_a_model_that_cannot_be_searched_hinders_no_other(review: Review):
    failed = review.objects[2]
    assert failed.progress == "failed"
    assert "the faces of its model have no area" in failed.problem
    review.select_object(2)
    assert review.candidate is None
    review.accept()
    review.accept_all_suggested()
    names = [r.group.name for r in review.objects]
    assert names == ["D4: 4-fold and flips", "C2: 2-fold", "no symmetry"]  # the file has decided the second


def test_a_mesh_without_an_id_cannot_be_saved(review: Review):
    path = review.models.path / "part.ply"
    path.write_bytes((review.models.path / "obj_000001.ply").read_bytes())
    alone = searched(Review(open_models(path)))
    alone.accept()
    with pytest.raises(InputError, match=r"part\.ply: is not named obj_ID\.ply; rename it, or use --json FILE"):
        alone.save()


def test_a_damaged_models_info_is_told_at_the_start(tmp_path: Path):
    models = make_dataset(tmp_path / "tiny") / "models"
    (models / "models_info.json").write_text('{"1": 3}')
    with pytest.raises(FormatError, match="entry '1' is not an object by its id"):
        Review(open_models(models))
