"""Journals: what a process that was killed, or a disk that was full, leaves of them."""

import errno
import os
from pathlib import Path

import pytest

from pipeline.bop.journal import Journal
from pipeline.exceptions import InputError


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """A journal with two entries."""
    journal = Journal(tmp_path / "run.journal")
    journal.start({"of": "tests"})
    journal.append([1, "a"])
    journal.append({"long": "x" * 2_000_000})
    journal.close()
    return journal.path


def content(path: Path) -> tuple[object, list[object]]:
    journal = Journal(path)
    try:
        return journal.head, [journal.read(line) for line in journal.entries]
    finally:
        journal.close()


def test_lines_are_read_back(path):
    assert content(path) == ({"of": "tests"}, [[1, "a"], {"long": "x" * 2_000_000}])


@pytest.mark.parametrize("cut", [1, 2, 1000, 1_999_000])
def test_half_a_line_is_forgotten_and_leaves_nothing_behind(path, cut):
    os.truncate(path, path.stat().st_size - cut)
    journal = Journal(path)
    journal.append("short")
    journal.close()
    assert content(path) == ({"of": "tests"}, [[1, "a"], "short"])
    assert path.read_bytes().endswith(b'\n"short"\n')


def test_lines_from_the_first_damaged_one_on_are_forgotten(path):
    data = path.read_bytes()
    path.write_bytes(data.replace(b'[1,"a"]', b"\0" * 7))  # what a power cut may leave
    assert content(path) == ({"of": "tests"}, [])


def test_file_that_is_no_journal_counts_as_empty(tmp_path):
    (tmp_path / "run.journal").write_bytes(b"\x89PNG something")
    assert content(tmp_path / "run.journal") == (None, [])


def test_line_that_cannot_be_written_leaves_the_others(monkeypatch, path):
    size, real = path.stat().st_size, os.pwrite

    def three_bytes_fit(handle: int, data: bytes, at: int) -> int:
        if at > size:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        return real(handle, data[:3], at)

    journal = Journal(path)
    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", three_bytes_fit)
        with pytest.raises(InputError, match=r"cannot be written \(No space left on device\).*the same command again"):
            journal.append("more")
    assert path.stat().st_size == size
    journal.append("room again")
    journal.close()
    assert content(path)[1][-1] == "room again"


def test_starting_anew_forgets_all(path):
    journal = Journal(path)
    journal.start("new")
    journal.close()
    assert content(path) == ("new", [])


def test_removing_and_closing_twice_are_harmless(path):
    journal = Journal(path)
    journal.remove()
    journal.close()
    assert not path.exists()
