"""The recorded tables of windows, votes and detections, and how to find a row in them."""

from functools import cached_property

import numpy as np
from jaxtyping import Integer

from pipeline.exceptions import UnknownIdError
from pipeline.hashmatch.reading.report import TemplateVotes
from pipeline.hashmatch.window_grid import Placed, corner_at
from pipeline.recording import RecordingReader, Table


def columns_of(reader: RecordingReader, path: str) -> dict[str, np.ndarray]:
    """Columns of the table at a path below `hashmatch/`. Raises as `RecordingReader.read`."""
    return dict(reader.read(f"hashmatch/{path}", Table).columns)


class RecordedTables:
    """Reads tables when they are asked for first."""

    def __init__(self, reader: RecordingReader, levels: dict[int, Placed], matches_needed: float) -> None:
        self._reader = reader
        self._levels = levels
        self._matches_needed = matches_needed

    @cached_property
    def windows(self) -> dict[str, np.ndarray]:
        """Those that got candidates."""
        return columns_of(self._reader, "candidates/hashing")

    @cached_property
    def votes(self) -> dict[str, np.ndarray]:
        """Of these windows."""
        return columns_of(self._reader, "votes")

    @cached_property
    def detections(self) -> dict[str, np.ndarray]:
        """Verified candidates."""
        return columns_of(self._reader, "candidates/verification")

    def row_of_window(self, level: int, corner: Integer[np.ndarray, "2"]) -> int | None:
        """Row among the windows with candidates; None where it got none."""
        key = _window_keys(np.array([level]), corner[None])[0]
        place = int(np.searchsorted(self._sorted_keys, key))
        found = place < len(self._sorted_keys) and self._sorted_keys[place] == key
        return int(self._order_of_keys[place]) if found else None

    def votes_of(self, row: int) -> tuple[TemplateVotes, ...]:
        """The recorded templates of a window with candidates, most votes first."""
        first, last = np.searchsorted(self.votes["window"], (row, row + 1))
        level = int(self.windows["level"][row])
        corner = tuple(self.windows["corner"][row].tolist())
        return tuple(self._vote(at, level, corner) for at in range(first, last))

    def detection(self, row: int) -> dict[str, np.ndarray]:
        """The values of a detection by column. Raises UnknownIdError where there is no such detection."""
        count = len(self.detections["level"])
        if not 0 <= row < count:
            raise UnknownIdError("detection", row, f"the recording of {count} detections", range(count))
        return {name: column[row] for name, column in self.detections.items()}

    def _vote(self, at: int, level: int, corner: tuple[int, int]) -> TemplateVotes:
        votes = self.votes
        obj_id, template = int(votes["object"][at]), int(votes["template"][at])
        failed, fractions = int(votes["failed"][at]), votes["fractions"][at].astype(float).round(3).tolist()
        detection = self._detection_rows.get((level, *corner, obj_id, template)) if failed == 0 else None
        by = None if detection is None else int(self.detections["suppressed_by"][detection])
        return TemplateVotes(
            obj_id=obj_id,
            template=template,
            votes=int(votes["votes"][at]),
            rank=int(votes["rank"][at]),
            failed_test=failed,
            fractions=(fractions[0], fractions[1], fractions[2], fractions[3]),
            missing=round(self._matches_needed - fractions[failed - 2], 3) if failed > 1 else None,
            detection=detection,
            suppressed_by=None if by == detection else by,
        )

    @cached_property
    def _order_of_keys(self) -> Integer[np.ndarray, "n"]:
        return np.argsort(_window_keys(self.windows["level"], self.windows["corner"]), kind="stable")

    @cached_property
    def _sorted_keys(self) -> Integer[np.ndarray, "n"]:
        return _window_keys(self.windows["level"], self.windows["corner"])[self._order_of_keys]

    @cached_property
    def _detection_rows(self) -> dict[tuple[int, ...], int]:
        """Row of each detection by level, x, y, object, template."""
        found = self.detections
        corners = np.zeros((len(found["level"]), 2), int)
        for index, level in self._levels.items():
            its = found["level"] == index
            corners[its] = corner_at(level, found["pixels"][its])
        keys = zip(found["level"], *corners.T, found["object"], found["template"], strict=True)
        return {tuple(map(int, key)): row for row, key in enumerate(keys)}


def _window_keys(levels: Integer[np.ndarray, "n"], corners: Integer[np.ndarray, "n 2"]) -> Integer[np.ndarray, "n"]:
    """One number per window, smaller for smaller levels, then rows, then columns."""
    x, y = corners.astype(np.int64).T
    return (levels.astype(np.int64) << 40) + (y << 20) + x
