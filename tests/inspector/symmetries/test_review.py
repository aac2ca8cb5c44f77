"""What is decided about symmetries: taken, taken back, closed to a set, and written without harm to anything else."""

import json
from pathlib import Path

import numpy as np
import pytest
from tiny_dataset import box, make_dataset

from inspector.symmetries.review import Review
from inspector.symmetries.texts import heading, list_of_candidates
from pipeline.bop.models import read_model, read_models_info
from pipeline.bop.symmetry_files import model_paths, read_models, symmetry_entry, write_symmetries
from pipeline.exceptions import FormatError, MissingFileError
from pipeline.symmetry import symmetry_transforms
from pipeline.symmetry_search.groups import NO_SYMMETRY, Axis, Candidate, SymmetryGroup
from pipeline.symmetry_search.search import SymmetrySearch
from pipeline.symmetry_search.surface import Surface


def candidate(direction: tuple[float, float, float], distance: float, fold: int = 2) -> Candidate:
    kind = "discrete" if fold else "continuous"
    axis = Axis(np.array(direction), np.zeros(3))
    return Candidate(kind, fold, axis, distance, distance, distance)


def search(*candidates: Candidate, suggested: tuple[int, ...] = (0,)) -> SymmetrySearch:
    """What a search could say of the first box."""
    return SymmetrySearch(candidates, suggested, NO_SYMMETRY, 0.001, 0.015, Surface.of(box(1)), 0.5)


HALF_X, HALF_Y, HALF_Z = candidate((1, 0, 0), 0.0), candidate((0, 1, 0), 0.0), candidate((0, 0, 1), 0.002)
ROUND_Z, ROUND_X = candidate((0, 0, 1), 0.004, fold=0), candidate((1, 0, 0), 0.005, fold=0)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return make_dataset(tmp_path / "tiny") / "models"


@pytest.fixture
def review(folder: Path) -> Review:
    made = Review(folder, read_models(model_paths(folder)))
    made.add(1, search(HALF_X, HALF_Y, HALF_Z, ROUND_Z, ROUND_X, suggested=(0, 1)), 0.5)
    return made


def decided(review: Review) -> list[str]:
    return [review.decision(1, i) for i in range(len(review.candidates(1)))]


def test_accepting_and_refusing_goes_on_to_the_next_open_candidate(review: Review):
    review.decide("accepted")
    review.decide("refused")
    assert decided(review)[:3] == ["accepted", "refused", "open"]
    assert review.state.position == 2
    assert review.group(1).name == "C2: 2-fold"


def test_the_accepted_ones_are_closed_to_a_group(review: Review):
    review.decide("accepted")
    review.decide("accepted")
    assert len(review.group(1).discrete) == 3
    assert "D2: three 2-fold axes" in heading(review)


def test_what_cannot_be_a_symmetry_beside_the_others_is_not_taken(review: Review):
    for position in (3, 4):
        review.look_at(1, position)
        review.decide("accepted")
    assert decided(review) == ["open", "open", "open", "accepted", "open"]
    assert "not accepted: with two continuous axes every rotation would be a symmetry" in heading(review)


def test_all_can_be_decided_as_suggested_and_taken_back_at_once(review: Review):
    review.decide_as_suggested()
    assert decided(review) == ["accepted", "accepted", "refused", "refused", "refused"]
    review.undo()
    assert decided(review) == ["open"] * 5
    review.undo()
    assert decided(review) == ["open"] * 5


def test_steps_go_around(review: Review):
    review.step(-1)
    assert review.state.position == 4
    review.step(1)
    assert review.state.position == 0
    review.step_object(1)
    assert review.state.obj_id == 2
    assert "searching" in heading(review)
    assert review.candidate is None
    review.step_object(1)
    assert review.state.obj_id == 1


def test_saving_writes_decided_objects_only_and_keeps_the_earlier_file(review: Review, folder: Path):
    info = folder / "models_info.json"
    before = info.read_bytes()
    content = json.loads(before)
    review.decide("accepted")
    assert review.unsaved
    review.save()
    assert not review.unsaved
    after = json.loads(info.read_bytes())
    assert after["2"] == content["2"]
    assert {k: v for k, v in after["1"].items() if k != "symmetries_discrete"} == {
        k: v for k, v in content["1"].items() if k not in ("symmetries_discrete", "symmetries_continuous")
    }
    assert (folder / "models_info.json.bak1").read_bytes() == before
    turns = symmetry_transforms(after["1"])
    np.testing.assert_allclose(turns, [np.eye(4), np.diag([1.0, -1, -1, 1])], atol=1e-9)
    assert "models_info.json.bak1" in heading(review)


def test_refusing_everything_removes_what_was_listed(review: Review, folder: Path):
    review.add(2, search(HALF_Z), 1.0)
    review.look_at(2)
    review.decide("refused")
    review.save()
    assert "symmetries_discrete" not in read_models_info(folder / "models_info.json")[2]


def test_a_file_that_cannot_be_written_is_told_and_nothing_is_lost(review: Review, folder: Path):
    (folder / "models_info.json").write_text("{")
    review.decide("accepted")
    review.save()
    assert review.unsaved
    assert "is no complete JSON" in heading(review)
    assert (folder / "models_info.json").read_text() == "{"


def test_an_absent_file_is_made_with_the_sizes_of_all_models(folder: Path):
    (folder / "models_info.json").unlink()
    models = read_models(model_paths(folder))
    group = SymmetryGroup(np.empty((0, 4, 4)), (Axis(np.array([0, 0, 1.0]), np.array([0.001, 0.002, 0])),))
    assert write_symmetries(folder, {1: group}, models) is None
    found = read_models_info(folder / "models_info.json")
    assert found[1]["symmetries_continuous"] == [{"axis": [0.0, 0.0, 1.0], "offset": [1.0, 2.0, 0.0]}]
    assert found[2]["size_x"] == pytest.approx(40)
    assert found[2]["min_z"] == pytest.approx(-10)
    assert read_model(folder / "obj_000001.ply", 1, found[1]).symmetries.shape == (315, 4, 4)


def test_the_list_says_what_was_decided_and_what_is_suggested(review: Review):
    review.decide("accepted")
    page = list_of_candidates(review)
    assert page.count("suggested") == 2
    assert page.count("✓") == 1
    assert "2.00 mm" in page
    assert "continuous" in page


def test_an_object_that_cannot_be_searched_says_why(review: Review):
    review.add(2, FormatError("object 2: <b> no area"), 1.0)
    review.look_at(2)
    assert "object 2: &lt;b&gt; no area" in heading(review)


def test_no_symmetries_are_no_keys():
    assert symmetry_entry(NO_SYMMETRY) == {}


def test_a_folder_without_models_is_refused(tmp_path: Path):
    with pytest.raises(
        MissingFileError, match=r"has no models \(obj_000001.ply, ...\); give a dataset's models folder"
    ):
        model_paths(tmp_path)
