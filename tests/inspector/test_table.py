"""The table of targets: which rows, in which order, and what their cells say."""

from dataclasses import fields

import numpy as np
import pytest

from inspector.selection import Filter, RowKey, Selection
from inspector.table import COLUMNS, STATUSES, Table, errors_of, make_table
from pipeline.bop.assessment import Assessment

NAN, INF = float("nan"), float("inf")
DEPTHLESS = [NAN] * 6


def assessment(**columns: object) -> Assessment:
    """Six rows: correct, wrong, missing, extra, correct, one without any error."""
    plain = {
        "scene_id": [1, 1, 1, 1, 2, 2],
        "im_id": [0, 0, 1, 1, 7, 8],
        "obj_id": [5, 6, 5, 5, 6, 5],
        "gt_index": [0, 1, 0, -1, 0, 0],
        "estimate": [0, 1, -1, 2, 3, 4],
        "score": [0.9, 0.8, NAN, 0.1, 0.5, 0.4],
        "diameter": [0.1] * 6,
        "mssd": [0.01, 0.05, INF, NAN, 0.002, NAN],
        "mspd": [3.0, 150.4, INF, NAN, 1.0, NAN],
        "add": [0.005, 0.03, INF, NAN, 0.001, NAN],
        "vsd": [0.2, 0.9, 1.0, NAN, 0.1, NAN],
        "visible_fraction": [1.0, 0.4, 0.05, NAN, 0.756, NAN],
    }
    arrays = {name: np.array(columns.get(name, values)) for name, values in plain.items()}
    return Assessment(method="m", **arrays, visibility_estimated=bool(columns.get("visibility_estimated", False)))


def table_of(selection: Selection = Selection(), compared: Assessment | None = None, **columns: object) -> Table:  # noqa: B008
    return make_table(assessment(**columns), compared, selection)


def statuses(table: Table) -> list[str]:
    return [STATUSES[table.status[row]] for row in range(len(table.assessment))]


def test_every_row_has_its_status():
    assert statuses(table_of()) == ["correct", "wrong", "missing", "extra", "correct", "unknown"]


@pytest.mark.parametrize(
    ("criterion", "threshold", "expected"),
    [
        ("mssd", 0.09, ["wrong", "wrong"]),
        ("mssd", 0.11, ["correct", "wrong"]),
        ("add", 0.5, ["correct", "correct"]),
        ("mspd", 3.0, ["wrong", "wrong"]),  # strictly below
        ("vsd", 0.95, ["correct", "correct"]),
    ],
)
def test_correct_is_below_the_threshold_of_the_criterion(criterion, threshold: float, expected: list[str]):
    table = table_of(Selection(criterion=criterion).with_threshold(threshold))
    assert statuses(table)[:2] == expected


def test_errors_are_in_the_unit_of_their_threshold():
    np.testing.assert_allclose(errors_of(assessment(), "mssd")[:2], [0.1, 0.5])
    np.testing.assert_allclose(errors_of(assessment(), "add")[:2], [0.05, 0.3])
    np.testing.assert_allclose(errors_of(assessment(), "mspd")[:2], [3.0, 150.4])


def test_the_worst_comes_first_and_what_has_no_number_last():
    assert table_of().order.tolist() == [1, 0, 4, 2, 3, 5]
    assert table_of(Selection(descending=False)).order.tolist() == [4, 0, 1, 2, 3, 5]


@pytest.mark.parametrize("column", [column.id for column in COLUMNS])
def test_every_column_sorts_both_ways_with_the_unknown_last(column: str):
    values = {"image": [10, 10, 11, 11, 27, 28], "object": [5, 6, 5, 5, 6, 5], "result": [1, 2, 3, 4, 1, 0]}
    names = {"visible": "visible_fraction"}
    expected = np.array(values.get(column, getattr(assessment(), names.get(column, column), None)), float)
    for descending in (True, False):
        order = table_of(Selection(sort=column, descending=descending)).order
        assert sorted(order) == list(range(6))
        of_rows = expected[order]
        known = np.isfinite(of_rows)
        steps = np.diff(of_rows[known])
        assert (steps <= 0).all() if descending else (steps >= 0).all()
        assert not known[known.sum() :].any()


def test_an_unknown_column_sorts_by_error():
    assert table_of(Selection(sort="nonsense")).order.tolist() == table_of().order.tolist()


@pytest.mark.parametrize(
    ("wanted", "rows"),
    [
        (Filter(obj_id=6), [1, 4]),
        (Filter(scene_id=2), [4, 5]),
        (Filter(scene_id=2, obj_id=6), [4]),
        (Filter(status="wrong"), [1]),
        (Filter(status="correct"), [0, 4]),
        (Filter(status="missing"), [2]),
        (Filter(status="extra"), [3]),
        (Filter(visible_min=0.5), [0, 4]),
        (Filter(visible_max=0.5), [1, 2]),
        (Filter(obj_id=99), []),
    ],
)
def test_filters(wanted: Filter, rows: list[int]):
    assert sorted(table_of(Selection(filter=wanted)).order.tolist()) == rows


def test_two_methods_are_told_apart_instance_by_instance():
    other = assessment(mssd=[0.05, 0.001, 0.001, NAN, 0.001, 0.001], estimate=[0, 1, 2, 3, 4, 5])
    table = make_table(assessment(), other, Selection(compare=1))
    results = {int(row): table.cells(place)["cells"][-1] for place, row in enumerate(table.order)}  # type: ignore[index]
    # Fixed: right here, wrong there; broken: wrong or missing here, right there.
    assert results == {0: "fixed", 1: "broken", 2: "broken", 3: "extra", 4: "both right", 5: ""}
    fixed = make_table(assessment(), other, Selection(compare=1, filter=Filter(status="fixed")))
    assert fixed.order.tolist() == [0]
    both_wrong = make_table(assessment(), assessment(), Selection(compare=1, filter=Filter(status="both wrong")))
    assert sorted(both_wrong.order.tolist()) == [1, 2]


def test_instances_that_the_compared_method_does_not_have_are_not_compared():
    other = assessment(scene_id=[9] * 6)
    table = make_table(assessment(), other, Selection(compare=1))
    assert not table.comparison.any()


def test_cells_say_the_numbers_in_millimetres_and_pixels():
    table = table_of()
    assert table.cells(0) == {
        "cells": ["1 / 0", "6", "40", "0.80", "0.90", "50.0", "150", "30.0", "wrong"],
        "status": "wrong",
        "title": "scene 1, image 0, object 6, instance 1: wrong",
    }
    assert table.cells(3)["cells"] == ["1 / 1", "5", "5", "–", "1.00", "∞", "∞", "∞", "missing"]
    assert table.cells(4)["cells"] == ["1 / 1", "5", "–", "0.10", "–", "–", "–", "–", "extra"]
    assert "no ground truth: extra" in str(table.cells(4)["title"])


def test_visible_fractions_that_were_estimated_are_marked():
    cells = table_of(visibility_estimated=True).cells(0)["cells"]
    assert cells[2] == "~40"  # type: ignore[index]


def test_the_summary_counts_instances():
    assert table_of().summary == "2 of 4 correct (50.0 %) · 1 missing · 1 extra"
    assert table_of(Selection(filter=Filter(obj_id=99))).summary == "no rows"


def test_instances_without_depth_count_neither_as_correct_nor_as_missing_by_vsd():
    table = table_of(Selection(criterion="vsd"), vsd=[0.2, 0.9, NAN, NAN, NAN, NAN])
    assert statuses(table) == ["correct", "wrong", "unknown", "extra", "unknown", "unknown"]
    assert table.summary == "1 of 2 correct (50.0 %) · 1 extra"


def test_with_ground_truth_alone_nothing_is_missing():
    nothing = {name: DEPTHLESS for name in ("score", "mssd", "mspd", "add", "vsd")}
    table = table_of(estimate=[-1] * 6, gt_index=[0, 1, 0, 1, 0, 0], **nothing)
    assert set(statuses(table)) == {"unknown"}
    assert table.summary == "6 annotated instances; compare results with them: --results FILE"


def test_a_method_that_found_nothing_misses_everything():
    lost = {name: [INF] * 6 for name in ("mssd", "mspd", "add")}
    table = table_of(estimate=[-1] * 6, gt_index=[0, 1, 0, 1, 0, 0], score=DEPTHLESS, vsd=DEPTHLESS, **lost)
    assert set(statuses(table)) == {"missing"}
    assert table.summary == "0 of 6 correct (0.0 %) · 6 missing"


def test_keys_name_rows_and_find_them_again():
    table = table_of()
    for place in range(len(table)):
        assert table.position(table.key(place)) == place
    assert table.key(0) == RowKey(1, 0, 6, 1, -1)
    assert table.key(4) == RowKey(1, 1, 5, -1, 2)  # an extra estimate is named by its row of the file
    assert table.position(None) == -1
    assert table.position(RowKey(1, 0, 99, 1, -1)) == -1
    assert table.position(RowKey(10**30, 0, 6, 1, -1)) == -1


def test_a_row_that_is_filtered_out_has_no_position():
    selection = Selection(filter=Filter(obj_id=5))
    assert table_of(selection).position(RowKey(1, 0, 6, 1, -1)) == -1


def test_no_rows_at_all():
    ids = ("scene_id", "im_id", "obj_id", "gt_index", "estimate")
    arrays = {item.name: np.array([], np.int64 if item.name in ids else float) for item in fields(Assessment)[1:13]}
    table = make_table(Assessment(method="m", **arrays), None, Selection())
    assert len(table) == 0
    assert table.summary == "no rows"
    assert table.position(RowKey(1, 0, 6, 1, -1)) == -1
