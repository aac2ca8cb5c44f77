"""`inspector check` as people use it."""

import io
import json

import pytest
from rich.console import Console

from inspector.commands.check import CheckConfig, run
from pipeline.bop.results import write_results
from pipeline.exceptions import InputError
from tests.tiny_dataset import make_dataset, perfect


@pytest.fixture
def files(tmp_path):
    """A dataset, a sound file and one with two faults."""
    good, bad = tmp_path / "good_tiny-test.csv", tmp_path / "bad_tiny-test.csv"
    write_results(good, perfect())
    text = good.read_text().splitlines()
    bad.write_text("\n".join([*text[:2], text[2].replace("0.5", "[high]", 1), text[3].removesuffix("-1.0") + "3.5"]))
    return make_dataset(tmp_path / "tiny"), good, bad


def checked(*arguments, **options):
    console = Console(file=io.StringIO(), width=80)
    code = run(CheckConfig(*arguments, **options), console)
    return code, console.file.getvalue()


def test_a_file_without_errors_gives_zero(files):
    root, good, _ = files
    code, text = checked(root, (good,))
    assert code == 0
    assert text.splitlines() == [
        f"{good} (tiny/test, localization): 4 rows, 0 errors, 1 warning",
        "  warning: line 2, column score: all rows have 0.5 (3 more rows); of too many estimates those first in the file "
        "count: write confidences",
    ]


def test_all_files_are_checked_and_an_error_in_one_gives_one(files, tmp_path):
    root, good, bad = files
    code, text = checked(root, (bad, good), json=tmp_path / "found.json")
    assert code == 1
    assert f"{bad} (tiny/test, localization): 2 rows, 2 errors, 4 warnings" in text
    assert "  error: line 3, column score: '[high]' is no number; write it as digits" in text  # no markup of rich's
    assert f"{good} (tiny/test, localization): 4 rows" in text
    found = json.loads((tmp_path / "found.json").read_text())
    assert [content["ok"] for content in found] == [False, True]
    assert found[0]["findings"][0] == {
        "severity": "error",
        "kind": "no number",
        "message": "column score: '[high]' is no number",
        "fix": "write it as digits",
        "line": 3,
        "column": "score",
        "value": "[high]",
        "count": 1,
        "of": "row",
    }


def test_one_file_gives_one_object(files, tmp_path):
    root, good, _ = files
    checked(root, (good,), json=tmp_path / "found.json", task="detection")
    assert json.loads((tmp_path / "found.json").read_text())["task"] == "detection"


def test_no_file_is_an_input_error(files):
    with pytest.raises(InputError, match=r"no results file; name one or more: inspector check DATASET RESULTS\.csv"):
        checked(files[0], ())
