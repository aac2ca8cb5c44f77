"""The leaderboard's store: what is kept, what comes back, and the table of it."""

import contextlib
import json
import os
import shutil
import sqlite3
import timeit
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from pipeline.bop.dataset import open_dataset
from pipeline.bop.evaluation.evaluate import Evaluation, evaluate
from pipeline.bop.evaluation.fingerprint import fingerprint
from pipeline.bop.evaluation.scores import FoundInstances
from pipeline.bop.leaderboard import database as leaderboard_database
from pipeline.bop.leaderboard import store as leaderboard_module
from pipeline.bop.leaderboard import table as leaderboard_table
from pipeline.bop.leaderboard.database import Database
from pipeline.bop.leaderboard.records import Submission, packed, unpacked
from pipeline.bop.leaderboard.store import Leaderboard, default_folder
from pipeline.bop.leaderboard.table import AR_CORE, CORE_DATASETS, Column
from pipeline.bop.results import read_results, write_results
from pipeline.exceptions import FormatError, InputError, MissingFileError, UnknownIdError
from tests.tiny_dataset import ANNOTATED, FIRST, SECOND, claim, make_dataset, moved, perfect, results_of

ROW = "1,0,1,0.5,1 0 0 0 1 0 0 0 1,0 0 400,0.25\n"
FILE = f"scene_id,im_id,obj_id,score,R,t,time\n{ROW}".encode()


@pytest.fixture
def board(tmp_path: Path) -> Leaderboard:
    return Leaderboard(tmp_path / "leaderboard")


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_dataset(tmp_path_factory.mktemp("data") / "tiny")


@pytest.fixture
def own(tiny: Path, tmp_path: Path) -> Path:
    """A copy of the tiny dataset to change."""
    return shutil.copytree(tiny, tmp_path / "tiny")


def add(
    board: Leaderboard,
    content: bytes | Path = FILE,
    method: str = "m",
    dataset_name: str = "tiny",
    split: str = "test",
    **about: Any,
) -> Submission:
    return board.add(content, method=method, dataset_name=dataset_name, split=split, **about).submission


def found_instances(count: int, *, seed: int = 0, with_vsd: bool = True, rate: float = 0.5) -> FoundInstances:
    rng = np.random.default_rng(seed)
    ids = rng.integers(1, 8, (4, count))
    fractions = rng.random(count)
    fractions[::3] = np.nan
    return FoundInstances(
        *ids,
        visible_fraction=fractions,
        mssd=rng.random((count, 10)) < rate,
        mspd=rng.random((count, 10)) < rate,
        vsd=rng.random((count, 10, 10)) < rate if with_vsd else None,
    )


def evaluation_of(submission: Submission, count: int = 7, why_no_vsd: str = "", **instances) -> Evaluation:
    found = found_instances(count, with_vsd=not why_no_vsd, **instances)
    return Evaluation(submission.dataset_name, submission.method, found, why_no_vsd, seconds=0.5)


def same(a: FoundInstances, b: FoundInstances) -> bool:
    """Whether all arrays are the same to the last bit."""

    def bits(instances: FoundInstances) -> list[tuple | None]:
        arrays = [getattr(instances, field.name) for field in fields(FoundInstances)]
        return [None if x is None else (x.dtype, x.shape, x.tobytes()) for x in arrays]

    return bits(a) == bits(b)


def kept_files(board: Leaderboard) -> list[str]:
    return sorted(path.name for path in (board.folder / "files").iterdir())


# ---- submissions


def test_what_is_added_is_there_after_a_restart(board: Leaderboard):
    about = {"description": "first\nsecond line", "properties": {"GPU": "none", "image type": "RGB-D"}}
    added = board.add(FILE, method=" My method ", dataset_name="LMO", split="test", file_name="C:\\x\\a.csv", **about)
    assert added.is_new
    (kept,) = Leaderboard(board.folder).submissions()
    assert kept == added.submission
    assert (kept.method, kept.dataset_name, kept.split, kept.file_name) == ("My method", "lmo", "test", "a.csv")
    assert (kept.description, kept.properties) == ("first\nsecond line", about["properties"])
    assert list(kept.properties) == ["GPU", "image type"]
    assert (kept.rows, kept.time_per_image) == (1, 0.25)
    assert kept.path.read_bytes() == FILE
    assert kept.path == board.folder / "files" / f"{kept.sha256}.csv"
    assert kept.added.endswith("+00:00")


def test_the_same_file_again_gives_the_submission_that_is_there(board: Leaderboard, tmp_path: Path):
    first = add(board, description="kept")
    (tmp_path / "same.csv").write_bytes(FILE)
    again = board.add(tmp_path / "same.csv", method="m", dataset_name="tiny", split="test", description="other")
    assert again == (first, False)
    assert add(board, method="another") != first
    assert add(board, dataset_name="lmo") != first
    assert len(board.submissions()) == 3
    assert kept_files(board) == [first.path.name]


def test_a_lost_file_comes_back_with_the_same_upload(board: Leaderboard):
    first = add(board)
    first.path.unlink()
    with pytest.raises(MissingFileError, match=f"{first.path.name}: cannot be read .*; upload the original again"):
        board.results(first.id)
    first.path.write_bytes(b"something else")
    with pytest.raises(FormatError, match="its content has changed since it was uploaded; upload the original again"):
        board.results(first.id)
    assert not board.add(FILE, method="m", dataset_name="tiny", split="test").is_new
    assert len(board.results(first.id)) == 1


def test_submissions_come_newest_first_by_dataset(board: Leaderboard):
    ids = [add(board, dataset_name=name).id for name in ("lmo", "tless", "LMO", "lmo")[:2]]
    ids.append(add(board, method="other", dataset_name="LMO").id)
    assert [s.id for s in board.submissions()] == ids[::-1]
    assert [s.id for s in board.submissions("lmo")] == [ids[2], ids[0]]
    assert board.submissions("nothing") == ()


def test_results_bear_the_name_of_the_method(board: Leaderboard):
    submission = add(board, method="renamed later")
    board.edit(submission.id, method="now this")
    results = board.results(submission.id)
    assert (results.method, results.dataset_name, results.split) == ("now this", "tiny", "test")


def test_what_is_said_of_a_submission_can_be_changed(board: Leaderboard):
    first, second = add(board, properties={"a": "b"}), add(board, method="other")
    edited = board.edit(first.id, description="new", properties={"c": "d"})
    assert edited == replace(first, description="new", properties={"c": "d"})
    assert board.edit(first.id) == edited
    message = "method other: has the same file for this dataset already; remove one of the two, or give another name"
    with pytest.raises(InputError, match=message):
        board.edit(first.id, description="lost", method="other")
    assert board.submission(first.id) == edited
    assert board.submission(second.id) == second


def test_removing_keeps_a_file_that_another_submission_is_of(board: Leaderboard):
    first, second = add(board), add(board, method="other")
    board.keep(first.id, evaluation_of(first), "f")
    board.remove(first.id)
    assert board.submissions() == (second,)
    assert board.evaluations() == ()
    assert second.path.is_file()
    board.remove(second.id)
    assert kept_files(board) == []
    assert add(board).id > second.id  # an old address must not lead to another submission
    with pytest.raises(UnknownIdError, match=rf"submission {first.id} is not in the leaderboard; available: 3"):
        board.remove(first.id)


@pytest.mark.parametrize(
    ("about", "message"),
    [
        ({"method": "  "}, "method: has no name; give the name that it shall have"),
        ({"method": "x" * 201}, "has 201 characters; at most 200 are kept"),
        ({"method": "a\nb"}, r"method 'a\\nb': holds a character that cannot be shown"),
        ({"method": "\ud800"}, "holds a character that cannot be shown"),
        ({"description": "x" * 10_001}, "at most 10000 are kept"),
        ({"properties": {"": "RGB"}}, "property 'RGB': has no name; give it one, such as GPU"),
        ({"properties": {"GPU": "\x00"}}, "GPU .*: holds a character that cannot be shown"),
    ],
)
def test_texts_that_cannot_be_kept_are_refused(board: Leaderboard, about: dict, message: str):
    with pytest.raises(InputError, match=message) as caught:
        add(board, **about)
    assert "\n" not in str(caught.value)
    assert board.submissions() == ()


def test_a_bad_file_is_told_by_the_name_that_the_user_knows(board: Leaderboard, tmp_path: Path):
    bad = FILE + ROW.replace("0.5", "abc").encode()
    with pytest.raises(FormatError, match=r"^mine\.csv: line 3, .*score.*abc"):
        add(board, bad, file_name="mine.csv")
    (tmp_path / "bad.csv").write_bytes(bad)
    with pytest.raises(FormatError, match=f"^{tmp_path}/bad.csv: line 3"):
        add(board, tmp_path / "bad.csv")
    with pytest.raises(MissingFileError, match=r"absent\.csv: cannot be read \(No such file or directory\)"):
        add(board, tmp_path / "absent.csv")
    assert board.submissions() == ()
    assert kept_files(board) == []


def test_there_is_no_time_where_an_estimate_reports_none(board: Leaderboard):
    other_image = ROW.replace("1,0,", "1,1,").replace("0.25", "-1").encode()
    assert add(board, FILE + other_image).time_per_image is None
    assert add(board, FILE + other_image.replace(b",-1", b",0.75")).time_per_image == 0.5


def test_time_of_a_real_method(lmo: Path, board: Leaderboard):
    path = lmo / "results" / "megapose_lmo-test.csv"
    rows = [line.split(",") for line in path.read_text().splitlines()[1:]]
    times = {(row[0], row[1]): float(row[6]) for row in reversed(rows)}
    submission = add(board, path, dataset_name="lmo")
    assert submission.time_per_image == pytest.approx(sum(times.values()) / len(times), rel=1e-14)
    assert (submission.rows, submission.file_name) == (len(rows), path.name)


# ---- evaluations


def test_an_evaluation_comes_back_to_the_last_bit(board: Leaderboard, tiny: Path, tmp_path: Path):
    (_, left), *_ = ANNOTATED[FIRST]
    results = results_of(claim(FIRST, 1, moved(left, x=0.004, z=0.01)), *perfect().estimates(SECOND))
    write_results(tmp_path / "r.csv", results)
    submission, dataset = add(board, tmp_path / "r.csv"), open_dataset(tiny)
    for with_vsd in (False, True):  # the one with VSD is given though it is not the first
        evaluation = evaluate(dataset, board.results(submission.id), with_vsd=with_vsd)
        board.keep(submission.id, evaluation, fingerprint(dataset), with_vsd=with_vsd)
        kept = Leaderboard(board.folder).evaluation(submission.id, fingerprint(dataset))
        assert kept is not None
        assert same(kept.instances, evaluation.instances)
        assert kept.as_dict() == evaluation.as_dict()
        assert kept.per_object == evaluation.per_object
        summary = board.evaluations(submission.id)[-1]
        assert (summary.scores, summary.per_object) == (evaluation.scores, evaluation.per_object)
        assert (summary.targets, summary.seconds) == (4, evaluation.seconds)
        assert (summary.why_no_vsd, summary.with_vsd) == ("" if with_vsd else "not asked for", with_vsd)
    assert (kept.scores.vsd, len(board.evaluations())) != (None, 1)


def test_a_real_evaluation_comes_back_to_the_last_bit(board: Leaderboard, lmo: Path):
    dataset = open_dataset(lmo)
    submission = add(board, lmo / "results" / "megapose_lmo-test.csv", dataset_name="lmo")
    evaluation = evaluate(dataset, board.results(submission.id))
    board.keep(submission.id, evaluation, fingerprint(dataset))
    kept = board.evaluation(submission.id, fingerprint(dataset))
    assert kept is not None
    assert same(kept.instances, evaluation.instances)
    assert kept.as_dict() == evaluation.as_dict()
    (row,) = board.board().rows
    (cell,) = row.cells.values()
    assert cell.scores == evaluation.scores
    assert (cell.targets, cell.benchmark_targets, cell.is_subset, cell.is_full) == (365, 1445, True, False)
    assert row.average.value is None
    assert row.average.reason.startswith("no VSD, so no AR (LM-O: no depth image for 49 of 50 images")


def test_there_is_no_evaluation_of_other_data_or_by_another_version(
    board: Leaderboard, monkeypatch: pytest.MonkeyPatch
):
    submission = add(board)
    board.keep(submission.id, evaluation_of(submission), "one")
    assert board.evaluation(submission.id, "other") is None
    assert board.evaluation(submission.id + 1, "one") is None
    assert board.evaluation(submission.id, "one", task="siso") is None
    monkeypatch.setattr(leaderboard_module, "EVALUATION_VERSION", 2)
    assert board.evaluation(submission.id, "one") is None
    assert board.board().rows[0].average.reason == "not evaluated yet"


def test_a_later_evaluation_takes_the_place_of_the_earlier(board: Leaderboard):
    submission = add(board)
    for seed in range(3):
        board.keep(submission.id, evaluation_of(submission, seed=seed), "one")
    assert len(board.evaluations()) == 1
    kept = board.evaluation(submission.id, "one")
    assert kept is not None
    assert same(kept.instances, found_instances(7, seed=2))


def test_an_evaluation_needs_its_submission(board: Leaderboard):
    submission = add(board)
    with pytest.raises(UnknownIdError, match="submission 9 is not in the leaderboard; available: 1"):
        board.keep(9, evaluation_of(submission), "one")
    with pytest.raises(ValueError, match="an evaluation on lmo was given for a submission for tiny"):
        board.keep(submission.id, replace(evaluation_of(submission), dataset="lmo"), "one")


@pytest.mark.parametrize("with_vsd", [True, False])
def test_a_hundred_thousand_instances_are_kept_small_and_exact(with_vsd: bool):
    instances = found_instances(100_000, with_vsd=with_vsd)
    data = packed(instances)
    assert same(unpacked(data), instances)
    assert len(data) < (2_900_000 if with_vsd else 1_700_000)  # noise; nothing to compress but the ids


def test_damaged_instances_are_one_line(board: Leaderboard):
    data = bytearray(packed(found_instances(50)))
    for at in range(0, len(data), 97):
        data[at] ^= 0x55
    with pytest.raises(FormatError, match=r"instances of a kept evaluation are damaged \(.*\); evaluate it again"):
        unpacked(bytes(data))


# ---- the table


def keep(board: Leaderboard, method: str, dataset_name: str, count: int = 7, *, mark="f", split="test", **evaluation):
    """Add a submission of a file of its own and evaluate it."""
    content = FILE.replace(b"0.5", str(len(board.submissions()) + 1).encode())
    submission = add(board, content, method, dataset_name, split=split)
    board.keep(submission.id, evaluation_of(submission, count, **evaluation), mark)
    return submission


def test_methods_are_ranked_by_their_mean(board: Leaderboard):
    for method, rate in (("worst", 0.2), ("best", 0.9), ("middle", 0.5)):
        keep(board, method, "lmo", 50, rate=rate)
        keep(board, method, "tiny", 50, rate=rate)
    table = board.board()
    assert table.columns == (Column("lmo", "test"), Column("tiny", "test"))
    assert [row.method for row in table.rows] == ["best", "middle", "worst"]
    best = table.rows[0]
    averages = [cell.scores.average or 0.0 for cell in best.cells.values()]
    assert best.average.value == (averages[0] + averages[1]) / 2
    assert (best.average.name, best.average.is_core, best.average.reason) == ("mean of 2 datasets", False, "")
    assert best.seconds_per_image.value == 0.25


def test_the_mean_of_all_core_datasets_in_full_is_ar_core(board: Leaderboard, monkeypatch: pytest.MonkeyPatch):
    real, splits = leaderboard_table.dataset_facts, {}

    def with_few_instances(name: str):  # else thousands would have to be made up for each dataset
        splits[name] = real(name).test_split
        return replace(real(name), test_instances=20)

    monkeypatch.setattr(leaderboard_table, "dataset_facts", with_few_instances)
    for place, name in enumerate(CORE_DATASETS):
        with_few_instances(name)
        keep(board, "all", name, 20, split=splits[name], seed=place)
        keep(board, "nearly", name, 19 if name == "hb" else 20, split=splits[name], rate=0.9)
        keep(board, "other split", name, 20, split="val" if name == "hb" else splits[name], rate=0.9)
    keep(board, "all", "lm", 20, rate=0.0)  # does not count
    rows = {row.method: row for row in board.board().rows}
    core = [rows["all"].cells[Column(name, splits[name])].scores.average or 0.0 for name in CORE_DATASETS]
    assert rows["all"].average.value == pytest.approx(np.mean(core), abs=1e-15)
    assert rows["all"].average.name == AR_CORE
    assert board.board().rows[0].method == "all"  # only AR_Core is the benchmark's, though others have more
    assert [rows[m].average.name for m in ("nearly", "other split")] == ["mean of 7 datasets"] * 2
    assert [cell.is_subset for cell in rows["nearly"].cells.values()].count(True) == 1
    names = [column.dataset_name for column in board.board().columns]
    assert list(dict.fromkeys(names)) == [*CORE_DATASETS, "lm"]


def test_there_is_no_mean_with_a_dataset_without_vsd(board: Leaderboard):
    keep(board, "some", "lmo", rate=1.0)
    keep(board, "some", "ycbv", why_no_vsd="no depth", rate=1.0)
    keep(board, "none", "lmo", why_no_vsd="no depth", rate=1.0)
    keep(board, "with", "lmo", rate=0.1)
    rows = board.board().rows
    assert [row.method for row in rows[:1]] == ["with"]  # where there is AR comes first
    by_name = {row.method: row.average for row in rows}
    assert by_name["some"].value is None
    assert by_name["some"].reason == "no VSD, so no AR (YCB-V: no depth)"
    assert by_name["none"].reason == "no VSD, so no AR (LM-O: no depth)"


def test_rows_without_a_mean_are_ranked_by_mssd_and_mspd(board: Leaderboard):
    for method, rate in (("a", 0.1), ("b", 0.9), ("c", 0.5)):
        keep(board, method, "lmo", 100, why_no_vsd="no depth", rate=rate)
    add(board, method="0 not evaluated", dataset_name="lmo")
    assert [row.method for row in board.board().rows] == ["b", "c", "a", "0 not evaluated"]


def test_the_newest_evaluated_submission_counts_and_the_others_stay_listed(board: Leaderboard):
    old, new = keep(board, "m", "tiny"), keep(board, "m", "tiny", seed=1)
    waiting = add(board, FILE.replace(b"400", b"500"))
    (row,) = board.board().rows
    (cell,) = row.cells.values()
    assert (cell.submission_id, cell.newer_submission_id) == (new.id, waiting.id)
    assert [submission.id for submission in row.submissions] == [waiting.id, new.id, old.id]
    kept = board.evaluation(cell.submission_id, cell.fingerprint)
    assert kept is not None
    assert kept.scores == cell.scores


def test_of_several_evaluations_the_full_then_the_newest_then_that_with_vsd_counts(board: Leaderboard):
    def counted() -> tuple[str, int, bool]:
        (cell,) = board.board().rows[0].cells.values()
        return cell.fingerprint, cell.targets, cell.scores.vsd is not None

    submission = keep(board, "m", "lmo", 9, mark="subset")
    assert counted() == ("subset", 9, True)
    board.keep(submission.id, evaluation_of(submission, 1445, why_no_vsd="not asked for"), "full", with_vsd=False)
    assert counted() == ("full", 1445, False)
    board.keep(submission.id, evaluation_of(submission, 1445), "full")
    assert counted() == ("full", 1445, True)
    board.keep(submission.id, evaluation_of(submission, 1445), "corrected")
    board.keep(submission.id, evaluation_of(submission, 9), "subset")
    assert counted() == ("corrected", 1445, True)


def test_there_is_no_mean_time_where_a_dataset_has_none(board: Leaderboard):
    keep(board, "m", "lmo")
    submission = add(board, FILE.replace(b"0.25", b"-1"), dataset_name="ycbv")
    board.keep(submission.id, evaluation_of(submission), "f")
    (row,) = board.board().rows
    assert (row.seconds_per_image.value, row.seconds_per_image.reason) == (None, "no time reported (YCB-V)")


def test_splits_are_columns_of_their_own(board: Leaderboard):
    keep(board, "m", "hb", split="val_primesense")
    keep(board, "m", "hb", split="test_primesense")
    table = board.board()
    assert [column.title for column in table.columns] == ["HB", "HB val_primesense"]
    assert table.rows[0].average.name == "mean of 2 splits"
    assert [cell.benchmark_targets for cell in table.rows[0].cells.values()] == [1630, None]


def test_an_empty_leaderboard_is_an_empty_table_and_makes_no_folder(board: Leaderboard):
    assert (board.board().rows, board.submissions(), board.evaluations()) == ((), (), ())
    with pytest.raises(UnknownIdError, match="submission 1 is not in the leaderboard; available: none"):
        board.submission(1)
    assert not board.folder.exists()


# ---- what decides the scores


def test_the_fingerprint_is_that_of_the_files(own: Path, tmp_path: Path):
    before = fingerprint(open_dataset(own))
    assert fingerprint(open_dataset(own)) == before
    moved_root = (tmp_path / "elsewhere").joinpath("tiny")
    moved_root.parent.mkdir()
    assert fingerprint(open_dataset(own.rename(moved_root))) == before
    renamed = moved_root.rename(tmp_path / "lmo")
    assert fingerprint(open_dataset(renamed)) != before  # the name decides the tolerance of VSD


def edit_json(path: Path, change) -> None:
    content, status = json.loads(path.read_text()), path.stat()
    change(content)
    path.write_text(json.dumps(content))
    os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))  # annotations count by their bytes


def shift(content: dict) -> None:
    content["0"][0]["cam_t_m2c"][0] += 1e-9


CHANGES = {
    "ground truth": lambda root: edit_json(root / "test/000001/scene_gt.json", shift),
    "camera": lambda root: edit_json(
        root / "test/000001/scene_camera.json", lambda c: c["0"]["cam_K"].__setitem__(0, 80.5)
    ),
    "symmetries": lambda root: edit_json(root / "models/models_info.json", lambda c: c["2"].pop("symmetries_discrete")),
    "visibility": lambda root: (root / "test/000001/scene_gt_info.json").write_text("{}"),
    "targets": lambda root: (root / "test_targets_bop19.json").write_text("[]"),
    "mesh": lambda root: os.utime(root / "models/obj_000001.ply", ns=(0, 1)),
    "more suitable meshes": lambda root: shutil.copytree(root / "models", root / "models_eval"),
    "depth": lambda root: os.utime(root / "test/000001/depth/000000.png", ns=(0, 1)),
    "no depth": lambda root: (root / "test/000001/depth/000000.png").unlink(),
    "no depth at all": lambda root: shutil.rmtree(root / "test/000001/depth"),
    "image": lambda root: next((root / "test/000001/rgb").glob("000001.*")).unlink(),
    "scene": lambda root: shutil.copytree(root / "test/000001", root / "test/000007"),
    "no ground truth": lambda root: (root / "test/000001/scene_gt.json").unlink(),
    "empty ground truth": lambda root: (root / "test/000001/scene_gt.json").write_text(""),
}


@pytest.mark.parametrize("change", CHANGES)
def test_the_fingerprint_changes_with_what_decides_the_scores(own: Path, change: str):
    dataset = open_dataset(own)
    dataset.targets()
    before = fingerprint(dataset)
    CHANGES[change](own)
    assert fingerprint(dataset) != before  # also of a dataset that has read the files before
    assert fingerprint(open_dataset(own)) == fingerprint(dataset)


def test_the_fingerprint_is_that_of_the_sensor(own: Path):
    scene = own / "test" / "000001"
    for stem in ("scene_camera", "scene_gt"):
        shutil.copy(scene / f"{stem}.json", scene / f"{stem}_cam1.json")
    assert fingerprint(open_dataset(own, "test", "cam1")) != fingerprint(open_dataset(own, "test", ""))


# ---- the file itself


def test_the_folder_is_the_users_unless_another_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path):
    monkeypatch.setenv("INSPECTOR_DATA", str(tmp_path / "data"))
    assert default_folder() == tmp_path / "data" / "leaderboard"
    monkeypatch.delenv("INSPECTOR_DATA")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "xdg"))
    assert default_folder() == tmp_path / "xdg" / "inspector" / "leaderboard"


def make_file(board: Leaderboard) -> Path:
    keep(board, "m", "tiny", 200)
    return board.folder / "leaderboard.sqlite"


def test_a_newer_file_is_left_alone(board: Leaderboard):
    path = make_file(board)
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA user_version = 7")
    connection.close()
    before = path.read_bytes()
    message = r"leaderboard\.sqlite: is of version 7, this program knows up to 1; update the program, or set INSPECTOR"
    for use in (lambda: Leaderboard(board.folder), board.submissions, lambda: add(board, method="new")):
        with pytest.raises(InputError, match=message):
            use()
    assert path.read_bytes() == before


def test_another_programs_file_is_left_alone(board: Leaderboard):
    board.folder.mkdir()
    path = board.folder / "leaderboard.sqlite"
    with sqlite3.connect(path) as connection:
        connection.execute("CREATE TABLE notes (text TEXT)")
    connection.close()
    before = path.read_bytes()
    for use in (lambda: Leaderboard(board.folder), lambda: add(board)):
        with pytest.raises(FormatError, match=r"leaderboard\.sqlite: is another program's database; move it away"):
            use()
    assert path.read_bytes() == before


@pytest.mark.parametrize("damage", ["text", "cut", "head", "pages"])
def test_a_damaged_file_is_one_line_and_left_alone(board: Leaderboard, damage: str):
    path = make_file(board)
    data = path.read_bytes()
    match damage:
        case "text":
            data = b"this is no database\n" * 500
        case "cut":
            data = data[: len(data) // 2]
        case "head":
            data = bytes(100) + data[100:]
        case "pages":
            data = data[:100] + b"\xff" * (len(data) - 100)
    path.write_bytes(data)
    message = r"leaderboard\.sqlite: is (damaged \(.*\); restore a copy or move it away; the uploads .* remain|another)"
    for use in (lambda: Leaderboard(board.folder).board(), lambda: add(board, method="new"), board.board):
        with pytest.raises(FormatError, match=message) as caught:
            use()
        assert "\n" not in str(caught.value)
    assert path.read_bytes() == data
    moved_away = path.rename(path.with_suffix(".damaged"))
    assert Leaderboard(board.folder).submissions() == ()
    assert moved_away.read_bytes() == data
    assert len(kept_files(board)) == 1


def test_no_damage_gives_a_traceback(board: Leaderboard):
    path = make_file(board)
    data = path.read_bytes()
    rng = np.random.default_rng(0)
    refused = 0
    for _ in range(150):
        changed = bytearray(data)
        for at in rng.integers(0, len(data), 5):
            changed[at] = rng.integers(0, 256)
        path.write_bytes(changed)
        with contextlib.suppress(InputError):
            refused += 1
            opened = Leaderboard(board.folder)
            opened.board()
            opened.evaluation(1, "f")
            refused -= 1
        assert path.read_bytes() == bytes(changed)
    assert refused > 10


def test_an_older_file_is_brought_up_to_date(board: Leaderboard, monkeypatch: pytest.MonkeyPatch):
    make_file(board)
    later = (*leaderboard_database.MIGRATIONS, ("ALTER TABLE submissions ADD COLUMN url TEXT NOT NULL DEFAULT 'none'",))
    monkeypatch.setattr(leaderboard_database, "MIGRATIONS", later)
    with Database(board.folder).reading() as connection:
        assert connection.execute("SELECT url, method FROM submissions").fetchall()[0][:] == ("none", "m")
        assert connection.execute("PRAGMA user_version").fetchone()[0] == 2


def test_a_migration_that_fails_changes_nothing(board: Leaderboard, monkeypatch: pytest.MonkeyPatch):
    path = make_file(board)
    before = path.read_bytes()
    later = (*leaderboard_database.MIGRATIONS, ("DROP TABLE jobs", "no SQL"))
    monkeypatch.setattr(leaderboard_database, "MIGRATIONS", later)
    with pytest.raises(InputError):
        Leaderboard(board.folder)
    monkeypatch.undo()
    assert path.read_bytes() == before
    assert len(Leaderboard(board.folder).submissions()) == 1


def test_whoever_holds_the_file_for_long_is_told_of(board: Leaderboard, monkeypatch: pytest.MonkeyPatch):
    path = make_file(board)
    monkeypatch.setattr(leaderboard_database, "BUSY_SECONDS", 0.1)
    holder = sqlite3.connect(path, isolation_level=None)
    holder.execute("BEGIN IMMEDIATE")
    try:
        with pytest.raises(InputError, match=r"leaderboard\.sqlite: has been in use for 0 s; end what uses it"):
            add(board, method="new")
        assert len(board.submissions()) == 1  # reading goes on
    finally:
        holder.close()


def test_a_folder_that_cannot_be_made_is_one_line(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(
        InputError, match=r"file/board: cannot be made \(Not a directory\); make it writable, or set INSP"
    ):
        add(Leaderboard(tmp_path / "file" / "board"))


def test_the_table_has_no_need_of_the_instances(board: Leaderboard):
    def quickest(use: Callable[[], object]) -> float:
        return min(timeit.repeat(use, number=1, repeat=5))

    submission = add(board)
    for mark in ("0", "1", "2"):
        board.keep(submission.id, evaluation_of(submission, 20_000), mark)
    table = quickest(lambda: Leaderboard(board.folder).board())
    assert table < quickest(lambda: board.evaluation(submission.id, "0")) / 2


def test_results_of_the_kept_file_are_those_of_the_upload(board: Leaderboard, lmo: Path):
    path = lmo / "results" / "megapose_lmo-test.csv"
    kept, given = board.results(add(board, path, dataset_name="lmo").id), read_results(path)
    assert np.array_equal(kept.translation_mm, given.translation_mm)
    assert np.array_equal(kept.rotation, given.rotation)
