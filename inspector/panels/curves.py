"""Curves over all rows of the table: how many are correct as the threshold moves, and as less of the object is seen."""

from typing import Any

import numpy as np
from jaxtyping import Float

from inspector import html
from inspector.frame import Frame
from inspector.selection import Criterion, Selection
from inspector.table import errors_of
from inspector.views import Context
from pipeline.bop.assessment import Assessment

RANGES: dict[Criterion, tuple[float, str]] = {
    "mssd": (0.5, "MSSD threshold, fraction of the diameter"),
    "mspd": (50.0, "MSPD threshold, px at 640 px width"),
    "vsd": (1.0, "VSD threshold"),
    "add": (0.5, "ADD(-I) threshold, fraction of the diameter"),
}
"""Largest threshold shown and label of its axis, per criterion."""
_BINS = np.linspace(0, 1, 11)
_STROKES = ("#3c96ff", "#ff9628")


class CurvesView:
    """Share of correct estimates over the threshold and over the visible fraction, for one or two methods."""

    title = "Curves"

    def __init__(self, context: Context) -> None:
        self._context = context
        self._shown: object = None

    def build(self) -> None:
        """Add both plots, empty."""
        gui = self._context.gui
        self._note = gui.add_html("")
        self._over_threshold = _plot(gui, (np.array([0.0, 1.0]), np.zeros(2)))
        self._visibility_note = gui.add_html("")
        self._over_visibility = _plot(gui, (np.array([0.0, 1.0]), np.zeros(2)))

    def update(self, frame: Frame | None, selection: Selection) -> None:
        """Redraw the plots if the rows, the methods or the criterion changed."""
        workspace = self._context.workspace
        wanted = (workspace.version, selection.method, selection.compare, selection.criterion, selection.thresholds)
        if wanted == self._shown:
            return
        self._shown = wanted
        methods = [m for m in (selection.method, selection.compare) if m is not None]
        rows = [
            (workspace.method_names[m], a)
            for m in methods
            if m < len(workspace.methods) and (a := workspace.assessment(m))
        ]
        rows = [(name, a) for name, a in rows if not np.isnan(_instance_errors(a, selection.criterion)).all()]
        if not rows:
            why = "no depth in these images" if selection.criterion == "vsd" else "no estimates with ground truth yet"
            self._note.content = html.block(html.paragraph(f"Nothing to plot: {why}.", dim=True))
            self._over_threshold.visible = self._over_visibility.visible = False
            self._visibility_note.content = ""
            return
        self._draw(rows, selection)

    def _draw(self, rows: list[tuple[str, Assessment]], selection: Selection) -> None:
        limit, label = RANGES[selection.criterion]
        thresholds = np.linspace(0, limit, 101)
        recalls = [_recall(_instance_errors(a, selection.criterion), thresholds) for _, a in rows]
        names = [name for name, _ in rows]
        at = [
            f"{name}: {_recall(_instance_errors(a, selection.criterion), np.array([selection.threshold]))[0]:.1%}"
            for name, a in rows
        ]
        self._note.content = html.block(
            html.heading("Correct instances over the threshold"),
            html.paragraph(f"{label}; at {selection.threshold:g}: {', '.join(at)}", dim=True),
        )
        _show(self._over_threshold, thresholds, recalls, names)
        middles = (_BINS[:-1] + _BINS[1:]) / 2
        binned = [_recall_by_visibility(a, selection) for _, a in rows]
        some = any(np.isfinite(curve).any() for curve in binned)
        remark = (
            "visible fraction (from the annotated models alone)"
            if rows[0][1].visibility_estimated
            else "visible fraction"
        )
        self._visibility_note.content = html.block(
            html.heading("Correct instances over the visible fraction"),
            html.paragraph(
                f"{remark}, in tenths; gaps have no instances" if some else "visible fractions unknown", dim=True
            ),
        )
        self._over_visibility.visible = some
        if some:
            _show(self._over_visibility, middles, binned, names)


def _plot(gui: Any, data: tuple[np.ndarray, ...]) -> Any:
    series = ({"label": "threshold"}, {"label": "correct", "stroke": _STROKES[0]})
    scales = {"x": {"time": False}, "y": {"range": (0.0, 1.05)}}
    return gui.add_uplot(data=data, series=series, scales=scales, aspect=1.7)


def _show(plot: Any, x: np.ndarray, curves: list[np.ndarray], names: list[str]) -> None:
    lines = (
        {"label": n, "stroke": s, "width": 2, "points": {"show": len(x) < 20}}
        for n, s in zip(names, _STROKES, strict=False)
    )
    plot.visible = True
    plot.series = ({"label": "x"}, *lines)
    plot.data = (x, *curves)


def _instance_errors(assessment: Assessment, criterion: Criterion) -> Float[np.ndarray, "n"]:
    return errors_of(assessment, criterion)[assessment.gt_index >= 0]


def _recall(errors: Float[np.ndarray, "n"], thresholds: Float[np.ndarray, "t"]) -> Float[np.ndarray, "t"]:
    """Share of the known errors below each threshold."""
    known = np.sort(errors[~np.isnan(errors)])
    return np.searchsorted(known, thresholds, side="left") / max(len(known), 1)


def _recall_by_visibility(assessment: Assessment, selection: Selection) -> Float[np.ndarray, "10"]:
    """Share of correct instances per tenth of the visible fraction, NaN where there are none."""
    instances = assessment.gt_index >= 0
    errors, visible = errors_of(assessment, selection.criterion)[instances], assessment.visible_fraction[instances]
    known = ~np.isnan(errors) & ~np.isnan(visible)
    tenth = np.clip((visible[known] * 10).astype(int), 0, 9)
    correct = np.bincount(tenth, weights=errors[known] < selection.threshold, minlength=10)
    total = np.bincount(tenth, minlength=10)
    return np.divide(correct, total, out=np.full(10, np.nan), where=total > 0)
