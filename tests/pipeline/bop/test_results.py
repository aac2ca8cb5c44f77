import os
import random
import struct
import tracemalloc

import numpy as np
import pytest

from pipeline.bop import results_csv
from pipeline.bop.results import Results, read_results, scan_results, write_results
from pipeline.exceptions import FormatError, InputError, MissingFileError
from pipeline.scene import ImageKey, PoseEstimate

HEADER = "scene_id,im_id,obj_id,score,R,t,time"
R = "1 0 0 0 1 0 0 0 1"
COLUMNS = ("scene_id", "im_id", "obj_id", "score", "rotation", "translation_mm", "time_s")


@pytest.fixture(params=["row by row", "all at once"], autouse=True)
def way(request, monkeypatch):
    """Files of any size are read in both ways."""
    monkeypatch.setattr(results_csv, "SMALL_BYTES", 0 if request.param == "all at once" else 1 << 40)


def written(tmp_path, *rows, header=HEADER, name="method_lmo-test.csv", newline="\n"):
    path = tmp_path / name
    path.write_bytes(newline.join([*([header] if header else []), *rows]).encode())
    return path


def assert_same(a, b):
    for column in COLUMNS:
        assert np.array_equal(getattr(a, column), getattr(b, column)), column


def test_a_row_is_read_as_it_stands(tmp_path):
    results = read_results(written(tmp_path, f"2,3,5,0.25,{R},1.5 -2 1000.125,0.5"))
    assert (results.scene_id[0], results.im_id[0], results.obj_id[0], results.score[0]) == (2, 3, 5, 0.25)
    assert results.scene_id.dtype == np.int64
    assert np.array_equal(results.rotation[0], np.eye(3))
    assert results.translation_mm.tolist() == [[1.5, -2.0, 1000.125]]
    assert results.time_s.tolist() == [0.5]
    assert results.estimates(ImageKey(2, 3))[0].camera_from_model[:3, 3].tolist() == [0.0015, -0.002, 1.000125]


def test_rotations_are_not_repaired(tmp_path):
    row = "0.99 0.1 0 0 1.02 0 0 0 0.97"
    results = read_results(written(tmp_path, f"1,1,1,1,{row},0 0 1,-1"))
    assert results.rotation.ravel().tolist() == [float(x) for x in row.split()]


@pytest.mark.parametrize(
    "text",
    [
        f"\ufeff{HEADER}\n1,2,3,0.5,{R},1 2 3,-1\n",
        f"{HEADER}\r\n1,2,3,0.5,{R},1 2 3,-1\r\n",
        f"1,2,3,0.5,{R},1 2 3,-1",
        f"{HEADER.replace(',', ' , ')}\n\n 1, 2, 3, 0.5,  {R.replace(' ', '  ')} , 1 2 3 , -1 \n\n",
        f"score,R,t,time,scene_id,im_id,obj_id\n0.5,{R},1 2 3,-1,1,2,3",
        f"{HEADER}\r1,2,3,0.5,{R},1 2 3,-1\r",
        f"\n\n{HEADER}\n01,2.0,+3,.5,{R.replace('1', '1.')},1e0 2E0 3_0e-1,-1",
        f"note,score,R,t,time,scene_id,im_id,obj_id\nfirst try,0.5,{R},1 2 3,-1,1,2,3",
    ],
    ids=[
        "byte order mark",
        "CRLF",
        "no header",
        "spaces and blank lines",
        "other order of columns",
        "CR",
        "other ways to write numbers",
        "another column",
    ],
)
def test_what_spreadsheets_do_to_a_file_is_tolerated(tmp_path, text):
    path = tmp_path / "odd.csv"
    path.write_bytes(text.encode())
    assert_same(read_results(path), read_results(written(tmp_path, f"1,2,3,0.5,{R},1 2 3,-1")))


def test_estimates_come_by_falling_score_and_ties_in_the_order_of_the_file(tmp_path):
    scores = [0.1, 0.9, 0.5, 0.9]
    rows = [
        f"1,{im},{obj},{s},{R},{i} 0 0,-1"
        for i, (im, obj, s) in enumerate(zip((7, 7, 7, 7), (1, 2, 1, 1), scores, strict=True))
    ]
    results = read_results(written(tmp_path, f"1,8,1,1,{R},9 0 0,-1", *rows, f"2,7,1,1,{R},8 0 0,-1"))
    assert [e.camera_from_model[0, 3] * 1000 for e in results.estimates(ImageKey(1, 7))] == pytest.approx([1, 3, 2, 0])
    assert [e.score for e in results.estimates(ImageKey(1, 7), obj_id=1)] == [0.9, 0.5, 0.1]
    assert results.estimates(ImageKey(1, 9)) == ()
    assert results.estimates(ImageKey(5, 7)) == ()
    assert results.images() == (ImageKey(1, 7), ImageKey(1, 8), ImageKey(2, 7))


@pytest.mark.parametrize(
    ("name", "method", "dataset", "split"),
    [
        ("megapose_lmo-test.csv", "megapose", "lmo", "test"),
        ("posecnn-raw_ycbv-test.csv", "posecnn-raw", "ycbv", "test"),
        ("my_method_tless-test_94485f5a-98ea.csv", "my_method", "tless", "test"),
        ("hodan-iros15_tless-test-primesense.csv", "hodan-iros15", "tless", "test"),
        ("results.csv", "results", "", ""),
    ],
)
def test_method_dataset_and_split_come_from_the_file_name(tmp_path, name, method, dataset, split):
    results = read_results(written(tmp_path, f"1,1,1,1,{R},0 0 1,-1", name=name))
    assert (results.method, results.dataset_name, results.split) == (method, dataset, split)


def test_a_file_with_a_header_only_has_no_estimates(tmp_path):
    results = read_results(written(tmp_path))
    assert len(results) == 0
    assert results.estimates(ImageKey(1, 1)) == ()


def test_writing_and_reading_gives_the_same_bits(tmp_path):
    rng = np.random.default_rng(0)
    n = 200
    results = Results(
        scene_id=rng.integers(0, 9, n),
        im_id=rng.integers(0, 9, n),
        obj_id=rng.integers(1, 9, n),
        score=rng.random(n) ** 9,
        rotation=np.linalg.qr(rng.normal(size=(n, 3, 3)))[0],
        translation_mm=rng.normal(size=(n, 3)) * 10.0 ** rng.integers(-8, 8, (n, 3)),
        time_s=rng.random(n),
    )
    write_results(tmp_path / "a.csv", results)
    assert_same(read_results(tmp_path / "a.csv"), results)
    assert [path.name for path in tmp_path.iterdir()] == ["a.csv"]  # no temporary file stays


@pytest.mark.parametrize("name", ["lmo/results/megapose_lmo-test.csv", "ycbv/results/posecnn-raw_ycbv-test.csv"])
def test_real_submissions_survive_reading_and_writing(shared_data, tmp_path, name):
    results = read_results(shared_data / name)
    write_results(tmp_path / "again.csv", results)
    assert_same(read_results(tmp_path / "again.csv"), results)
    through_metres = Results.from_estimates([results.estimate(row) for row in range(len(results))])
    assert np.array_equal(through_metres.translation_mm / 1000, results.translation_mm / 1000)
    assert np.array_equal(through_metres.rotation, results.rotation)


def test_results_are_made_of_estimates():
    pose = np.eye(4)
    pose[:3, 3] = [0.1, 0.2, 0.7]
    results = Results.from_estimates([PoseEstimate(1, 2, 3, 0.5, pose, 0.25)], method="ours")
    assert results.method == "ours"
    assert results.translation_mm.tolist() == [[100.0, 200.0, 700.0]]
    assert np.array_equal(results.estimates(ImageKey(1, 2), 3)[0].camera_from_model, pose)
    assert len(Results.from_estimates([])) == 0


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (["1,1,1,1,1 0 0 0 1 0 0 0,1 2 3,1"], r"line 2, column R: has 8 numbers; expected 9 numbers separated by spaces$"),
        (["1,1,1,1," + R + ",1 2,1"], "line 2, column t: has 2 numbers; expected 3"),
        (["1,1,1,high," + R + ",1 2 3,1"], "line 2, column score: 'high' is no number"),
        (["1,1,1,1,nan 0 0 0 1 0 0 0 1,1 2 3,1"], "line 2, column R: holds nan; expected finite numbers"),
        (["1,1,1,1," + R + ",1 2 inf,1"], "line 2, column t: holds inf"),
        (["1,1,1,1," + R + ",1 2 3,nan"], "column time: holds nan; expected seconds, or -1"),
        (["1,1,1,1,0 0 0 0 0 0 0 0 0,1 2 3,1"], "column R: 0 0 0 0 0 0 0 0 0 is no rotation"),
        (["1,1.5,1,1," + R + ",1 2 3,1"], "column im_id: is 1.5; expected a whole number from 0"),
        (["1,1,-4,1," + R + ",1 2 3,1"], "column obj_id: is -4"),
        (["1,1,1,1," + R + ",1 2 3"], "line 2, column time is missing"),
        (["1,1,1,1," + R.replace(" ", ",") + ",1 2 3,1"], "line 2, 15 columns; expected 7"),
        (["1,1,1,,"  + R + ",1 2 3,1"], "column score: has 0 numbers; expected 1 number"),
        (["0x1F,1,1,1," + R + ",1 2 3,1"], "column scene_id: '0x1F' is no number"),
        (["1,1,4294967296,1," + R + ",1 2 3,1"], "column obj_id: is 4.29497e[+]09; expected a whole number"),
        (["1,1,1,1," + R + ",1 2 1e999,1"], "column t: holds inf"),
        (["1,1,1,1," + R + ",1 2 3\xff,1"], "column t: '1 2 3\ufffd?.*' is no number"),
        ([HEADER], "column scene_id: 'scene_id' is no number; remove this second header"),
    ],
)  # fmt: skip
def test_the_first_bad_row_is_named_with_column_value_and_fix(tmp_path, rows, message):
    path = written(tmp_path, *rows)
    with pytest.raises(FormatError, match=message) as caught:
        read_results(path)
    assert str(caught.value).startswith(f"{path}: line 2, column") or "15 columns" in message
    assert "\n" not in str(caught.value)


def test_the_line_is_right_deep_in_a_file_and_the_other_bad_rows_are_counted(tmp_path):
    good, bad = f"1,1,1,1,{R},1 2 3,1", f"1,1,1,nan,{R},1 2 3,1"
    with pytest.raises(FormatError, match=r"line 4, column score: holds nan; .* \(one of 2 bad rows\)"):
        read_results(written(tmp_path, good, good, bad, good, bad))
    with pytest.raises(FormatError, match="line 3, column score: holds nan"):
        read_results(written(tmp_path, good, good, bad, header=None))


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "is empty; expected the header scene_id,im_id"),
        (b" \n\n", "is empty"),
        (b"\x89PNG\x00\x01", "is no text file"),
        (HEADER.removesuffix(",time").encode() + b"\n", "line 1, column time is missing; the header must be"),
        (b"hello\n", "line 1, column im_id is missing"),
    ],
)
def test_a_file_that_is_no_results_file_is_refused(tmp_path, content, message):
    path = tmp_path / "results.csv"
    path.write_bytes(content)
    with pytest.raises(FormatError, match=message):
        read_results(path)


def tricky_numbers(count):
    """Floats whose decimal text is hard to read exactly, as texts."""
    rng = random.Random(0)
    bits = [struct.unpack("<d", struct.pack("<Q", rng.getrandbits(64)))[0] for _ in range(count)]
    texts = [repr(x) for x in bits if abs(x) < 1e300]
    texts += [f"{rng.uniform(-1, 1):.{rng.randint(1, 25)}f}" for _ in range(count)]
    texts += [f"{rng.uniform(-1000, 1000):+.{rng.randint(1, 20)}e}" for _ in range(count)]
    return [*texts, "4.9e-324", "2.2250738585072011e-308", "9007199254740993", "0.1" + "0" * 60 + "1", "-0.0", "1e-999"]


def test_numbers_are_those_of_python_to_the_last_bit(tmp_path):
    texts = tricky_numbers(3000)
    rows = [f"1,1,1,{text},{R},{text} {other} 1,-1" for text, other in zip(texts, reversed(texts), strict=True)]
    results = read_results(written(tmp_path, *rows))
    expected = np.array([[float(text), float(other)] for text, other in zip(texts, reversed(texts), strict=True)])
    assert results.score.tobytes() == expected[:, 0].tobytes()
    assert results.translation_mm[:, :2].tobytes() == expected.tobytes()


@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("block_bytes", [1, 7, 64, 100])
def test_the_size_of_the_blocks_does_not_matter(tmp_path, monkeypatch, newline, block_bytes):
    rows = [f"{i},{i + 1},{i + 2},0.{i},{R},{i} 2 1000.125,0.5" for i in range(20)]
    path = written(tmp_path, *rows[:9], "", "  ", *rows[9:], newline=newline)
    expected = read_results(path)
    monkeypatch.setattr(results_csv, "BLOCK_BYTES", block_bytes)
    assert_same(read_results(path), expected)
    assert expected.scene_id.tolist() == list(range(20))
    assert [scan_results(path).lines.of(row) for row in (0, 8, 9, 19)] == [2, 10, 13, 23]


def test_bad_rows_of_every_kind_are_counted_and_the_first_of_the_file_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(results_csv, "BLOCK_BYTES", 200)
    good = f"1,1,1,1,{R},1 2 3,1"
    bad = [f"1,1,1,1,{R},1 2,1", f"1,-1,1,1,{R},1 2 3,1", f"1,1,1,nan,{R},1 2 3,1", "1,1,1,1,0 0 0 0 0 0 0 0 0,1 2 3,1"]
    path = written(tmp_path, good, good, *bad, good, bad[2], header=None)
    with pytest.raises(FormatError, match=r"line 3, column t: has 2 numbers; expected 3 .* \(one of 5 bad rows\)"):
        read_results(path)
    found = scan_results(path)
    assert [(problem.kind, problem.line, count) for problem, count in found.faults] == [
        ("numbers", 3, 1),
        ("id", 4, 1),
        ("not finite", 5, 2),
        ("no rotation", 6, 1),
    ]
    assert [found.lines.of(row) for row in range(3)] == [1, 2, 7]
    assert found.columns["t"].shape == (3, 3)


def test_too_many_rows_are_refused_before_they_are_read(tmp_path):
    path = written(tmp_path, *[f"1,1,1,1,{R},1 2 3,1"] * 100)
    os.truncate(path, 10**10)  # zeros that take no room on the disk; reading them would be an error of another kind
    with pytest.raises(FormatError, match=r"holds about .* rows \(10.0 GB\); at most 5,000,000 are read; keep the 100"):
        read_results(path)


def test_too_many_rows_are_refused_when_they_turn_up(tmp_path, monkeypatch):
    monkeypatch.setattr(results_csv, "BLOCK_BYTES", 2000)
    rows = [f"1,1,1,1,{R},1 2 3{' ' * 200},1"] * 20 + [f"1,1,1,1,{R},1 2 3,1"] * 500
    path = written(tmp_path, *rows)
    assert len(read_results(path, max_rows=520)) == 520
    with pytest.raises(FormatError, match=r"holds more than 300 rows .*; at most 300 are read"):
        read_results(path, max_rows=300)


def test_memory_stays_near_that_of_the_numbers(tmp_path, monkeypatch):
    monkeypatch.setattr(results_csv, "BLOCK_BYTES", 1 << 14)
    rng = np.random.default_rng(0)
    rows = [f"1,1,1,1,{R},{x!r} {x / 3!r} {x / 7!r},1" for x in rng.random(6000).tolist()]
    path = written(tmp_path, *rows)
    read_results(path)
    tracemalloc.start()
    results = read_results(path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    size = sum(getattr(results, column).nbytes for column in COLUMNS)
    assert size == 6000 * 17 * 8
    assert peak < 1.5 * size


def test_a_line_without_end_is_no_results_file(tmp_path, monkeypatch):
    monkeypatch.setattr(results_csv, "LONGEST_LINE", 5000)
    path = written(tmp_path, f"1,1,1,1,{R},1 2 3,1", "1 " * 5000)
    with pytest.raises(FormatError, match="line 3, is longer than 5000 bytes; expected CSV with the columns scene_id"):
        read_results(path)


def test_an_absent_file_and_an_unwritable_folder_are_named(tmp_path):
    with pytest.raises(MissingFileError, match=r"absent\.csv: no such file"):
        read_results(tmp_path / "absent.csv")
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="cannot be written"):
        write_results(tmp_path / "file" / "results.csv", Results.from_estimates([]))
