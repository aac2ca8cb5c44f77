"""How many candidates each stage of the cascade leaves, window by window, as numbers and as heatmaps."""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Integer

from pipeline.hashmatch.config import TEMPLATE_SIZE
from pipeline.hashmatch.detector import Detector, LevelMatches, Matching
from pipeline.hashmatch.window_grid import corner_at, row_of_corner
from pipeline.recording import StageRecorder

STAGES = ("windows", "objectness", "hashing", "verification", "nms")
"""Of the cascade, in order."""

CELL_PX = 4
"""Side of the cells of the heatmaps that are summed over the levels."""

LEVEL_CELL_PX = 8
"""The same of those of one level: windows are at least 36 px wide, so nothing is lost that can be seen."""


class StageRow(NamedTuple):
    """What a stage leaves at one level: a row of the thesis's pipeline figure."""

    stage: str
    level: int
    scale: float
    windows: int
    """Windows that have a candidate left."""
    candidates: int
    """Pairs of a window and a template."""


def show_stages(detector: Detector, matching: Matching, recorder: StageRecorder) -> None:
    """Record the number of candidates after each stage at each level, and where they are."""
    height, width = matching.base.depth.shape
    shape = (-(-height // CELL_PX), -(-width // CELL_PX))
    sums = {stage: np.zeros(shape, np.float32) for stage in STAGES}
    of_levels: dict[str, dict[int, np.ndarray]] = {stage: {} for stage in STAGES}
    rows: list[StageRow] = []
    for matched in matching.levels:
        weights = candidates_of_windows(detector, matching, matched)
        rows += stage_rows(matched, weights)
        for stage in (stage for stage in STAGES if weights[stage].any()):
            heat = window_heat(matched, weights[stage], shape, CELL_PX)
            sums[stage] += heat
            of_levels[stage][matched.level.index] = _halved(heat)
    for stage, heat in sums.items():
        recorder.heatmap(f"hashmatch/{stage}", heat, cell_px=CELL_PX, unit="candidates")
        heats = of_levels[stage]
        recorder.table(f"hashmatch/scales/{stage}", {  # as heatmaps they would take five times the room
            "level": np.array(list(heats), np.int32),
            "heat": np.array(list(heats.values()), np.float32),
        })  # fmt: skip
    recorder.table("hashmatch/stages", {name: np.array(column) for name, column in _columns(rows).items()})
    totals = {stage: sum(row.candidates for row in rows if row.stage == stage) for stage in STAGES}
    recorder.text("log", "candidates: " + ", ".join(f"{stage} {count}" for stage, count in totals.items()))


def candidates_of_windows(
    detector: Detector, matching: Matching, matched: LevelMatches
) -> dict[str, Integer[np.ndarray, "n"]]:
    """Candidates (templates) of each window of a level after each stage."""
    count = len(matched.windows)
    everything = len(detector.tables.objects)
    foreground = np.zeros(count, np.int64)
    foreground[matched.foreground] = everything
    passed = matched.candidates.windows[matched.verified.failed == 0]
    found = matching.detections
    kept = found.kept[found.levels[found.kept] == matched.level.index]
    at = [row_of_corner(matched, corner_at(matched.level, found.centers[row])) for row in kept]
    return {
        "windows": np.full(count, everything, np.int64),
        "objectness": foreground,
        "hashing": np.bincount(matched.candidates.windows, minlength=count),
        "verification": np.bincount(passed, minlength=count),
        "nms": np.bincount(np.array(at, np.int64), minlength=count),
    }


def stage_rows(matched: LevelMatches, weights: Mapping[str, Integer[np.ndarray, "n"]]) -> list[StageRow]:
    """The sums of a level."""
    return [
        StageRow(stage, matched.level.index, matched.level.scale, int((own > 0).sum()), int(own.sum()))
        for stage, own in weights.items()
    ]


def window_heat(
    matched: LevelMatches, weights: Integer[np.ndarray, "n"], shape: tuple[int, int], cell_px: int = 1
) -> Float[np.ndarray, "h w"]:
    """Sum of the weights of the windows of a level that hold the centre of each cell, by corner differences.

    Args:
        matched: The level.
        weights: Of its windows.
        shape: Rows and columns of cells.
        cell_px: Their side, pixels of the image.

    """
    half = TEMPLATE_SIZE / 2 / matched.level.scale
    used = np.flatnonzero(weights)
    centers = matched.level.centers(matched.windows[used])
    first_cell = (cell_px - 1) / 2
    size = np.array(shape[::-1])
    x0, y0 = np.clip(np.ceil((centers - half - first_cell) / cell_px), 0, size).astype(int).T
    x1, y1 = np.clip(np.ceil((centers + half - first_cell) / cell_px), 0, size).astype(int).T
    corners = np.zeros((shape[0] + 1, shape[1] + 1))
    for y, x, sign in ((y0, x0, 1), (y0, x1, -1), (y1, x0, -1), (y1, x1, 1)):
        np.add.at(corners, (y, x), sign * weights[used])
    return corners.cumsum(axis=0).cumsum(axis=1)[:-1, :-1].astype(np.float32)


def _halved(heat: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "a b"]:
    """Means of two by two cells; a last odd one is repeated."""
    height, width = heat.shape
    even = cv2.copyMakeBorder(heat, 0, height % 2, 0, width % 2, cv2.BORDER_REPLICATE)
    return even.reshape(even.shape[0] // 2, 2, even.shape[1] // 2, 2).mean(axis=(1, 3), dtype=np.float32)


def _columns(rows: Sequence[StageRow]) -> dict[str, tuple]:
    return dict(zip(StageRow._fields, zip(*rows, strict=True), strict=True)) if rows else {}
