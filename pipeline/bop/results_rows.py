"""Rows of a results file to numbers: all at once where nothing is odd, else one by one; every bad row is named."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Int

from pipeline.bop.results_problems import COLUMNS, HEADER, IDS, NAMES, NUMBERS, Problem, Problems, blank_line, good_rows

ARROW_BLOCK = 1 << 20
_NOT_SEPARATORS = bytes(set(range(256)) - set(b", \t\n"))


class Block(NamedTuple):
    """Some whole lines of a file, each ended by a line feed."""

    data: bytes
    first_line: int
    """Number of the first of them in the file, from 1."""
    lines: int
    """Number of lines."""


class Rows(NamedTuple):
    """The good rows of a block."""

    columns: Sequence[np.ndarray]
    """17 arrays: three ids, score, nine of R, three of t, time."""
    lines: range | Int[np.ndarray, "n"]
    """Their numbers in the file."""


@dataclass(frozen=True)
class Layout:
    """Where in a row the columns stand."""

    names: tuple[str, ...] = COLUMNS
    """Columns of the file, possibly with others between them."""

    @cached_property
    def positions(self) -> tuple[tuple[str, int], ...]:
        """Each of BOP's columns with its position."""
        return tuple((column, self.names.index(column)) for column in COLUMNS)

    @cached_property
    def in_order(self) -> bool:
        """Whether BOP's columns are the first of the file, in BOP's order."""
        return self.names[: len(COLUMNS)] == COLUMNS

    @cached_property
    def separators(self) -> bytes:
        """What is left of a row without its numbers; empty if there are other columns."""
        if len(self.names) != len(COLUMNS):
            return b""
        return b",".join(b" " * (NUMBERS[name] - 1) for name in self.names) + b"\n"


def parse_block(block: Block, layout: Layout, at_once: bool, faults: Problems, oddities: Problems) -> Rows:
    """The good rows of a block; the bad ones are added to `faults`, and what BOP would refuse to `oddities`.

    The numbers are those that Python's `float` gives, to the last bit.
    """
    columns = _at_once(block, layout) if at_once else None
    if columns is not None:
        found = Rows(columns, range(block.first_line, block.first_line + block.lines))
    else:
        found = _one_by_one(block, layout, faults, oddities)
    good = good_rows(found.columns, found.lines, faults)
    if good is None:
        return found
    return Rows([column[good] for column in found.columns], np.asarray(found.lines)[good])


def _at_once(block: Block, layout: Layout) -> list[np.ndarray] | None:
    """All rows of a block if each has all separators where they belong and every id is a whole number, else None."""
    data, separators = block.data, layout.separators
    if not separators or data.translate(None, _NOT_SEPARATORS) != separators * block.lines:
        return None
    if b"x" in data or b"X" in data:
        return None  # pyarrow takes 0x1F for an id
    import pyarrow as pa
    from pyarrow import csv

    names = [f"{column}.{i}" for column in layout.names for i in range(NUMBERS[column])]
    ids = {f"{column}.0": pa.int64() for column in IDS}
    spaced = pa.py_buffer(data.replace(b",", b" "))
    try:
        table = csv.read_csv(
            pa.BufferReader(spaced),
            read_options=csv.ReadOptions(column_names=names, block_size=ARROW_BLOCK),
            parse_options=csv.ParseOptions(delimiter=" ", quote_char=False, ignore_empty_lines=False),
            convert_options=csv.ConvertOptions(
                column_types=dict.fromkeys(names, pa.float64()) | ids, null_values=[], check_utf8=False
            ),
        )
    except pa.ArrowInvalid:
        return None
    return [table.column(name).to_numpy() for name in NAMES]


def _one_by_one(block: Block, layout: Layout, faults: Problems, oddities: Problems) -> Rows:
    text = block.data[:-1].decode("utf-8", errors="replace").split("\n")
    rows, lines = [], []
    for line, row in enumerate(text, start=block.first_line):
        if not row or row.isspace():
            oddities.add(blank_line(line))
            continue
        values = _row_values(row, layout, line, oddities)
        if isinstance(values, Problem):
            faults.add(values)
        else:
            rows.append(values)
            lines.append(line)
    table = np.array(rows, dtype=float).reshape(-1, len(NAMES))
    return Rows(list(table.T), np.array(lines, dtype=np.int64))


def _row_values(row: str, layout: Layout, line: int, oddities: Problems) -> list[float] | Problem:
    """The 17 numbers of a row, or what is wrong with it."""
    fields = row.split(",")
    if len(fields) != len(COLUMNS) or not layout.in_order:
        fault = _wrong_columns(fields, layout, line)
        if fault:
            return fault
    values: list[float] = []
    for column, position in layout.positions:
        numbers = fields[position].split()
        if len(numbers) != NUMBERS[column]:
            return _wrong_number(column, fields[position], line)
        try:
            values += map(float, numbers)
        except ValueError:
            return _no_number(column, fields[position], line)
        if column in IDS and not numbers[0].isdigit() and values[-1].is_integer():
            text, fix = f"column {column}: {numbers[0]} is not written as a whole number", f"write {int(values[-1])}"
            if not _is_integer(numbers[0]):
                oddities.add(Problem("id spelling", line, text, fix, column, numbers[0]))
    return values


def _is_integer(text: str) -> bool:
    try:
        int(text)
    except ValueError:
        return False
    return True


def _wrong_columns(fields: list[str], layout: Layout, line: int) -> Problem | None:
    if len(fields) <= max(position for _, position in layout.positions):
        missing = COLUMNS[min(len(fields), len(COLUMNS) - 1)]
        return Problem("columns", line, f"column {missing} is missing", f"expected {HEADER}", missing)
    if layout.in_order and len(fields) > len(COLUMNS):
        fix = f"expected {len(COLUMNS)} ({HEADER}), with spaces inside R and t"
        return Problem("columns", line, f"{len(fields)} columns", fix, "", str(len(fields)))
    return None


def _wrong_number(column: str, field: str, line: int) -> Problem:
    expected, shown = NUMBERS[column], field.strip()[:60]
    found = len(field.split())
    text = f"is {shown!r}" if expected == 1 < found else f"has {found} numbers"
    fix = f"expected {expected} {'numbers separated by spaces' if expected > 1 else 'number'}"
    return Problem("numbers", line, f"column {column}: {text}", fix, column, shown)


def _no_number(column: str, field: str, line: int) -> Problem:
    shown = field.strip()[:60]
    if shown == column:
        return Problem("second header", line, f"column {column}: {shown!r} is no number", "remove this second header")
    text = f"column {column}: {shown!r} is no number"
    return Problem("no number", line, text, "write it as digits", column, shown)
