"""Bars and curves of one or two evaluations, as the page draws them."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from inspector.selection import Board, Grouping, Score
from pipeline.bop.evaluation.curves import VISIBILITY, Curves, curves
from pipeline.bop.evaluation.evaluate import Evaluation
from pipeline.bop.evaluation.scores import MSPD_THETAS_PX, THETAS, Scores
from pipeline.bop.vsd import TAUS


class Entry(NamedTuple):
    """An evaluation with its place on the page."""

    place: str
    """`first` or `second`."""
    submission_id: int
    evaluation: Evaluation


def figures(entries: Sequence[Entry], board: Board) -> dict[str, Any]:
    """Bars per object or scene, recall over the thresholds of each error, and recall over the visible fraction."""
    methods = [
        {
            "place": entry.place,
            "submission": entry.submission_id,
            "name": entry.evaluation.method,
            "instances": len(entry.evaluation.instances),
        }
        for entry in entries
    ]
    evaluations = [entry.evaluation for entry in entries]
    return {"methods": methods, "groups": _groups(evaluations, board), "curves": _curves(evaluations, board.score)}


def _groups(evaluations: Sequence[Evaluation], board: Board) -> list[dict[str, Any]]:
    tables = [_scores_by(evaluation, board.by) for evaluation in evaluations]
    found = []
    for number in sorted({number for table in tables for number in table}):
        counts = [np.count_nonzero(_ids(evaluation, board.by) == number) for evaluation in evaluations]
        found.append(
            {
                "label": f"{board.by} {number}",
                "count": int(max(counts)),
                "values": [_value(table.get(number), board.score) for table in tables],
                "filter": {"obj_id" if board.by == "object" else "scene_id": number},
            }
        )
    return found


def _scores_by(evaluation: Evaluation, by: Grouping) -> dict[int, Scores]:
    return evaluation.per_object if by == "object" else evaluation.per_scene


def _ids(evaluation: Evaluation, by: Grouping) -> Int[np.ndarray, "n"]:
    return evaluation.instances.obj_id if by == "object" else evaluation.instances.scene_id


def _value(scores: Scores | None, score: Score) -> float | None:
    return None if scores is None else getattr(scores, score)


def _curves(evaluations: Sequence[Evaluation], score: Score) -> list[dict[str, Any]]:
    found = [curves(evaluation.instances) for evaluation in evaluations]
    drawn = [
        _curve("MSSD", "recall [%]", THETAS, _DIAMETERS, [of.mssd for of in found]),
        _curve("MSPD", "recall [%]", MSPD_THETAS_PX, _PIXELS, [of.mspd for of in found]),
    ]
    grids = [of.vsd for of in found if of.vsd is not None]
    if len(grids) == len(found) > 0:
        drawn += [
            _curve("VSD", "recall [%], mean over tau", THETAS, _THETA, [grid.mean(axis=0) for grid in grids]),
            _curve("VSD", "recall [%], mean over theta", TAUS, _TAU, [grid.mean(axis=1) for grid in grids]),
        ]
    over_visible = [_over_visible_fraction(of, score) for of in found]
    if any(np.isfinite(line).any() for line in over_visible):
        title = {"average": "AR", "vsd": "AR_VSD", "mssd": "AR_MSSD", "mspd": "AR_MSPD"}[score]
        drawn.append(_curve(f"{title} over visible fraction", "[%], in tenths", _TENTHS, _VISIBLE, over_visible))
    return drawn


def _over_visible_fraction(of: Curves, score: Score) -> Float[np.ndarray, "b"]:
    """Average recall of each tenth of the visible fraction, NaN where there is none."""
    lines = {"vsd": of.vsd_by_visibility, "mssd": of.mssd_by_visibility, "mspd": of.mspd_by_visibility}
    wanted = list(lines.values()) if score == "average" else [lines[score]]
    known = [line for line in wanted if line is not None]
    return np.mean(known, axis=0) if len(known) == len(wanted) else np.full(len(_TENTHS), np.nan)


def _curve(
    title: str, remark: str, x: Sequence[float] | np.ndarray, axis: dict[str, Any], lines: Sequence[np.ndarray]
) -> dict[str, Any]:
    """A chart of one line per method; None in `y` is a gap."""
    drawn = [{"method": i, "y": [None if np.isnan(y) else float(y) for y in line]} for i, line in enumerate(lines)]
    return {
        "title": title,
        "remark": remark,
        "x": [round(float(value), 6) for value in x],
        "axis": axis,
        "lines": drawn,
    }


_TENTHS = (VISIBILITY[:-1] + VISIBILITY[1:]) / 2
_DIAMETERS = {"label": "threshold, share of the diameter", "ticks": [0.1, 0.2, 0.3, 0.4, 0.5], "from": 0, "to": 0.5}
_PIXELS = {"label": "threshold, px at 640 px width", "ticks": [10, 20, 30, 40, 50], "from": 0, "to": 50}
_THETA = {"label": "threshold theta", "ticks": [0.1, 0.2, 0.3, 0.4, 0.5], "from": 0, "to": 0.5}
_TAU = {"label": "tolerance tau, share of the diameter", "ticks": [0.1, 0.2, 0.3, 0.4, 0.5], "from": 0, "to": 0.5}
_VISIBLE = {"label": "visible fraction", "ticks": [0, 0.2, 0.4, 0.6, 0.8, 1], "from": 0, "to": 1}
