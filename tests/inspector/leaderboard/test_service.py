"""What browsers share of the leaderboard: served methods are taken in, other datasets are found, properties are read."""

import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from tiny_dataset import FIRST, claim, make_dataset, perfect, pose, results_of

from inspector.leaderboard.dialogs import properties_of
from inspector.leaderboard.rows import table
from inspector.leaderboard.service import LeaderboardService
from inspector.opening import open_workspace
from inspector.workspace import Method, Workspace
from inspector.workspaces import Workspaces
from pipeline.bop.dataset import open_dataset
from pipeline.bop.evaluation.evaluate import evaluate
from pipeline.bop.results import read_results, write_results
from pipeline.exceptions import InputError

PATIENCE = 30.0


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return make_dataset(tmp_path / "data" / "tiny")


@pytest.fixture
def written(tmp_path: Path) -> Callable[..., Path]:
    def write(results, dataset: str = "tiny") -> Path:
        path = tmp_path / f"{results.method}_{dataset}-test.csv"
        write_results(path, results)
        return path

    return write


@pytest.fixture
def service(tmp_path: Path) -> Iterator[LeaderboardService]:
    made = LeaderboardService(tmp_path / "leaderboard")
    yield made
    made.stop()


def evaluated(service: LeaderboardService, workspace: Workspace) -> dict:
    """The table after all that is served has been evaluated."""
    service.opened(workspace)
    for thread in threading.enumerate():
        if thread.name == "leaderboard":
            thread.join(PATIENCE)
    assert service.queue.wait_idle(PATIENCE)
    return table(service, workspace)


def test_served_methods_are_evaluated_when_somebody_looks(service, root, written):
    wrong = results_of(claim(FIRST, 1, pose(0, 0, 0.4)), method="wrong")
    paths = (written(perfect()), written(wrong))
    page = evaluated(service, open_workspace(root, paths))
    assert page["here"] == "tiny/test"
    assert [row["name"] for row in page["rows"]] == ["perfect", "wrong"]
    cell = page["rows"][0]["cells"]["tiny/test"]
    scores = evaluate(open_dataset(root), read_results(paths[0])).scores
    assert cell["scores"] == {"average": scores.average, **scores._asdict()}
    assert (cell["targets"], cell["job"], cell["failure"]) == (4, None, "")


def test_what_was_evaluated_is_there_at_the_next_start_without_any_work(service, root, written, tmp_path):
    workspace = open_workspace(root, (written(perfect()),))
    before = evaluated(service, workspace)
    service.stop()
    again = LeaderboardService(tmp_path / "leaderboard")
    try:
        assert table(again, open_workspace(root)) == before
        assert again.queue.jobs() == ()
    finally:
        again.stop()


def test_a_served_method_is_known_by_its_submission(service, root, written):
    workspace = open_workspace(root, (written(perfect()),))
    submission = evaluated(service, workspace)["rows"][0]["submission"]
    assert service.submission_of(0, workspace) == submission
    assert service.method_of(submission, workspace) == 0
    assert service.submission_of(None, workspace) is None


def test_a_submission_that_is_not_served_is_opened_as_one_more_method(service, root, written):
    path = written(perfect())
    added = service.store.add(path, method="other", dataset_name="tiny", split="test").submission
    workspace = open_workspace(root)
    assert workspace.method_names == ()
    assert service.method_of(added.id, workspace) == 0
    assert service.method_of(added.id, workspace) == 0
    assert workspace.method_names == ("other",)


def test_a_failed_evaluation_says_why(service, root, written):
    elsewhere = results_of(claim(FIRST._replace(scene_id=9), 1, pose(0, 0, 0.4)), method="elsewhere")
    page = evaluated(service, open_workspace(root, (written(elsewhere),)))
    cell = page["rows"][0]["cells"]["tiny/test"]
    assert cell["scores"] is None
    assert "none of the 1 estimates is for a target of tiny/test" in cell["failure"]


def test_a_dataset_that_nobody_has_evaluated_on_is_a_column_all_the_same(service, root):
    page = table(service, open_workspace(root))
    assert [column["key"] for column in page["datasets"]] == ["tiny/test"]
    assert page["rows"] == []


def test_a_method_opened_later_is_assessed_and_opened_once(root, written):
    path = written(perfect())
    workspace = open_workspace(root)
    method = Method("perfect", read_results(path), path)
    assert [workspace.add_method(method), workspace.add_method(method)] == [0, 0]
    other = Method("second", perfect(), path.with_name("second.csv"))
    assert workspace.add_method(other) == 1
    assert workspace.method_names == ("perfect", "second")


def test_a_dataset_beside_the_open_one_is_opened_when_asked_for(root, tmp_path):
    make_dataset(tmp_path / "data" / "other")
    workspaces = Workspaces(open_workspace(root))
    try:
        assert workspaces.of("tiny", "test") is workspaces.first
        other = workspaces.of("other", "test")
        assert other.dataset.root == tmp_path / "data" / "other"
        assert workspaces.of("other", "test") is other
    finally:
        workspaces.stop()


@pytest.mark.parametrize("name", ["absent", "..", "../data/tiny", "", ".", "/"])
def test_what_is_no_dataset_beside_the_open_one_is_refused(root, name):
    workspaces = Workspaces(open_workspace(root))
    with pytest.raises(InputError, match="no such folder in"):
        workspaces.of(name, "test")


def test_properties_are_lines_with_a_colon():
    assert properties_of("image type: RGB\n\n GPU : A100: two ") == {"image type": "RGB", "GPU": "A100: two"}
    with pytest.raises(InputError, match="property 'RGB': has no name; write it as  name: value"):
        properties_of("RGB")


def test_a_damaged_leaderboard_hinders_nothing_else(root, written, tmp_path):
    folder = tmp_path / "damaged"
    folder.mkdir()
    (folder / "leaderboard.sqlite").write_bytes(b"no database at all" * 500)
    service = LeaderboardService(folder)
    with pytest.raises(InputError, match=r"leaderboard\.sqlite: is damaged"):
        service.opened(open_workspace(root, (written(perfect()),)))
    service.stop()
