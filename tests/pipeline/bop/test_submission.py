"""Faults that results files have, put one by one into a file that has none."""

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.bop import results_csv
from pipeline.bop.dataset import open_dataset
from pipeline.bop.results import Results, read_results, write_results
from pipeline.bop.submission import check_submission
from pipeline.exceptions import FormatError, MissingFileError
from tests.tiny_dataset import make_dataset, perfect

HEADER = "scene_id,im_id,obj_id,score,R,t,time"
R = "1 0 0 0 1 0 0 0 1"
ROWS = (f"1,0,1,0.9,{R},-70 0 400,0.5", f"1,0,1,0.8,{R},60 -30 500,0.5", f"1,0,2,0.7,{R},0 50 450,0.5",
        f"1,1,1,0.6,{R},10 20 350,0.25")  # fmt: skip
"""One estimate for every instance of the dataset: lines 2 to 5 of a file with a header."""
FAR = f"1,1,2,0.6,{R},10 20 350,0.25"
"""An object that is not in its image."""


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return make_dataset(tmp_path_factory.mktemp("data") / "tiny")


@pytest.fixture(scope="module")
def dataset(root):
    return open_dataset(root)


def written(folder: Path, *rows: str, name="method_tiny-test.csv", header: str | None = HEADER, newline="\n") -> Path:
    path = folder / name
    path.write_bytes("".join(line + newline for line in ((header, *rows) if header else rows)).encode())
    return path


def changed(*changes: tuple[int, int, str]) -> list[str]:
    """The good rows with other fields: row from 0, column from 0, text."""
    rows = [row.split(",") for row in ROWS]
    for row, column, text in changes:
        rows[row][column] = text
    return [",".join(row) for row in rows]


def with_targets(root: Path, entries: list[dict], name="test_targets_bop19.json") -> Path:
    (root / name).write_text(json.dumps(entries))
    return root


def target(im_id: int, obj_id: int | None = None, inst_count: int = 1, scene_id: int = 1) -> dict:
    image = {"scene_id": scene_id, "im_id": im_id}
    return image if obj_id is None else image | {"obj_id": obj_id, "inst_count": inst_count}


def test_a_sound_file_has_no_findings(dataset, tmp_path):
    path = written(tmp_path, *ROWS)
    check = check_submission(dataset, path)
    assert check.lines() == []
    assert check.ok
    assert check.rows == 4
    assert check.results is not None
    assert check.results.translation_mm.tolist() == read_results(path).translation_mm.tolist()
    assert (check.results.method, check.results.dataset_name, check.results.split) == ("method", "tiny", "test")


# Rows, the line as people see it. Line 5 is image 1, the others are image 0.
FAULTS = {
    "not finite": (changed((1, 5, "1 nan 3")), "error: line 3, column t: holds nan; expected finite numbers"),
    "numbers": (changed((1, 4, "1 0 0")), "error: line 3, column R: has 3 numbers; expected 9 numbers separated by spaces"),
    "no number": (changed((3, 3, "high")), "error: line 5, column score: 'high' is no number; write it as digits"),
    "columns": (changed((0, 6, "0.5,1")), f"error: line 2, 8 columns; expected 7 ({HEADER}), with spaces inside R and t"),
    "id": (changed((2, 2, "-2")), "error: line 4, column obj_id: is -2; expected a whole number from 0"),
    "id spelling": (changed((2, 2, "2.0")), "error: line 4, column obj_id: 2.0 is not written as a whole number; write 2"),
    "no rotation": (changed((0, 4, "0 0 0 0 0 0 0 0 0")), "error: line 2, column R: 0 0 0 0 0 0 0 0 0 is no rotation (its "
                    "determinant is 0); expected a 3x3 rotation matrix row by row"),
    "second header": ([*ROWS[:2], HEADER, *ROWS[2:]], "error: line 4, column scene_id: 'scene_id' is no number; remove "
                      "this second header"),
    "blank line": ([*ROWS, ""], "error: line 6, is blank; remove it: BOP's reader stops at a blank line"),
    "no rows": ([], "error: it holds no estimates; write a row for each estimate: BOP refuses a file without any"),
    "time differs": (changed((2, 6, "0.6")), "error: line 4, column time: 0.6 s, but line 2 has 0.5 s for the same image "
                     "(scene 1, image 0); write in all rows of an image the seconds for the whole image: BOP refuses the file"),
    "time missing": (changed((3, 6, "-1")), "warning: line 5, column time: -1, others are measured; BOP then gives no "
                     "average time at all: measure every image"),
    "time zero": (changed(*((row, 6, "0") for row in range(4))), "warning: line 2, column time: 0 s in every row (3 more "
                  "rows); write seconds, or -1 where not measured"),
    "unknown scene": ([*ROWS, FAR.replace("1,1,", "7,1,", 1)], "warning: line 6, column scene_id: scene 7 is not in "
                      "tiny/test; BOP ignores it: remove it, or mend the ids"),
    "unknown image": ([*ROWS, FAR.replace("1,1,", "1,9,", 1)], "warning: line 6, column im_id: scene 1, image 9 is not in "
                      "tiny/test; BOP ignores it: remove it, or mend the ids"),
    "unknown object": ([*ROWS, FAR.replace("1,1,2", "1,1,3")], "warning: line 6, column obj_id: object 3 is not in "
                       "tiny/test; BOP ignores it: remove it, or mend the ids"),
    "image without target": ([*ROWS, FAR.replace("1,1,", "2,5,", 1)], "warning: line 6, column im_id: nothing is asked "
                             "for in scene 2, image 5; BOP ignores it: remove it, or mend the ids"),
    "object without target": ([*ROWS, FAR], "warning: line 6, column obj_id: object 2 is not asked for in scene 1, "
                              "image 1; BOP ignores it: remove it, or mend the ids"),
    "targets without estimate": (ROWS[:2], "warning: 2 of 3 targets have no estimate, the first is object 2 of scene 1, "
                                 "image 0; they count as missed"),
    "fewer than instances": (ROWS[1:], "warning: 1 of 3 targets have fewer estimates than instances, the first is object 1 "
                             "of scene 1, image 0; the other instances count as missed"),
    "more than instances": ([f"1,1,1,0.5,{R},9 9 9,0.25", *ROWS], "warning: line 2, object 1 of scene 1, image 1 has 2 "
                            "estimates for 1 instance; BOP ignores those of lowest score, such as this one"),
    "mirrored": (changed((1, 4, "1 0 0 0 1 0 0 0 -1")), "warning: line 3, column R: mirrors the object (determinant < 0); "
                 "check how R is made, it must be a rotation matrix row by row (determinant 1)"),
    "not orthonormal": (changed((1, 4, "1 0 0 0 1.02 0 0 0 1")), "warning: line 3, column R: is not orthonormal (|R R^T - "
                        "I| is 0.04, above 0.01); it is scored as it stands: write rotations"),
    "behind the camera": (changed((1, 5, "60 -30 -500"), (2, 5, "0 50 0")), "warning: line 3, column t: z is -500 mm, not "
                          "in front of the camera (1 more row); objects in an image have z > 0, in the frame of OpenCV: "
                          "check the direction of the pose"),
    "units": (changed(*((row, 5, f"0 0.05 0.4{row}") for row in range(4))), "warning: line 2, column t: half of all z are "
              "below 0.415 mm, so it is in metres (3 more rows); multiply t by 1000: BOP has millimetres"),
    "repeated": ([ROWS[0], ROWS[0].replace("0.9", "0.8"), *ROWS[2:]], "warning: line 3, the same pose of the same object "
                 "as in line 2; remove it: every row counts as an estimate"),
    "scores equal": (changed(*((row, 3, "1") for row in range(4))), "warning: line 2, column score: all rows have 1 (3 "
                     "more rows); of too many estimates those first in the file count: write confidences"),
}  # fmt: skip
ALSO = {"no number", "numbers", "columns", "not finite", "id", "no rotation"}
"""Faults of rows that cannot be read, so that their targets are without estimates too."""


@pytest.mark.parametrize("kind", FAULTS)
def test_every_fault_is_told_in_one_line_with_line_column_value_and_fix(dataset, tmp_path, kind):
    rows, line = FAULTS[kind]
    check = check_submission(dataset, written(tmp_path, *rows))
    assert line in check.lines()
    others = {finding.kind for finding in check.findings} - {kind}
    assert not others - {"targets without estimate", "fewer than instances"}
    assert not others or kind in ALSO | {"targets without estimate"}
    assert check.ok == line.startswith("warning")
    unreadable = kind in ALSO | {"second header"}
    assert (check.results is None) == unreadable


def test_a_negative_time_that_is_not_minus_one_is_odd(dataset, tmp_path):
    times = [(row, 6, "-2") for row in range(4)]
    check = check_submission(dataset, written(tmp_path, *changed(*times)))
    assert check.lines() == [
        "warning: line 2, column time: -2 s (3 more rows); write seconds, or -1 where not measured"
    ]
    all_unknown = [(row, 6, "-1") for row in range(4)]
    assert not check_submission(dataset, written(tmp_path, *changed(*all_unknown))).findings


def test_times_of_an_image_may_differ_by_a_millisecond(dataset, tmp_path):
    assert not check_submission(dataset, written(tmp_path, *changed((1, 6, "0.5009")))).findings
    check = check_submission(dataset, written(tmp_path, *changed((1, 6, "0.5011"))))
    assert [finding.kind for finding in check.errors] == ["time differs"]


def test_of_too_many_estimates_those_first_in_the_file_stay_where_scores_are_equal(dataset, tmp_path):
    rows = [*ROWS, f"1,1,1,0.6,{R},9 9 9,0.25", f"1,1,1,0.6,{R},9 9 8,0.25"]
    (finding,) = check_submission(dataset, written(tmp_path, *rows)).findings
    assert (finding.kind, finding.line, finding.count) == ("more than instances", 6, 2)


def test_distances_too_large_for_millimetres_are_told(dataset, tmp_path):
    rows = changed(*((row, 5, f"0 50 {row}00000") for row in range(1, 4)), (0, 5, "0 0 90000"))
    (finding,) = check_submission(dataset, written(tmp_path, *rows)).findings
    assert finding.text.startswith("line 2, column t: half of all z are above 150 m (3 more rows); bring t to mill")


@pytest.mark.parametrize(
    ("header", "newline", "blank_before"), [(None, "\n", 0), (HEADER, "\r\n", 2), (None, "\r\n", 3), (HEADER, "\n", 0)]
)
@pytest.mark.parametrize("small_bytes", [0, 1 << 20])
def test_lines_are_right_in_any_file(dataset, tmp_path, monkeypatch, header, newline, blank_before, small_bytes):
    monkeypatch.setattr(results_csv, "SMALL_BYTES", small_bytes)
    monkeypatch.setattr(results_csv, "BLOCK_BYTES", 70)
    rows = changed((2, 5, "0 50 -450"), (3, 3, "nan"))
    path = written(tmp_path, *[""] * blank_before, *rows, header=header, newline=newline)
    lines = {finding.kind: finding.line for finding in check_submission(dataset, path).findings}
    first = blank_before + (2 if header else 1)
    assert lines["behind the camera"] == first + 2
    assert lines["not finite"] == first + 3
    assert lines.get("blank line") == ((2 if header else 1) if blank_before else None)
    assert ("no header" in lines) == (header is None)


@pytest.mark.parametrize(
    ("header", "text"),
    [
        ("im_id,scene_id,obj_id,score,R,t,time", "error: line 1, the header has the columns in another order; write"),
        ('"scene_id","im_id","obj_id","score","R","t","time"', "error: line 1, the header is written in another way;"),
        ("scene_id,im_id,obj_id,score,R,t", "error: line 1, column time is missing; the header must be scene_id,im_id"),
        (
            None,
            "warning: line 1, the first line is no header; begin the file with scene_id,im_id,obj_id,score,R,t,time",
        ),
    ],
)
def test_headers_that_bop_does_not_take(dataset, tmp_path, header, text):
    check = check_submission(dataset, written(tmp_path, *ROWS, header=header))
    assert check.lines()[0].startswith(text)


@pytest.mark.parametrize(
    ("content", "text"),
    [
        (b"", "error: is empty; expected the header scene_id"),
        (b"PK\x03\x04\0\0\0", "error: is no text file; expected CSV with the columns scene_id"),
        (b"hello\n", "error: line 1, column im_id is missing; expected scene_id"),
    ],
)
def test_files_of_another_kind_are_an_error_and_no_exception(dataset, tmp_path, content, text):
    path = tmp_path / "method_tiny-test.csv"
    path.write_bytes(content)
    check = check_submission(dataset, path)
    assert check.lines()[0].startswith(text)
    assert (check.results, check.rows) == (None, 0)


def test_too_many_rows_are_an_error(dataset, tmp_path):
    check = check_submission(dataset, written(tmp_path, *ROWS * 5), max_rows=10)
    (finding,) = check.findings
    assert finding.text.startswith("holds about 2")
    assert "at most 10 are read; keep the 100 estimates" in finding.text
    assert check.results is None


def test_an_absent_file_is_an_input_error(dataset, tmp_path):
    with pytest.raises(MissingFileError, match=r"none\.csv: no such file"):
        check_submission(dataset, tmp_path / "none.csv")


@pytest.mark.parametrize(
    ("name", "lines"),
    [
        ("method_tiny-test_some-id.csv", []),
        ("method_tiny-test-primesense.csv", []),
        ("results.csv", ["error: the name results.csv is not of the form METHOD_DATASET-SPLIT.csv (no dot or underscore "
                         "in METHOD); rename it, say to results_tiny-test.csv"]),
        ("my_method.v2_tiny-test.csv", ["error: the name my_method.v2_tiny-test.csv is not of the form METHOD_DATASET-"
                                        "SPLIT.csv (no dot or underscore in METHOD); rename it, say to "
                                        "my-method-v2_tiny-test.csv"]),
        ("method_lmo-test.csv", ["error: by its name method_lmo-test.csv is for lmo, but it is checked against tiny; give "
                                 "the dataset lmo, or the right file"]),
        ("method_tiny-val.csv", ["warning: by its name method_tiny-val.csv is for the split val, but it is checked against "
                                 "test; give that split, or the right file"]),
    ],
)  # fmt: skip
def test_names_are_judged_as_bop_reads_them(dataset, tmp_path, name, lines):
    assert check_submission(dataset, written(tmp_path, *ROWS, name=name)).lines() == lines


def test_an_upload_has_the_name_that_it_came_with(dataset, tmp_path):
    path = written(tmp_path, *ROWS, name="upload.tmp")
    assert check_submission(dataset, path).errors
    check = check_submission(dataset, path, name="other_tiny-test.csv")
    assert check.ok
    assert check.results is not None
    assert check.results.method == "other"
    assert check_submission(dataset, path, name="").ok


def test_a_dataset_with_underscores_in_its_name_can_be_named(tmp_path):
    dataset = open_dataset(make_dataset(tmp_path / "my_parts"))
    assert check_submission(dataset, written(tmp_path, *ROWS, name="method_my_parts-test.csv")).lines() == []


def test_a_file_of_which_nothing_matches_is_told_once_with_both_names(dataset, tmp_path):
    rows = [row.replace("1,", "48,", 1) for row in ROWS]
    check = check_submission(dataset, written(tmp_path, *rows, name="method_lmo-test.csv"))
    assert [finding.kind for finding in check.findings] == ["other dataset", "nothing matches"]
    assert check.lines()[1] == (
        "error: line 2, no row of 4 is for a target of tiny/test (by its name the file is for lmo): column scene_id: "
        "scene 48 is not in tiny/test (3 more rows); give the dataset and split that the file is for"
    )


def test_estimates_for_targets_that_are_not_on_disk_are_not_taken_for_wrong_ids(tmp_path):
    listed = [target(0, 1, 2), target(0, 2), target(1, 1), target(2, 1), target(3, 1)]
    dataset = open_dataset(with_targets(make_dataset(tmp_path / "tiny"), listed))
    rows = [*ROWS, FAR.replace("1,1,2", "1,3,1"), FAR.replace("1,1,2", "1,4,1")]
    found = {finding.kind: finding.text for finding in check_submission(dataset, written(tmp_path, *rows)).findings}
    assert found == {
        "image not on disk": "line 6, scene 1, image 3 is a target, but is not on disk; it cannot be scored here: get the "
        "whole split",
        "unknown image": "line 7, column im_id: scene 1, image 4 is not in tiny/test; BOP ignores it: remove it, or mend "
        "the ids",
    }
    absent = written(tmp_path, FAR.replace("1,1,2", "1,3,1"))
    (finding,) = check_submission(dataset, absent).findings
    assert finding.kind == "nothing matches"
    assert finding.fix.startswith("get the whole split")


def test_the_list_of_targets_decides_not_the_ground_truth(tmp_path):
    dataset = open_dataset(with_targets(make_dataset(tmp_path / "tiny"), [target(0, 1, 1), target(5, 2, scene_id=2)]))
    kinds = [finding.kind for finding in check_submission(dataset, written(tmp_path, *ROWS)).findings]
    assert kinds == [
        "image without target",
        "object without target",
        "targets without estimate",
        "more than instances",
    ]


def test_a_damaged_list_of_targets_is_no_fault_of_the_file(tmp_path):
    dataset = open_dataset(with_targets(make_dataset(tmp_path / "tiny"), [target(0, 1), {"scene_id": 1}]))
    with pytest.raises(
        FormatError, match=r"test_targets_bop19\.json: target 1: im_id is None; expected a whole number"
    ):
        check_submission(dataset, written(tmp_path, *ROWS))


def test_without_targets_only_images_and_models_count(tmp_path):
    root = make_dataset(tmp_path / "tiny")
    for path in root.glob("test/*/scene_gt*.json"):
        path.unlink()
    check = check_submission(open_dataset(root), written(tmp_path, *ROWS, FAR.replace("1,1,2", "1,1,9")))
    assert [finding.kind for finding in check.findings] == ["unknown object", "no targets"]
    assert check.lines()[1].startswith("warning: tiny/test has neither a list of targets nor ground truth")


def test_siso_asks_for_one_instance_of_each_object(dataset, tmp_path):
    (finding,) = check_submission(dataset, written(tmp_path, *ROWS), "siso").findings
    assert finding.text.startswith("line 3, object 1 of scene 1, image 0 has 2 estimates for 1 instance;")
    assert check_submission(dataset, written(tmp_path, *ROWS[1:]), "siso").lines() == []


def test_siso_takes_the_list_of_its_own_year(tmp_path):
    root = with_targets(make_dataset(tmp_path / "tiny"), [target(0, 2)])
    dataset = open_dataset(with_targets(root, [target(1, 1)], "test_targets_bop18.json"))
    path = written(tmp_path, *ROWS[2:])
    for task, line in (("localization", 3), ("siso", 2)):
        (finding,) = check_submission(dataset, path, task).findings
        assert (finding.kind, finding.line) == ("image without target", line)


def test_detection_knows_images_and_no_instances(tmp_path):
    root = with_targets(make_dataset(tmp_path / "tiny"), [target(1), target(5, scene_id=2)], "test_targets_bop24.json")
    rows = [f"1,1,{1 + i % 2},{1 - i / 1000},{R},{i} 0 500,0.5" for i in range(103)]
    check = check_submission(open_dataset(root), written(tmp_path, *rows), "detection")
    assert check.lines() == [
        "warning: 1 of 2 images have no estimate, the first is scene 2, image 5; all their objects count as missed",
        "warning: line 102, scene 1, image 1 has 103 estimates, above 100 (2 more rows); BOP ignores those of lowest "
        "score, such as this one",
    ]
    check = check_submission(open_dataset(root), written(tmp_path, *rows[:9], ROWS[0]), "detection")
    assert [finding.kind for finding in check.findings] == ["image without target", "images without estimate"]


def test_errors_come_first_and_kinds_only_once(dataset, tmp_path):
    rows = [*changed((0, 6, "9"), (1, 5, "1 2 -3"), (2, 5, "1 2 -3"), (3, 3, "x")), FAR, f"1,1,1,y,{R},1 2 3,1"]
    check = check_submission(dataset, written(tmp_path, *rows, header=None, name="a.csv"))
    assert [finding.severity for finding in check.findings] == ["error"] * 3 + ["warning"] * 4
    assert [finding.kind for finding in check.errors] == ["file name", "no number", "time differs"]
    assert [finding.kind for finding in check.warnings] == [
        "no header",
        "object without target",
        "targets without estimate",
        "behind the camera",
    ]
    found = {finding.kind: finding for finding in check.findings}
    assert (found["no number"].line, found["no number"].count, found["no number"].value) == (4, 2, "x")
    assert (found["behind the camera"].line, found["behind the camera"].count) == (2, 2)
    content = json.loads(json.dumps(check.as_dict()))
    assert content["findings"][1]["column"] == "score"
    assert (content["ok"], content["rows"], content["task"]) == (False, 4, "localization")


def test_the_same_poses_are_found_among_many(dataset, tmp_path):
    rng = np.random.default_rng(0)
    n = 3000
    poses = np.stack([np.eye(3), np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1])])[rng.integers(0, 3, n)]
    t = rng.integers(1, 6, (n, 3)) * 100.0
    ones = np.ones(n, np.int64)
    write_results(tmp_path / "m_tiny-test.csv", Results(ones, ones, ones, rng.random(n), poses, t, -np.ones(n)))
    found = {finding.kind: finding for finding in check_submission(dataset, tmp_path / "m_tiny-test.csv").findings}
    unique = np.unique(np.concatenate([poses.reshape(n, 9), t], axis=1), axis=0)
    assert found["repeated"].count == n - len(unique)


def test_perfect_estimates_pass(dataset, tmp_path):
    write_results(tmp_path / "perfect_tiny-test.csv", perfect())
    check = check_submission(dataset, tmp_path / "perfect_tiny-test.csv")
    assert [finding.kind for finding in check.findings] == ["scores equal"]


def test_a_real_submission_passes(lmo):
    check = check_submission(open_dataset(lmo), lmo / "results" / "megapose_lmo-test.csv")
    assert check.ok
    assert [(finding.kind, finding.count) for finding in check.findings] == [
        ("targets without estimate", 61),
        ("more than instances", 111),
    ]


def test_a_real_submission_is_told_from_that_of_another_dataset(lmo, shared_data):
    check = check_submission(open_dataset(lmo), shared_data / "icbin" / "results" / "megapose_icbin-test.csv")
    assert [finding.kind for finding in check.errors] == ["other dataset", "nothing matches"]
