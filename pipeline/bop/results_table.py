"""The rows of a results file as they are read: their numbers in arrays that grow in place, and their lines."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from pipeline.bop.results_problems import IDS, NUMBERS


class Lines:
    """The number in the file of every row that was read, kept as stretches of lines without a gap."""

    def __init__(self) -> None:
        self._rows: list[int] = []
        self._lines: list[int] = []
        self._next = (0, 0)

    def add(self, lines: range | Int[np.ndarray, "n"]) -> None:
        """Append the lines of further rows."""
        if not len(lines):
            return
        row, expected = self._next
        breaks = [] if isinstance(lines, range) else (np.flatnonzero(np.diff(lines) != 1) + 1).tolist()
        starts = [0, *breaks] if lines[0] != expected else breaks
        self._rows += [row + start for start in starts]
        self._lines += [int(lines[start]) for start in starts]
        self._next = (row + len(lines), int(lines[-1]) + 1)

    def of(self, row: int) -> int:
        """Line of a row; lines count from 1, rows from 0."""
        stretch = int(np.searchsorted(self._rows, row, "right")) - 1
        return self._lines[stretch] + row - self._rows[stretch]


class Columns:
    """Columns that grow in place: there is never a second copy of them."""

    def __init__(self, expected: int) -> None:
        self.count = 0
        self._room = expected
        self._arrays = {
            column: np.empty((expected, n) if n > 1 else expected, np.int64 if column in IDS else float)
            for column, n in NUMBERS.items()
        }

    def add(self, columns: Sequence[np.ndarray]) -> None:
        """Append rows, given as their 17 numbers."""
        end = self.count + len(columns[0])
        if end > self._room:
            self._resize(end + end // 8)
        given = iter(columns)
        for column, n in NUMBERS.items():
            target = self._arrays[column][self.count : end].reshape(-1, n)
            for i in range(n):
                target[:, i] = next(given)
        self.count = end

    def finished(self) -> dict[str, np.ndarray]:
        """Give the columns, exactly as long as there are rows."""
        self._resize(self.count)
        return self._arrays

    def _resize(self, rows: int) -> None:
        for array in self._arrays.values():
            array.resize((rows, *array.shape[1:]), refcheck=False)
        self._room = rows
