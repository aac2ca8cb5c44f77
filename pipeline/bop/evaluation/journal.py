"""Finished pieces of an evaluation on the disk, so that an interrupted one goes on where it stopped.

Each evaluation has a file of its own, named by all that decides its numbers. Pieces are appended, each with its length
and checksum: one that a killed process has left half-written, or that was damaged since, is as if it was never there.
"""

import fcntl
import io
import json
import logging
import os
import struct
import zlib
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType

import numpy as np

from pipeline.bop.evaluation.name import EvaluationName
from pipeline.exceptions import InputError

log = logging.getLogger(__name__)

SUFFIX = ".pieces"
"""Of the files."""

_MARK = b"\x93piece\r\n"
_HEAD = struct.Struct("<qQI")  # index, length, CRC-32 of what follows
_ABOUT = -1
"""Index under which the file says what it is about."""


class NoJournal:
    """Keeps nothing."""

    kept: Mapping[int, dict[str, np.ndarray]] = MappingProxyType({})

    def add(self, index: int, columns: dict[str, np.ndarray]) -> None:
        """Nothing."""

    def __enter__(self) -> "NoJournal":
        return self

    def __exit__(self, *_: object) -> None: ...


class PieceJournal:
    """The journal of one evaluation, held by one process at a time; to be used in a `with` block."""

    def __init__(self, folder: Path, name: EvaluationName) -> None:
        """Open or begin it; the folder is made if absent, and may hold those of other evaluations.

        Raises InputError if it cannot be written, or another process holds it.
        """
        self.path = folder / f"{name.file_name}{SUFFIX}"
        self.kept: dict[int, dict[str, np.ndarray]] = {}
        """Columns of the finished pieces by index."""
        is_new = not self.path.exists()
        self._handle = _held(self.path)
        if is_new:
            _tell_of_others(self.path, name)
        self._end = self._read()
        if not self._end:
            self._append(_ABOUT, json.dumps(name._asdict()).encode())

    def add(self, index: int, columns: dict[str, np.ndarray]) -> None:
        """Keep a finished piece. Raises InputError if it cannot be written."""
        buffer = io.BytesIO()
        np.savez(buffer, allow_pickle=False, **columns)  # type: ignore[arg-type]
        self._append(index, buffer.getvalue())

    def close(self) -> None:
        """Let go of the file, which stays."""
        os.close(self._handle)

    def __enter__(self) -> "PieceJournal":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _append(self, index: int, content: bytes) -> None:
        data = _MARK + _HEAD.pack(index, len(content), zlib.crc32(content)) + content
        try:
            if os.pwrite(self._handle, data, self._end) != len(data):
                raise OSError(None, "no space left on the device")
        except OSError as error:
            os.ftruncate(self._handle, self._end)
            raise _cannot_write(self.path, error) from error
        self._end += len(data)

    def _read(self) -> int:
        """Take what is whole, and cut off what comes after it; returns where that begins."""
        end = 0
        for index, content, place in _records(os.pread(self._handle, os.fstat(self._handle).st_size, 0)):
            if index != _ABOUT:
                with np.load(io.BytesIO(content), allow_pickle=False) as columns:
                    self.kept[index] = dict(columns)
            end = place
        os.ftruncate(self._handle, end)
        return end


def forget_pieces(folder: Path) -> None:
    """Remove the journals in a folder, once their results are safe; those of other processes that run stay."""
    for path in folder.glob(f"*{SUFFIX}"):
        with suppress(OSError), path.open("rb") as file:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            path.unlink()
    with suppress(OSError):  # it holds something else
        folder.rmdir()


def _records(data: bytes) -> Iterator[tuple[int, bytes, int]]:
    """Index, content and end of each whole record; what lies between them is damaged and left out."""
    place = data.find(_MARK)
    while place >= 0:
        begin = place + len(_MARK) + _HEAD.size
        if begin <= len(data):
            index, length, checksum = _HEAD.unpack_from(data, place + len(_MARK))
            content = data[begin : begin + length]
            if len(content) == length and zlib.crc32(content) == checksum:
                yield index, content, begin + length
                place = data.find(_MARK, begin + length)
                continue
        place = data.find(_MARK, place + 1)


def _held(path: Path) -> int:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise _cannot_write(path, error) from error
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        raise InputError(f"{path}: another process is at this evaluation; wait for it, or end it") from error
    return handle


def _cannot_write(path: Path, error: OSError) -> InputError:
    text = f"cannot be written ({error.strerror}); make room or give another folder, and run again to go on"
    return InputError(f"{path}: {text}")


def _tell_of_others(path: Path, name: EvaluationName) -> None:
    """Say why the pieces of an earlier try are not taken, if there was one on other data."""
    for other in path.parent.glob(f"*-{name.what}-*{SUFFIX}"):
        records = _records(other.read_bytes()) if other != path else iter(())
        index, content, _ = next(records, (0, b"", 0))
        if index == _ABOUT:
            theirs = json.loads(content)["decisive"]
            changed = " and ".join(key for key, value in name.decisive.items() if theirs.get(key) != value)
            log.warning("%s: kept pieces are not used, as %s changed since; all are computed anew", other, changed)
