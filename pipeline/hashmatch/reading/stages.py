"""How many candidates each stage left, and where, as a recording says."""

from typing import NamedTuple

import numpy as np

from pipeline.exceptions import UnknownIdError
from pipeline.hashmatch.showing.stages import LEVEL_CELL_PX, STAGES
from pipeline.recording import Heatmap, RecordingReader, Table


class StageCount(NamedTuple):
    """What a stage leaves."""

    windows: int
    """Windows that have a candidate left."""
    candidates: int
    """Pairs of a window and a template."""


class RecordedStages:
    """The stages of a recorded cascade."""

    def __init__(self, reader: RecordingReader) -> None:
        self._reader = reader
        self._rows = reader.read("hashmatch/stages", Table).columns
        levels, scales = self._rows["level"].tolist(), self._rows["scale"].tolist()
        self.scales: dict[int, float] = dict(sorted(zip(levels, scales, strict=True)))
        """s_w by level of the pyramid, smallest first."""

    def counts(self, level: int | None = None) -> dict[str, StageCount]:
        """What each stage leaves, in their order; of one level, or of all together. Raises UnknownIdError for others."""
        columns, counts = self._rows, {}
        chosen = np.ones(len(columns["level"]), bool) if level is None else columns["level"] == self.known(level)
        for stage in STAGES:
            rows = chosen & (columns["stage"] == stage)
            counts[stage] = StageCount(int(columns["windows"][rows].sum()), int(columns["candidates"][rows].sum()))
        return counts

    def heatmap(self, stage: str, level: int | None = None) -> Heatmap | None:
        """Candidates per pixel after a stage, summed, or at one level; None where none is left at the level."""
        if stage not in STAGES:
            raise UnknownIdError("stage", stage, "HashMatch", STAGES)
        if level is None:
            return self._reader.read(f"hashmatch/{stage}", Heatmap)
        columns = self._reader.read(f"hashmatch/scales/{stage}", Table).columns
        rows = np.flatnonzero(columns["level"] == self.known(level))
        return Heatmap(columns["heat"][rows[0]], LEVEL_CELL_PX, "candidates") if len(rows) else None

    def known(self, level: int) -> int:
        """The level itself. Raises UnknownIdError if it is none of the pyramid."""
        if level not in self.scales:
            raise UnknownIdError("level", level, "the pyramid of this image", self.scales)
        return level
