"""Journals by which an interrupted run continues: append-only files of JSON lines, held by one process at a time.

A line is there in whole or not at all: what a killed process or a full disk left of one is cut off at the next opening.
"""

import fcntl
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import orjson

from pipeline.exceptions import InputError

_CHUNK = 1 << 20


class Line(NamedTuple):
    """Where a line stands in the file."""

    start: int
    length: int


class Journal:
    """A file of JSON lines, of which the first says what the others are about."""

    def __init__(self, path: Path) -> None:
        """Open or create the file.

        Raises InputError if another process holds it or it cannot be written.
        """
        self.path = path
        self._handle, self._closed = _hold(path), False
        self._lines: list[Line] = []
        self._end = 0
        for data in _whole_lines(self._handle):
            self._lines.append(Line(self._end, len(data)))
            self._end += len(data)
        os.ftruncate(self._handle, self._end)

    @property
    def head(self) -> Any:
        """Content of the first line, None in a new file."""
        return self.read(self._lines[0]) if self._lines else None

    @property
    def entries(self) -> list[Line]:
        """Where the lines after the first stand."""
        return self._lines[1:]

    def read(self, line: Line) -> Any:
        """Content of a line."""
        return orjson.loads(os.pread(self._handle, line.length, line.start))

    def start(self, head: Any) -> None:
        """Forget all there is and write a first line."""
        os.ftruncate(self._handle, 0)
        self._lines, self._end = [], 0
        self.append(head)

    def append(self, content: Any) -> Line:
        """Add a line, which outlives the death of this process. Raises InputError if it cannot be written."""
        data = orjson.dumps(content) + b"\n"
        try:
            written = 0
            while written < len(data):
                written += os.pwrite(self._handle, data[written:], self._end + written)
        except OSError as error:
            os.ftruncate(self._handle, self._end)
            raise cannot_write(self.path, error) from error
        self._lines.append(Line(self._end, len(data)))
        self._end += len(data)
        return self._lines[-1]

    def close(self) -> None:
        """Let go of the file, which stays; a second time nothing happens."""
        if not self._closed:
            self._closed = True
            os.close(self._handle)

    def remove(self) -> None:
        """Delete the file and let go of it."""
        self.path.unlink()
        self.close()


def cannot_write(path: Path, error: OSError) -> InputError:
    """The error to raise where writing a file of an interruptible run failed."""
    return InputError(
        f"{path}: cannot be written ({error.strerror}); make room or get permission, "
        "then give the same command again: it continues"
    )


def _hold(path: Path) -> int:
    try:
        handle = os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except OSError as error:
        raise cannot_write(path, error) from error
    try:
        # Not flock: a worker forked from this process would inherit that lock, and keep it when this one is killed.
        fcntl.lockf(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(handle)
        raise InputError(f"{path}: held by another run on these data; wait until it is done, or end it") from error
    return handle


def _whole_lines(handle: int) -> Iterator[bytes]:
    """The file's lines up to the first that is cut off or no JSON."""
    rest, at = b"", 0
    while chunk := os.pread(handle, _CHUNK, at):
        at += len(chunk)
        *lines, rest = (rest + chunk).split(b"\n")
        for line in lines:
            if not _is_json(line):
                return
            yield line + b"\n"


def _is_json(line: bytes) -> bool:
    try:
        orjson.loads(line)
    except orjson.JSONDecodeError:
        return False
    return True
