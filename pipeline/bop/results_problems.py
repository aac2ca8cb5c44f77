"""What can be wrong with the rows of a results file, and which of its numbers cannot be meant."""

from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

COLUMNS = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")
HEADER = ",".join(COLUMNS)
IDS = COLUMNS[:3]
NUMBERS: dict[str, int] = dict(zip(COLUMNS, (1, 1, 1, 1, 9, 3, 1), strict=True))
"""How many numbers each column holds."""
NAMES = tuple(f"{column}.{i}" for column in COLUMNS for i in range(NUMBERS[column]))
"""Names of the 17 numbers of a row."""

_LEAST_DETERMINANT = 1e-6


class Problem(NamedTuple):
    """What is wrong with a line of the file."""

    kind: str
    """Short name; all problems of one kind are told together."""
    line: int
    text: str
    """What is wrong, with column and value."""
    fix: str
    column: str = ""
    value: str = ""

    def __str__(self) -> str:
        """Give the text for people."""
        return f"line {self.line}, {self.text}; {self.fix}"


class Problems:
    """The first problem of each kind, and how many rows have it."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}
        self._first: dict[str, Problem] = {}

    def add(self, problem: Problem, count: int = 1) -> None:
        """Note a problem that as many rows have; rows are told of in the order of the file."""
        self._first.setdefault(problem.kind, problem)
        self.counts[problem.kind] = self.counts.get(problem.kind, 0) + count

    def __iter__(self) -> Iterator[tuple[Problem, int]]:
        """Give the first of each kind with the number of rows, in the order of the lines."""
        firsts = sorted(self._first.values(), key=lambda problem: problem.line)
        return iter([(first, self.counts[first.kind]) for first in firsts])

    def __str__(self) -> str:
        """Give the first problem and the number of bad rows."""
        first, total = next(iter(self))[0], sum(self.counts.values())
        return str(first) if total == 1 else f"{first} (one of {total} bad rows)"


def blank_line(line: int) -> Problem:
    """What is wrong with a blank line."""
    return Problem("blank line", line, "is blank", "remove it: BOP's reader stops at a blank line")


def good_rows(
    columns: Sequence[np.ndarray], lines: range | np.ndarray, faults: Problems
) -> Bool[np.ndarray, "n"] | None:
    """Which rows hold numbers that can be meant, None if all do; the others are added to `faults`.

    Refused are ids that are no whole numbers from 0, NaN and infinity, and rotations whose determinant is 0.
    """
    bad_ids = _bad_ids(columns[:3])
    not_finite = ~np.logical_and.reduce([np.isfinite(column) for column in columns[3:]])
    with np.errstate(all="ignore"):
        flat = ~(np.abs(determinant(columns[4:13])) > _LEAST_DETERMINANT)
    bad = bad_ids | not_finite | flat
    if not bad.any():
        return None
    cases = ((bad_ids, _id_fault), (not_finite & ~bad_ids, _finite_fault), (flat & ~bad_ids & ~not_finite, _flat_fault))
    for wrong, fault in cases:
        if wrong.any():
            row = int(np.argmax(wrong))
            faults.add(fault([float(column[row]) for column in columns], int(lines[row])), int(wrong.sum()))
    return ~bad


def _bad_ids(ids: Sequence[np.ndarray]) -> Bool[np.ndarray, "n"]:
    return np.logical_or.reduce([~((i >= 0) & (i < 2**31) & (i == np.floor(i))) for i in ids])


def determinant(R: Sequence[Float[np.ndarray, "n"]]) -> Float[np.ndarray, "n"]:
    """Determinants of matrices of which the nine entries are given, row by row."""
    a, b, c, d, e, f, g, h, i = R
    return a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)


def _id_fault(values: list[float], line: int) -> Problem:
    column = next(c for c, value in zip(IDS, values, strict=False) if not (0 <= value < 2**31 and value.is_integer()))
    value = f"{values[COLUMNS.index(column)]:g}"
    return Problem("id", line, f"column {column}: is {value}", "expected a whole number from 0", column, value)


def _finite_fault(values: list[float], line: int) -> Problem:
    name, value = next((n, v) for n, v in zip(NAMES, values, strict=True) if not np.isfinite(v))
    column = name.partition(".")[0]
    hint = "finite numbers" if column != "time" else "seconds, or -1 where not measured"
    return Problem("not finite", line, f"column {column}: holds {value}", f"expected {hint}", column, str(value))


def _flat_fault(values: list[float], line: int) -> Problem:
    R = " ".join(f"{value:g}" for value in values[4:13])
    text = f"column R: {R} is no rotation (its determinant is 0)"
    return Problem("no rotation", line, text, "expected a 3x3 rotation matrix row by row", "R", R)
