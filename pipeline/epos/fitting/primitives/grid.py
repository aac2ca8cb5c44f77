"""Pixels by square cells of the image (compiled)."""

from typing import NamedTuple, no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.compiled import compiled, kernel

_CELL_PX = 8.0


_MAX_CELLS = 512
"""Columns and rows of the grid of pixels at most: beyond, cells grow."""


class Grid(NamedTuple):
    """Pixels by square cells of the image."""

    left: float
    top: float
    cell: float
    """Side in pixels."""
    columns: int
    rows: int
    first: np.ndarray
    """(columns * rows + 1,) where each cell's pixels begin in `members`."""
    members: np.ndarray
    """(p,) pixels, cell by cell."""


@compiled()
@no_type_check
def make_grid(pixels):
    """Sort pixels (p, 2) into cells."""
    left, right, top, bottom = np.inf, -np.inf, np.inf, -np.inf
    for i in range(len(pixels)):
        left, right = min(left, pixels[i, 0]), max(right, pixels[i, 0])
        top, bottom = min(top, pixels[i, 1]), max(bottom, pixels[i, 1])
    cell = max(_CELL_PX, max(right - left, bottom - top) / (_MAX_CELLS - 1))
    columns, rows = np.int64((right - left) / cell) + 1, np.int64((bottom - top) / cell) + 1
    first = np.zeros(columns * rows + 2, np.int64)
    home = np.empty(len(pixels), np.int64)
    for i in range(len(pixels)):
        home[i] = np.int64((pixels[i, 1] - top) / cell) * columns + np.int64((pixels[i, 0] - left) / cell)
        first[home[i] + 2] += 1
    for c in range(2, len(first)):
        first[c] += first[c - 1]
    members = np.empty(len(pixels), np.int64)
    for i in range(len(pixels)):
        members[first[home[i] + 1]] = i
        first[home[i] + 1] += 1
    return Grid(left, top, cell, columns, rows, first[:-1], members)


@kernel()
@no_type_check
def cell_at(grid, u, v):
    """Cell of the grid that a place in the image lies in, -1 outside."""
    column, row = np.int64(np.floor((u - grid.left) / grid.cell)), np.int64(np.floor((v - grid.top) / grid.cell))
    if column < 0 or row < 0 or column >= grid.columns or row >= grid.rows:
        return -1
    return row * grid.columns + column
