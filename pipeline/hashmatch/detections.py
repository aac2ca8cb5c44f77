"""Detections from the verified candidates of all levels (thesis sec. Non-Maxima Suppression)."""

from collections.abc import Sequence

import numpy as np

from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.matching import Detections, LevelMatches
from pipeline.hashmatch.nms import ranking_scores, suppress
from pipeline.hashmatch.templates import Templates

_MOST_DETECTIONS = 20_000
"""Verified candidates of an object that non-maxima suppression looks at; the best ones."""


def detections_of(objects: Sequence[Templates], matched: Sequence[LevelMatches], config: HashMatchConfig) -> Detections:
    """Verified candidates of all levels, best first, and which of them suppressed which.

    Detections of different objects suppress each other only where no refinement follows that could tell them apart.
    """
    firsts = np.cumsum([0, *(len(own) for own in objects)])
    parts = [_columns(objects, firsts, own) for own in matched]
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    best_first = np.argsort(-columns["ranking"], kind="stable")
    rows_of = [np.flatnonzero(columns["objects"][best_first] == o) for o in range(len(objects))]
    best_first = best_first[np.sort(np.concatenate([rows[:_MOST_DETECTIONS] for rows in rows_of]))]
    columns = {name: values[best_first] for name, values in columns.items()}
    together = not config.refine and config.task == "detection"
    groups = np.zeros_like(columns["objects"]) if together else columns["objects"]
    found = suppress(columns["ranking"], columns["boxes"], groups, config.overlap)
    return Detections(**columns, suppressed_by=found.by)


def _columns(objects: Sequence[Templates], firsts: np.ndarray, own: LevelMatches) -> dict[str, np.ndarray]:
    """Columns of the verified candidates of a level."""
    rows = np.flatnonzero(own.verified.failed == 0)
    templates = own.candidates.templates[rows]
    windows = own.windows[own.candidates.windows[rows]]
    of_objects = np.searchsorted(firsts, templates, side="right").astype(np.int32) - 1
    local = templates - firsts[of_objects]
    areas, boxes = np.zeros(len(rows), np.int64), np.zeros((len(rows), 4))
    for position in np.unique(of_objects):
        its = of_objects == position
        areas[its] = objects[position].areas[local[its]]
        boxes[its] = objects[position].boxes[local[its]]
    offset = np.tile(windows - own.level.overhang, 2)
    scales = np.full(len(rows), own.level.scale)
    verified = own.verified
    return {
        "objects": of_objects,
        "templates": local,
        "levels": np.full(len(rows), own.level.index),
        "scales": scales,
        "centers": own.level.centers(windows),
        "boxes": (boxes + offset) / own.level.scale,
        "votes": own.candidates.votes[rows],
        "fractions": verified.fractions[rows],
        "shifts": verified.shifts[rows],
        "ranking": ranking_scores(verified.scores[rows].astype(float), areas * verified.known[rows], scales),
    }
