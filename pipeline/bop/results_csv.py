"""Parsing the CSV of BOP's results format into one table of numbers, fast, with the first bad row named."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Float

from pipeline.exceptions import FormatError

COLUMNS = ("scene_id", "im_id", "obj_id", "score", "R", "t", "time")
HEADER = ",".join(COLUMNS)
_LENGTHS = dict(zip(COLUMNS, (1, 1, 1, 1, 9, 3, 1), strict=True))

Table = tuple[Float[np.ndarray, "n 17"], Sequence[int]]
"""Values of all rows and their line numbers in the file."""

_SEPARATORS = b",,,,        ,  ,\n"
_NOT_SEPARATORS = bytes(set(range(256)) - set(b", \t\n"))


def parse_rows(path: Path, data: bytes) -> Float[np.ndarray, "n 17"]:
    """The numbers of all rows: three ids, score, nine of R, three of t, time.

    Raises FormatError that names file, line, column and value of the first bad row, and how many more there are.
    """
    data = data.removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n").strip()
    if not data:
        raise FormatError(f"{path}: is empty; expected the header {HEADER} and a row for each estimate")
    if b"\0" in data:
        raise FormatError(f"{path}: is no text file; expected CSV with the columns {HEADER}")
    values, lines = _read_plain(data) or _read_carefully(path, data)
    _check_values(path, values, lines)
    return values


def _read_plain(data: bytes) -> Table | None:
    """Rows of a file without any oddity in one go, None for any other."""
    header, _, rows = data.partition(b"\n")
    has_header = header.decode("latin-1") == HEADER
    body = (rows if has_header else data) + b"\n"
    count = body.count(b"\n") if body.strip() else 0
    if body.translate(None, _NOT_SEPARATORS) != _SEPARATORS * count and count:
        return None
    try:
        values = np.array(body.replace(b",", b" ").split(), dtype=np.float64)
    except ValueError:
        return None
    first_line = 2 if has_header else 1
    return (values.reshape(-1, 17), range(first_line, first_line + count)) if len(values) == 17 * count else None


def _read_carefully(path: Path, data: bytes) -> Table:
    """Rows one by one, with the columns in the order of the header; raises FormatError for the first bad one."""
    text = data.decode("utf-8", errors="replace").splitlines()
    order, begin = _column_order(path, text[0])
    rows, lines, faults = [], [], []
    for line, row in enumerate(text[begin:], start=begin + 1):
        if not row.strip():
            continue
        try:
            rows.append(_row_values(row.split(","), order))
            lines.append(line)
        except FormatError as error:
            faults.append(f"{path}: line {line}, {error}")
    if faults:
        raise _fault(faults[0], len(faults))
    return np.array(rows, dtype=float).reshape(-1, 17), lines


def _column_order(path: Path, first_line: str) -> tuple[list[int], int]:
    """Position of each column, and the number of header lines (0 or 1)."""
    names = [name.strip().strip('"') for name in first_line.split(",")]
    if not set(names) & set(COLUMNS):
        return list(range(7)), 0
    missing = [column for column in COLUMNS if column not in names]
    if missing:
        raise FormatError(f"{path}: line 1, column {missing[0]} is missing; the header must be {HEADER}")
    return [names.index(column) for column in COLUMNS], 1


def _row_values(fields: list[str], order: list[int]) -> list[float]:
    """The 17 numbers of a row. Raises FormatError that names the column and the value."""
    if len(fields) <= max(order):
        raise FormatError(
            f"column {COLUMNS[len(fields)] if len(fields) < 7 else COLUMNS[-1]} is missing; expected {HEADER}"
        )
    if order == list(range(7)) and len(fields) > 7:
        raise FormatError(f"{len(fields)} columns; expected 7 ({HEADER}), with spaces inside R and t")
    values: list[float] = []
    for column, position in zip(COLUMNS, order, strict=True):
        numbers, count = fields[position].split(), _LENGTHS[column]
        if len(numbers) != count:
            plural = "numbers separated by spaces" if count > 1 else "number"
            shown = (
                f"is {fields[position].strip()[:60]!r}" if count == 1 < len(numbers) else f"has {len(numbers)} numbers"
            )
            raise FormatError(f"column {column}: {shown}; expected {count} {plural}")
        try:
            values += map(float, numbers)
        except ValueError as error:
            raise FormatError(
                f"column {column}: {fields[position].strip()[:60]!r} is no number; write it as digits"
            ) from error
    return values


def _check_values(path: Path, values: Float[np.ndarray, "n 17"], lines: Sequence[int]) -> None:
    """Refuse numbers that cannot be meant: ids that are no whole numbers, NaN, rotations that are none."""
    ids = values[:, :3]
    good_ids = (ids == np.floor(ids)) & (ids >= 0) & (ids < 2**31)
    finite = np.isfinite(values)
    regular = np.abs(np.linalg.det(np.where(finite[:, 4:13], values[:, 4:13], 1.0).reshape(-1, 3, 3))) > 1e-6
    bad = np.flatnonzero(~(good_ids.all(axis=1) & finite.all(axis=1) & regular))
    if not len(bad):
        return
    row = bad[0]
    if not good_ids[row].all():
        at = int(np.argmin(good_ids[row]))
        text = f"column {COLUMNS[at]}: is {values[row, at]:g}; expected a whole number from 0"
    elif not finite[row].all():
        at = int(np.argmin(finite[row]))
        column = next(c for c, end in zip(COLUMNS, np.cumsum(list(_LENGTHS.values())), strict=True) if at < end)
        hint = "finite numbers" if column != "time" else "seconds, or -1 where not measured"
        text = f"column {column}: holds {values[row, at]}; expected {hint}"
    else:
        R = " ".join(f"{value:g}" for value in values[row, 4:13])
        text = f"column R: {R} is no rotation (its determinant is 0); expected a 3x3 rotation matrix row by row"
    raise _fault(f"{path}: line {lines[row]}, {text}", len(bad))


def _fault(first: str, count: int) -> FormatError:
    return FormatError(first if count == 1 else f"{first} (one of {count} bad rows)")
