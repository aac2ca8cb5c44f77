"""Boards of regular layout: a full grid, or a frame about a free middle as T-LESS's (thesis sec. tless_acquisition_setup)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from pipeline.exceptions import InputError
from pipeline.geometry import transform_points
from pipeline.synth.boards.marker_board import SIDES, Face, MarkerBoard

DICTIONARY = "DICT_4X4_100"
"""Few cells per marker are large cells, which are still read at low elevation."""


def grid_board(
    columns: int = 7,
    rows: int = 5,
    marker_side: float = 0.04,
    gap: float = 0.01,
    margin: float = 0.01,
    dictionary: str = DICTIONARY,
    first_id: int = 0,
) -> MarkerBoard:
    """A full grid, numbered row by row from the upper left; `margin` is the white about it, all in metres.

    Raises `InputError` where the numbers make no board or the dictionary has too few markers.
    """
    return framed_board(columns, rows, 0, 0, marker_side, gap, margin, False, dictionary, first_id)


def framed_board(
    columns: int = 8,
    rows: int = 8,
    free_columns: int = 4,
    free_rows: int = 4,
    marker_side: float = 0.05,
    gap: float = 0.0125,
    margin: float = 0.0125,
    sides: bool = True,
    dictionary: str = DICTIONARY,
    first_id: int = 0,
) -> MarkerBoard:
    """A grid without its middle, where objects stand; with `sides`, a row of markers on each side of the block too.

    The gap is the white between markers (their quiet zone), the margin that at the edges, in metres. Markers are
    numbered row by row from the upper left, then along the sides: south, east, north, west.

    Raises `InputError` where the numbers make no board or the dictionary has too few markers.
    """
    _check(columns, rows, free_columns, free_rows, marker_side, gap, margin)
    pitch = marker_side + gap
    size = (columns * pitch - gap + 2 * margin, rows * pitch - gap + 2 * margin)
    centres = [(c, r) for r in range(rows) for c in range(columns) if not _is_free(c, columns, free_columns)
               or not _is_free(r, rows, free_rows)]  # fmt: skip
    corners = [_square(_along(c, columns, pitch), -_along(r, rows, pitch), marker_side) for c, r in centres]
    free = tuple(max(0.0, n * pitch - gap) if free_columns and free_rows else 0.0 for n in (free_columns, free_rows))
    height = marker_side + 2 * margin if sides else 0.0
    if sides:
        blank = MarkerBoard(dictionary, (first_id,), np.stack(corners[:1]), size, height=height)
        for k, name in enumerate(SIDES):
            corners += _row(blank.faces[name], (columns, rows)[k % 2], pitch, marker_side)
    ids = tuple(range(first_id, first_id + len(corners)))
    return MarkerBoard(dictionary, ids, np.stack(corners), size, (free[0], free[1]), height)


def _is_free(index: int, count: int, free: int) -> bool:
    return (count - free) // 2 <= index < (count + free) // 2


def _along(index: int, count: int, pitch: float) -> float:
    """Place of a marker's middle in a centred row."""
    return (index - (count - 1) / 2) * pitch


def _square(x: float, y: float, side: float) -> Float[np.ndarray, "4 3"]:
    half = side / 2
    return np.array(
        [[x - half, y + half, 0], [x + half, y + half, 0], [x + half, y - half, 0], [x - half, y - half, 0]]
    )


def _row(face: Face, count: int, pitch: float, marker_side: float) -> list[Float[np.ndarray, "4 3"]]:
    """A row of markers along a side, from its left end."""
    squares = [_square(_along(k, count, pitch), 0.0, marker_side) for k in range(count)]
    return [transform_points(face.board_from_face, square) for square in squares]


def _check(columns: int, rows: int, free_columns: int, free_rows: int, side: float, gap: float, margin: float) -> None:
    if min(columns, rows) < 1 or side <= 0:
        raise InputError(f"marker board of {columns} x {rows} markers of {side} m; give at least one of some size")
    if min(gap, margin) <= 0:
        raise InputError(f"marker board with gap {gap} m and margin {margin} m; markers need some white about them")
    free_fits = (0 <= free_columns < columns and 0 <= free_rows < rows) or (free_columns, free_rows) == (0, 0)
    if not free_fits or (free_columns and (columns - free_columns) % 2) or (free_rows and (rows - free_rows) % 2):
        raise InputError(
            f"marker board of {columns} x {rows} markers with {free_columns} x {free_rows} left free; the free middle"
            " must be smaller than the board and leave the same number on opposite sides"
        )
