"""Finished pieces on the disk: taken again only where they are whole and of the very same evaluation."""

import logging
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tiny_dataset import make_dataset, perfect
from worker_functions import slow_columns

from pipeline.bop.dataset import open_dataset
from pipeline.bop.evaluation.journal import PieceJournal, forget_pieces
from pipeline.bop.evaluation.name import EvaluationName, evaluation_of
from pipeline.exceptions import InputError

PIECES = {
    0: {"obj_id": np.array([1, 2]), "found": np.array([[True, False], [True, True]])},
    1: {"obj_id": np.array([3]), "found": np.array([[False, False]])},
    7: {"obj_id": np.zeros(0, np.int64), "found": np.zeros((0, 2), bool)},
}
NAME = EvaluationName("lmo-test-mine", "abc", {"dataset": "1", "results": "2"})


def write(folder: Path, name: EvaluationName = NAME) -> Path:
    """A journal with three pieces."""
    with PieceJournal(folder, name) as journal:
        for index, columns in PIECES.items():
            journal.add(index, columns)
        return journal.path


def kept(folder: Path, name: EvaluationName = NAME) -> dict[int, dict[str, np.ndarray]]:
    with PieceJournal(folder, name) as journal:
        return dict(journal.kept)


def test_pieces_come_back_as_they_were(tmp_path: Path):
    write(tmp_path)
    found = kept(tmp_path)
    assert found.keys() == PIECES.keys()
    for index, columns in PIECES.items():
        assert found[index].keys() == columns.keys()
        for name, values in columns.items():
            np.testing.assert_array_equal(found[index][name], values)
            assert found[index][name].dtype == values.dtype


def test_a_piece_cut_off_at_any_byte_is_as_if_it_was_never_there(tmp_path: Path):
    path = write(tmp_path / "whole")
    data = path.read_bytes()
    last = data.rfind(b"piece")
    for length in range(last - 1, len(data), 37):
        cut = tmp_path / f"cut{length}" / path.name
        cut.parent.mkdir()
        cut.write_bytes(data[:length])
        with PieceJournal(cut.parent, NAME) as journal:
            assert list(journal.kept) == [0, 1]
            journal.add(7, PIECES[7])
        assert cut.read_bytes() == data


def test_a_damaged_piece_costs_no_other(tmp_path: Path):
    path = write(tmp_path)
    data = bytearray(path.read_bytes())
    marks = [i for i in range(len(data)) if data[i : i + 5] == b"piece"]
    for place, lost in ((marks[1] + 100, 0), (marks[1] + 2, 0), (marks[2] + 16, 1), (marks[0] + 50, None)):
        damaged = bytearray(data)
        damaged[place] ^= 255
        path.write_bytes(damaged)
        assert list(kept(tmp_path)) == [index for index in PIECES if index != lost]
    path.write_bytes(b"something else")
    assert kept(tmp_path) == {}


def test_an_evaluation_is_in_one_process_at_a_time(tmp_path: Path):
    with (
        PieceJournal(tmp_path, NAME) as journal,
        pytest.raises(InputError, match=f"^{journal.path}: another process is at this evaluation; wait for it"),
    ):
        PieceJournal(tmp_path, NAME)
    write(tmp_path)


def test_a_folder_that_cannot_be_written_is_told(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"file/journal/.*: cannot be written .Not a directory.; make room or give"):
        PieceJournal(tmp_path / "file" / "journal", NAME)


def test_pieces_of_something_else_are_left_alone_and_told(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    caplog.set_level(logging.WARNING)
    path = write(tmp_path)
    write(tmp_path, NAME._replace(what="other"))
    assert not caplog.records
    assert kept(tmp_path, NAME._replace(decisive={"dataset": "1", "results": "3"})) == {}
    assert [record.message for record in caplog.records] == [
        f"{path}: kept pieces are not used, as results changed since; all are computed anew"
    ]
    assert len(kept(tmp_path)) == 3


def test_forgetting_removes_what_nobody_works_on(tmp_path: Path):
    folder = tmp_path / "journal"
    write(folder)
    with PieceJournal(folder, NAME._replace(what="other")) as journal:
        forget_pieces(folder)
        assert list(folder.iterdir()) == [journal.path]
    forget_pieces(folder)
    assert not folder.exists()
    forget_pieces(folder)
    write(folder)
    (folder / "notes.txt").touch()
    forget_pieces(folder)
    assert [path.name for path in folder.iterdir()] == ["notes.txt"]


def test_all_that_decides_the_numbers_is_in_the_name(tmp_path: Path):
    root = make_dataset(tmp_path / "tiny")
    dataset, results = open_dataset(root), perfect()
    targets = dataset.targets()
    score = results.score.copy()
    score[1] += 1e-12
    names = [
        evaluation_of(slow_columns, dataset, results, targets, 32),
        evaluation_of(partial(slow_columns, seconds=1.0), dataset, results, targets, 32),
        evaluation_of(slow_columns, dataset, replace(results, score=score), targets, 32),
        evaluation_of(slow_columns, dataset, results, targets[1:], 32),
        evaluation_of(slow_columns, dataset, results, targets, 33),
    ]
    same = evaluation_of(slow_columns, open_dataset(root), perfect(), targets, 32)
    assert same == names[0]
    (tmp_path / "elsewhere").mkdir()
    moved = root.rename(tmp_path / "elsewhere" / "tiny")
    assert evaluation_of(slow_columns, open_dataset(moved), results, targets, 32) == names[0]
    truth = moved / "test" / "000001" / "scene_gt.json"
    truth.write_text(truth.read_text().replace("400", "401", 1))
    names.append(evaluation_of(slow_columns, open_dataset(moved), results, targets, 32))
    assert len({name.file_name for name in names}) == 6
    assert names[0].file_name.startswith("tiny-test-perfect-")
    assert [name.what == names[0].what for name in names] == [True, False, True, True, True, True]
