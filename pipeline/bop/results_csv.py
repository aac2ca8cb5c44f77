"""Reading the CSV of BOP's results format as a stream, so that only the numbers themselves need memory."""

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from pipeline.bop.results_problems import COLUMNS, HEADER, Problem, Problems, blank_line
from pipeline.bop.results_rows import Block, Layout, parse_block
from pipeline.bop.results_table import Columns, Lines
from pipeline.exceptions import FormatError, MissingFileError

__all__ = ["COLUMNS", "HEADER", "MAX_ROWS", "Lines", "Scan", "UnreadableError", "scan"]

MAX_ROWS = 5_000_000
"""Rows that are read at most; they take 0.7 GB.

Far more than anybody submits: at the 100 estimates of an image that BOP scores at most (200 on XYZ-IBD), all 10,080 test
images of T-LESS come to a million.
"""

BLOCK_BYTES = 1 << 22
LONGEST_LINE = 1 << 20
SMALL_BYTES = 1 << 20
"""Files up to this size are read row by row: they are done before pyarrow is imported."""
_ESTIMATE_TOLERANCE = 1.1
_BYTE_ORDER_MARK = b"\xef\xbb\xbf"


class UnreadableError(FormatError):
    """A file of which no row can be read."""

    problem: Problem


@dataclass(frozen=True, eq=False)
class Scan:
    """All good rows of a file, and what is wrong with the others."""

    columns: dict[str, np.ndarray]
    """By BOP's names: ids int64 (n,), score and time (n,), R (n, 9), t (n, 3) in millimetres."""
    lines: Lines
    faults: Problems
    """Rows that are left out."""
    oddities: Problems
    """What was put up with but BOP's own reader would refuse."""
    has_header: bool


def scan(path: Path, max_rows: int = MAX_ROWS) -> Scan:
    """Read a results file; its bad rows are left out and told of.

    Raises MissingFileError if it cannot be read, and UnreadableError if it holds no results at all or more than
    `max_rows`: from its size and its first rows where that is plain, else when it turns out.
    """
    try:
        with path.open("rb") as file:
            return _Scanner(path, os.fstat(file.fileno()).st_size, max_rows).scan(file)
    except OSError as error:
        problem = f"cannot be read ({error.strerror}); check the file and its permissions"
        raise MissingFileError(f"{path}: {problem}") from error


class _Scanner:
    """What is known of a file while it is being read."""

    def __init__(self, path: Path, size: int, max_rows: int) -> None:
        self._path, self._size, self._max_rows = path, size, max_rows
        self._layout: Layout | None = None
        self._has_header = False
        self._faults, self._oddities, self._lines = Problems(), Problems(), Lines()
        self._columns: Columns | None = None

    def scan(self, file: BinaryIO) -> Scan:
        for block in self._blocks(file):
            if b"\0" in block.data:
                raise self._unreadable("is no text file", f"expected CSV with the columns {HEADER}")
            rest = block if self._layout else self._after_head(block)
            if rest is not None and rest.lines:
                self._take(rest)
        if self._layout is None:
            raise self._unreadable("is empty", f"expected the header {HEADER} and a row for each estimate")
        columns = (self._columns or Columns(0)).finished()
        return Scan(columns, self._lines, self._faults, self._oddities, self._has_header)

    def _blocks(self, file: BinaryIO) -> Iterator[Block]:
        """Whole lines, each ended by a line feed, whatever ends them in the file."""
        rest, line = b"", 1
        while data := file.read(BLOCK_BYTES):
            while data.endswith(b"\r") and (more := file.read(1)):
                data += more
            if b"\r" in data:
                data = data.replace(b"\r\n", b"\n").replace(b"\r", b"\n")
            data = rest + data
            end = data.rfind(b"\n") + 1
            data, rest = data[:end], data[end:]
            if data:
                yield (block := Block(data, line, data.count(b"\n")))
                line += block.lines
            if len(rest) > LONGEST_LINE:
                text = f"is longer than {LONGEST_LINE} bytes"
                raise self._unreadable(text, f"expected CSV with the columns {HEADER}", line)
        if rest:
            yield Block(rest + b"\n", line, 1)

    def _after_head(self, block: Block) -> Block | None:
        """What follows the header, or the block itself if there is none; None if there are only blank lines."""
        data, line = block.data, block.first_line
        if line == 1:
            data = data.removeprefix(_BYTE_ORDER_MARK)
        blank = data[: len(data) - len(data.lstrip())].count(b"\n")
        if blank:
            self._oddities.add(blank_line(line), blank)
            data, line = data.lstrip(), line + blank
        if not data:
            return None
        head, _, after = data.partition(b"\n")
        text = head.decode("utf-8", errors="replace")
        names = tuple(name.strip().strip('"') for name in text.split(","))
        self._has_header = bool(set(names) & set(COLUMNS))
        self._layout = self._header(names, text, line) if self._has_header else Layout()
        if self._has_header:
            data, line = after, line + 1
        return Block(data, line, block.lines - (line - block.first_line))

    def _header(self, names: tuple[str, ...], text: str, line: int) -> Layout:
        missing = [column for column in COLUMNS if column not in names]
        if missing:
            fix = f"the header must be {HEADER}"
            raise self._unreadable(f"column {missing[0]} is missing", fix, line, missing[0])
        if HEADER not in text:
            what = "has the columns in another order" if names != COLUMNS else "is written in another way"
            problem = Problem("header", line, f"the header {what}", f"write {HEADER}", "", text.strip()[:100])
            self._oddities.add(problem)
        return Layout(names)

    def _take(self, block: Block) -> None:
        """Append the rows of a block."""
        if self._columns is None:
            self._columns = Columns(self._expected_rows(block))
        assert self._layout is not None
        at_once = self._size > SMALL_BYTES
        rows = parse_block(block, self._layout, at_once, self._faults, self._oddities)
        self._lines.add(rows.lines)
        self._columns.add(rows.columns)
        if self._columns.count > self._max_rows:
            raise self._too_many(f"more than {self._max_rows:,}")

    def _expected_rows(self, block: Block) -> int:
        """How many rows the file holds, if all are as long as those of its first block. Raises if they are too many."""
        expected = round(self._size * block.lines / len(block.data))
        if expected > self._max_rows * _ESTIMATE_TOLERANCE:
            raise self._too_many(f"about {expected:,}")
        return expected

    def _too_many(self, rows: str) -> UnreadableError:
        text = f"holds {rows} rows ({self._size / 1e9:.1f} GB); at most {self._max_rows:,} are read"
        return self._unreadable(text, "keep the 100 estimates of highest score of each image, or split it by scene")

    def _unreadable(self, text: str, fix: str, line: int = 0, column: str = "") -> UnreadableError:
        where = f"line {line}, " if line else ""
        error = UnreadableError(f"{self._path}: {where}{text}; {fix}")
        error.problem = Problem("unreadable", line, text, fix, column)
        return error
