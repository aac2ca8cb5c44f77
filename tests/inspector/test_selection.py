"""What a browser looks at, written into a URL and read back."""

from dataclasses import fields, is_dataclass
from types import UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints

from hypothesis import given
from hypothesis import strategies as st

from inspector.address import from_query, to_query
from inspector.selection import (
    DEFAULT_THRESHOLDS,
    Criterion,
    Filter,
    RowKey,
    Selection,
    Status,
    Style,
    View,
)
from inspector.table import COLUMNS


def floats(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers with the four digits that a URL keeps."""
    return st.floats(low, high).map(lambda x: float(f"{x:.4g}")).filter(lambda x: low <= x <= high)


IDS = st.integers(0, 10**7)
ROWS = st.builds(RowKey, IDS, IDS, IDS, st.integers(-1, 99), st.integers(-1, 10**6))
PARTS = {
    name: kind for name, kind in get_type_hints(Selection).items() if isinstance(kind, type) and is_dataclass(kind)
}
PIXELS = st.tuples(*[floats(0, 2000)] * 2) | st.just((-1.0, -1.0))


def values_of(kind: Any) -> st.SearchStrategy:
    """Any value of a field of this type; pixels stand for all pairs of numbers."""
    if get_origin(kind) is Literal:
        return st.sampled_from(get_args(kind))
    if get_origin(kind) is UnionType:
        return st.one_of(*map(values_of, get_args(kind)))
    plain = {bool: st.booleans(), int: IDS, float: floats(0, 1), str: st.text(max_size=20), type(None): st.none()}
    return plain.get(kind, PIXELS)


def parts_of(part: type) -> st.SearchStrategy:
    """Any value of a part of the selection."""
    return st.builds(part, **{name: values_of(kind) for name, kind in get_type_hints(part).items()})


FIELDS: dict[str, st.SearchStrategy] = {
    "dataset": st.text(max_size=20),
    "row": st.none() | ROWS,
    "method": st.integers(0, 9),
    "compare": st.none() | st.integers(0, 9),
    "criterion": st.sampled_from(get_args(Criterion)),
    "thresholds": st.tuples(*[floats(0.01, 50)] * 4),
    "tau_mm": floats(1, 100),
    "delta_mm": floats(1, 50),
    "sort": st.sampled_from(["error", *(column.id for column in COLUMNS)]),
    "descending": st.booleans(),
    "view": st.sampled_from(get_args(View)),
    "zoom": floats(0.5, 60),
    "center_u": floats(0, 1),
    "center_v": floats(0, 1),
    "follow": st.booleans(),
    "eye": st.tuples(*[floats(-9, 9)] * 6),
    "dark": st.booleans(),
    **{name: parts_of(part) for name, part in PARTS.items()},
}
SELECTIONS = st.builds(Selection, **FIELDS)
WITH_OTHER_DEFAULTS = Selection(delta_mm=5.0, compare=1)
"""What a browser begins with on ITODD with two methods."""


def names() -> list[str]:
    nested = [f"{name}.{item.name}" for name, part in PARTS.items() for item in fields(part)]
    return [item.name for item in fields(Selection)] + nested


@given(SELECTIONS)
def test_a_url_gives_the_selection_back(selection: Selection):
    assert from_query(to_query(selection)) == selection


@given(SELECTIONS)
def test_a_url_gives_the_selection_back_where_the_defaults_are_the_datasets(selection: Selection):
    query = to_query(selection, WITH_OTHER_DEFAULTS)
    assert from_query(query, WITH_OTHER_DEFAULTS) == selection


def test_every_field_takes_part_in_the_round_trip():
    assert set(FIELDS) == {item.name for item in fields(Selection)}


def test_only_what_differs_from_the_usual_is_named():
    assert to_query(Selection()) == ""
    assert to_query(Selection(row=RowKey(2, 3, 10, 5, -1), zoom=2.5)) == "row=2,3,10,5,-1&zoom=2.5"


def test_a_question_mark_may_stand_before_it():
    assert from_query("?zoom=3&view=scene") == Selection(zoom=3.0, view="scene")


def test_numbers_keep_six_digits():
    assert from_query(to_query(Selection(center_u=0.12345678))).center_u == 0.123457


@given(st.text())
def test_any_text_reads_as_a_selection(text: str):
    to_query(from_query(text))


@given(
    st.lists(
        st.tuples(
            st.sampled_from(names()),
            st.text()
            | st.sampled_from(["nan", "inf", "-inf", "1e999", "none", "", "1,2", "1,2,3,4,5", "-1", "9" * 5000])
            | st.floats().map(str)
            | st.integers().map(str),
        )
    )
)
def test_garbage_in_known_fields_never_raises_and_leaves_sound_values(pairs: list[tuple[str, str]]):
    from urllib.parse import urlencode

    found = from_query(urlencode(pairs))
    assert found.criterion in DEFAULT_THRESHOLDS
    assert found.view in get_args(View)
    assert found.filter.status in get_args(Status)
    assert found.display.style in get_args(Style)
    assert 0.2 <= found.zoom <= 200
    assert 0 <= found.display.opacity <= 1
    assert -1 <= found.center_u <= 2
    assert len(found.thresholds) == 4
    assert all(abs(value) < float("inf") for value in (*found.thresholds, found.tau_mm, found.delta_mm))
    assert from_query(to_query(found)) is not None


def test_one_bad_value_leaves_the_others():
    assert from_query("zoom=wide&row=1,2,3&method=1&filter.obj_id=6&display.style=glitter") == Selection(
        method=1, filter=Filter(obj_id=6)
    )


def test_the_threshold_is_that_of_the_criterion():
    selection = Selection(criterion="mspd").with_threshold(7.0)
    assert selection.threshold == 7.0
    assert selection.thresholds == (0.2, 7.0, 0.3, 0.1)
