"""The table of targets: which rows pass the filter, in which order, and what their cells say."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from inspector.selection import Criterion, Filter, RowKey, Selection
from pipeline.bop.assessment import NO_OBJECT, Assessment
from pipeline.scene import ImageKey


class Column(NamedTuple):
    """A column of the table."""

    id: str
    label: str
    title: str
    """Explanation shown when the mouse rests on it."""


COLUMNS = (
    Column("image", "image", "scene / image"),
    Column("object", "obj", "object id"),
    Column("visible", "vis %", "visible fraction of the object, percent; ~ from the annotated models alone"),
    Column("score", "score", "the method's confidence"),
    Column("vsd", "VSD", "visible surface discrepancy, tau 20 mm, needs depth"),
    Column("mssd", "MSSD", "maximum symmetry-aware surface distance, mm"),
    Column("mspd", "MSPD", "maximum symmetry-aware projection distance, px at 640 px width"),
    Column("add", "ADD", "average distance of vertices, mm; ADI for objects with symmetries"),
    Column("result", "result", "correct or not under the chosen criterion and threshold"),
)

STATUSES = ("unknown", "correct", "wrong", "missing", "extra")
COMPARISONS = ("", "both right", "fixed", "broken", "both wrong")
"""The inspected method against the compared one: fixed is right where the compared one is wrong, broken the reverse."""


@dataclass(frozen=True)
class Table:
    """The rows that one browser sees, in its order."""

    assessment: Assessment
    error: Float[np.ndarray, "n"]
    """Under the chosen criterion: fractions of the diameter (MSSD, ADD), pixels (MSPD), 0..1 (VSD)."""
    status: Int[np.ndarray, "n"]
    """Index into STATUSES."""
    comparison: Int[np.ndarray, "n"]
    """Index into COMPARISONS; 0 without a compared method."""
    order: Int[np.ndarray, "m"]
    """Rows of the assessment that are shown, first to last."""

    def __len__(self) -> int:
        return len(self.order)

    def key(self, position: int) -> RowKey:
        """Name the row at a position of the table."""
        a, row = self.assessment, int(self.order[position])
        extra = int(a.gt_index[row]) < 0
        estimate = int(a.estimate[row]) if extra else -1
        return RowKey(int(a.scene_id[row]), int(a.im_id[row]), int(a.obj_id[row]), int(a.gt_index[row]), estimate)

    def position(self, key: RowKey | None) -> int:
        """Return where a row stands, -1 if it is not shown."""
        if key is None:
            return -1
        a, rows = self.assessment, self.order
        found = (a.scene_id[rows] == key.scene_id) & (a.im_id[rows] == key.im_id) & (a.obj_id[rows] == key.obj_id)
        found &= a.gt_index[rows] == key.gt_index
        if key.gt_index < 0:
            found &= a.estimate[rows] == key.estimate
        places = found.nonzero()[0]
        return int(places[0]) if len(places) else -1

    def instance(self, image: ImageKey, gt_index: int) -> int:
        """Return where an annotated instance stands, -1 if it is not shown."""
        a, rows = self.assessment, self.order
        found = (a.scene_id[rows] == image.scene_id) & (a.im_id[rows] == image.im_id) & (a.gt_index[rows] == gt_index)
        places = found.nonzero()[0]
        return int(places[0]) if len(places) else -1

    def cells(self, position: int) -> dict[str, object]:
        """Return what the page draws for the row at a position: texts of the cells, a class and an explanation."""
        a, row = self.assessment, int(self.order[position])
        status = STATUSES[self.status[row]]
        comparison = COMPARISONS[self.comparison[row]]
        texts = [
            f"{a.scene_id[row]} / {a.im_id[row]}",
            "–" if a.obj_id[row] == NO_OBJECT else str(a.obj_id[row]),
            _text(a.visible_fraction[row] * 100, "~{:.0f}" if a.visibility_estimated else "{:.0f}"),
            _text(a.score[row], "{:.2f}"),
            _text(a.vsd[row], "{:.2f}"),
            _number(a.mssd[row] * 1000),
            _number(a.mspd[row]),
            _number(a.add[row] * 1000),
            comparison or _result(a, row, status),
        ]
        instance = f"instance {a.gt_index[row]}" if a.gt_index[row] >= 0 else "no ground truth"
        title = f"scene {a.scene_id[row]}, image {a.im_id[row]}, object {a.obj_id[row]}, {instance}: {status}"
        return {"cells": texts, "status": status, "title": title}

    @property
    def summary(self) -> str:
        """One line on the rows shown."""
        counts = {name: int(np.count_nonzero(self.status[self.order] == i)) for i, name in enumerate(STATUSES)}
        instances = counts["correct"] + counts["wrong"] + counts["missing"]
        if len(self) and (self.assessment.obj_id == NO_OBJECT).all():
            return f"{len(self)} images, no ground truth and no results: open them with --results FILE"
        if not instances and len(self) and (self.assessment.estimate < 0).all():
            return f"{len(self)} annotated instances; compare results with them: --results FILE"
        if not instances:
            return f"{len(self)} rows, no ground truth to compare with" if len(self) else "no rows"
        share = 100 * counts["correct"] / instances
        parts = [f"{counts['correct']} of {instances} correct ({share:.1f} %)"]
        parts += [f"{counts[name]} {name}" for name in ("missing", "extra") if counts[name]]
        return " · ".join(parts)


def make_table(assessment: Assessment, compared: Assessment | None, selection: Selection) -> Table:
    """Filter and sort the rows of a method as a browser asks for."""
    error = errors_of(assessment, selection.criterion)
    status = _status(assessment, error, selection.threshold)
    comparison = np.zeros(len(assessment), np.int64)
    if compared is not None:
        comparison = _compare(assessment, status, compared, selection)
    rows = np.flatnonzero(_passes(assessment, status, comparison, selection.filter))
    order = _sorted(rows, _sort_values(assessment, error, status, comparison, selection.sort), selection.descending)
    return Table(assessment, error, status, comparison, order)


def errors_of(assessment: Assessment, criterion: Criterion) -> Float[np.ndarray, "n"]:
    """Return the errors under a criterion in the unit of its threshold."""
    if criterion in ("mssd", "add"):
        return getattr(assessment, criterion) / assessment.diameter
    return getattr(assessment, criterion)


def _status(assessment: Assessment, error: Float[np.ndarray, "n"], threshold: float) -> Int[np.ndarray, "n"]:
    known = ~np.isnan(error)
    status = np.where(known, np.where(error < threshold, 1, 2), 0)
    status[(assessment.estimate < 0) & (assessment.gt_index >= 0) & known] = 3
    annotated = set(zip(*_images(assessment, assessment.gt_index >= 0), strict=True))
    for row in np.flatnonzero(assessment.gt_index < 0):
        image = (int(assessment.scene_id[row]), int(assessment.im_id[row]))
        status[row] = 4 if image in annotated else 0
    return status


def _compare(
    assessment: Assessment, status: Int[np.ndarray, "n"], compared: Assessment, selection: Selection
) -> Int[np.ndarray, "n"]:
    """Index into COMPARISONS for every annotated instance that both methods were held against."""
    other_status = _status(compared, errors_of(compared, selection.criterion), selection.threshold)
    right = dict(zip(_instances(compared), (other_status == 1).tolist(), strict=True))
    known = dict(zip(_instances(compared), (other_status > 0).tolist(), strict=True))
    result = np.zeros(len(assessment), np.int64)
    for row, instance in enumerate(_instances(assessment)):
        if status[row] in (1, 2, 3) and instance[3] >= 0 and known.get(instance, False):
            result[row] = 1 + (0 if right[instance] else 1) if status[row] == 1 else (3 if right[instance] else 4)
    return result


def _images(assessment: Assessment, rows: Bool[np.ndarray, "n"]) -> tuple[list[int], list[int]]:
    return assessment.scene_id[rows].tolist(), assessment.im_id[rows].tolist()


def _instances(assessment: Assessment) -> list[tuple[int, int, int, int]]:
    a = assessment
    return list(zip(a.scene_id.tolist(), a.im_id.tolist(), a.obj_id.tolist(), a.gt_index.tolist(), strict=True))


def _passes(
    assessment: Assessment, status: Int[np.ndarray, "n"], comparison: Int[np.ndarray, "n"], wanted: Filter
) -> Bool[np.ndarray, "n"]:
    passes = np.ones(len(assessment), bool)
    if wanted.obj_id is not None:
        passes &= assessment.obj_id == wanted.obj_id
    if wanted.scene_id is not None:
        passes &= assessment.scene_id == wanted.scene_id
    if wanted.status in STATUSES:
        passes &= status == STATUSES.index(wanted.status)
    elif wanted.status in COMPARISONS:
        passes &= comparison == COMPARISONS.index(wanted.status)
    if (wanted.visible_min, wanted.visible_max) != (0.0, 1.0):
        visible = assessment.visible_fraction
        passes &= (visible >= wanted.visible_min) & (visible <= wanted.visible_max)
    return passes


def _sort_values(
    assessment: Assessment,
    error: Float[np.ndarray, "n"],
    status: Int[np.ndarray, "n"],
    comparison: Int[np.ndarray, "n"],
    column: str,
) -> Float[np.ndarray, "n"]:
    a = assessment
    values = {
        "image": a.scene_id * 1e7 + a.im_id,
        "object": a.obj_id,
        "visible": a.visible_fraction,
        "score": a.score,
        "vsd": a.vsd,
        "mssd": a.mssd,
        "mspd": a.mspd,
        "add": a.add,
        "result": status + 10 * comparison,
    }
    return np.asarray(values.get(column, error), dtype=float)


def _sorted(rows: Int[np.ndarray, "m"], values: Float[np.ndarray, "n"], descending: bool) -> Int[np.ndarray, "m"]:
    """Sort rows by their values, stably; what is unknown or infinite (no estimate) comes last either way."""
    of_rows = values[rows]
    known = np.isfinite(of_rows)
    by_value = np.argsort(-of_rows[known] if descending else of_rows[known], kind="stable")
    return np.concatenate([rows[known][by_value], rows[~known]])


def _result(assessment: Assessment, row: int, status: str) -> str:
    if status != "unknown":
        return status
    return "no truth" if assessment.gt_index[row] < 0 and assessment.obj_id[row] != NO_OBJECT else ""


def _number(value: float) -> str:
    return _text(value, "{:.0f}" if value >= 100 else "{:.1f}")


def _text(value: float, form: str) -> str:
    if np.isnan(value):
        return "–"
    return "∞" if np.isinf(value) else form.format(value)
