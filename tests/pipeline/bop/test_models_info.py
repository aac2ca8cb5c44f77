"""models_info.json gets the symmetries, and everything else in it stays to the last character."""

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.bop.models_info.json_edit import with_members
from pipeline.bop.models_info.symmetries import entries_of, group_from
from pipeline.bop.models_info.writing import model_entry, write_symmetries
from pipeline.exceptions import FormatError, InputError
from pipeline.scene import Model
from pipeline.symmetry import symmetry_transforms
from pipeline.symmetry_search.groups import NO_SYMMETRY, Axis, Extent, SymmetryGroup

EXTENT = Extent(np.zeros(3), 0.05)
TEXT = """{
  "1": {"diameter": 102.0990, "note": "\\u00fc NaN", "symmetries_discrete": [[1, 0]], "size_x": 1e-05},
  "07": {
    "diameter": 5,
    "size_x": 3.10
  },
  "12": {"diameter": NaN}
}
"""


def quarter_turns() -> SymmetryGroup:
    axis = Axis(np.array([0.0, 0.0, 1.0]), np.array([0.001, 0.002, 0.0]))
    return SymmetryGroup(np.stack([axis.turn(k * np.pi / 2) for k in (1, 2, 3)]))


def spool() -> SymmetryGroup:
    axis = Axis(np.array([0.6, 0.8, 0.0]), np.array([0.0, 0.0, 0.0123]))
    return SymmetryGroup(Axis(np.array([0.0, 0.0, 1.0]), np.zeros(3)).turn(np.pi)[None], (axis,))


@pytest.fixture
def path(tmp_path: Path) -> Path:
    path = tmp_path / "models_info.json"
    path.write_text(TEXT, "utf-8")
    return path


@pytest.mark.parametrize("group", [quarter_turns(), spool(), NO_SYMMETRY])
def test_what_is_written_reads_back(group: SymmetryGroup):
    read = group_from(json.loads(json.dumps(entries_of(group))))
    assert read.equals(group, EXTENT)
    assert read.discrete == pytest.approx(group.discrete, abs=1e-11)
    assert len(read.continuous) == len(group.continuous)


def test_the_written_form_is_the_one_that_evaluation_reads():
    found = symmetry_transforms(entries_of(quarter_turns()))
    assert found[1:] == pytest.approx(quarter_turns().discrete, abs=1e-11)
    assert len(symmetry_transforms(entries_of(spool()))) == 2 * 315


def test_numbers_are_plain_and_in_millimetres():
    entries = entries_of(quarter_turns())
    assert entries["symmetries_discrete"][0] == [0, -1, 0, 3, 1, 0, 0, 1, 0, 0, 1, 0, 0, 0, 0, 1]
    assert "-0.0" not in json.dumps(entries)
    assert entries_of(spool())["symmetries_continuous"] == [{"axis": [0.6, 0.8, 0.0], "offset": [0.0, 0.0, 12.3]}]


def test_only_the_object_s_symmetries_change(path: Path):
    written = write_symmetries(path, {7: quarter_turns(), 1: NO_SYMMETRY}, {})
    listed = json.dumps(entries_of(quarter_turns())["symmetries_discrete"], separators=(",", ":"))
    expected = TEXT.replace(', "symmetries_discrete": [[1, 0]]', "")
    expected = expected.replace('"size_x": 3.10\n', f'"size_x": 3.10,\n    "symmetries_discrete": {listed}\n')
    assert path.read_text("utf-8") == expected
    assert written.backup == path.with_name("models_info.json.bak")
    assert written.backup.read_text("utf-8") == TEXT


def test_every_earlier_file_is_kept(path: Path):
    write_symmetries(path, {12: quarter_turns()}, {})
    second = path.read_text("utf-8")
    assert write_symmetries(path, {12: spool()}, {}).backup == path.with_name("models_info.json.bak2")
    assert path.with_name("models_info.json.bak").read_text("utf-8") == TEXT
    assert path.with_name("models_info.json.bak2").read_text("utf-8") == second


def test_nothing_is_written_where_nothing_changes(path: Path):
    write_symmetries(path, {12: spool()}, {})
    before = sorted(path.parent.iterdir())
    written = write_symmetries(path, {12: spool()}, {})
    assert (written.changed, written.backup) == (False, None)
    assert sorted(path.parent.iterdir()) == before


def test_an_object_that_is_not_listed_yet_comes_last(path: Path):
    write_symmetries(path, {3: spool()}, {3: {"diameter": 9.5}})
    text = path.read_text("utf-8")
    assert text.startswith(TEXT.rstrip("}\n "))
    assert json.loads(text)["3"] == {"diameter": 9.5, **entries_of(spool())}


def test_a_file_that_is_absent_is_made_with_sizes(tmp_path: Path):
    corners = np.array([[x, y, z] for x in (0.01, 0.04) for y in (-0.02, 0.02) for z in (0.0, 0.12)])
    model = Model(4, corners, np.zeros((1, 3), np.int32), 0.5)
    path = tmp_path / "models_info.json"
    assert write_symmetries(path, {4: spool()}, {4: model_entry(model), 5: {"diameter": 1.0}}).backup is None
    content = json.loads(path.read_text("utf-8"))
    expected = {"diameter": 130, "min_x": 10, "min_y": -20, "min_z": 0, "size_x": 30, "size_y": 40, "size_z": 120}
    assert content["4"] == {**expected, **entries_of(spool())}
    assert content["5"] == {"diameter": 1.0}


def test_a_damaged_file_is_named_and_left_as_it_is(path: Path):
    path.write_text(TEXT[:60], "utf-8")
    with pytest.raises(FormatError, match=r"models_info\.json: is no complete JSON"):
        write_symmetries(path, {1: spool()}, {})
    assert path.read_text("utf-8") == TEXT[:60]
    assert len(list(path.parent.iterdir())) == 1


def test_a_folder_that_cannot_be_written_to_is_named(tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="choose a folder that you may write to"):
        write_symmetries(tmp_path / "file" / "models_info.json", {}, {1: {"diameter": 1.0}})


@pytest.mark.parametrize(
    ("text", "changes", "expected"),
    [
        ("{}", {"a": "1"}, '{"a": 1}'),
        ('{ "a" : 1 }', {"a": "2"}, '{ "a" : 2 }'),
        ('{"a": 1, "b": 2}', {"a": None}, '{"b": 2}'),
        ('{"a": 1}', {"a": None}, "{}"),
        ('{\n  "a": 1\n}', {"b": "[1,2]"}, '{\n  "a": 1,\n  "b": [1,2]\n}'),
        ('{"a":"x,}","b":{"c":[]}}', {"b": "0", "d": "1"}, '{"a":"x,}","b":0,"d":1}'),
    ],
)
def test_members_are_set_and_removed_in_place(text: str, changes: dict, expected: str):
    assert with_members(text, changes) == expected


@pytest.mark.parametrize("text", ["[]", "", '{"a" 1}', '{"a": 1 "b": 2}'])
def test_what_is_no_object_is_refused(text: str):
    with pytest.raises(ValueError, match=r"no |Expecting"):
        with_members(text, {"a": "1"})
