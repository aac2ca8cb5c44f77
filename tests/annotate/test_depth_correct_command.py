"""`inspector depth-correct`: what it prints, writes and refuses."""

import io
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from inspector.commands.depth_correct import DepthCorrectConfig, run
from pipeline.exceptions import InputError
from tests.tiny_dataset import make_dataset

DEMO = Path(__file__).resolve().parents[2] / "assets" / "demo"


def output(config: DepthCorrectConfig) -> str:
    out = io.StringIO()
    assert run(config, Console(file=out, width=160)) == 0
    return out.getvalue()


def test_estimate_from_the_board_is_printed_and_written(tmp_path):
    file = tmp_path / "estimate.json"
    text = output(DepthCorrectConfig(DEMO, source="board", split="val_turntable", near=0.53, far=0.92, json=file))
    assert "in 12 images, 0.53" in text
    assert "a = 1.024" in text
    assert "95 % by bootstrap" in text
    assert "mm after (held out)" in text
    found = json.loads(file.read_text())
    assert found["a"] == pytest.approx(1.0247, abs=0.002)
    assert found["b"] == pytest.approx(-0.00519, abs=0.001)


def test_an_estimate_is_applied_to_a_copy(tmp_path):
    text = output(DepthCorrectConfig(DEMO, source="poses", split="val_turntable", out=tmp_path / "new"))
    assert "corrected 12 depth images with a = 1.02" in text
    told = json.loads((tmp_path / "new/val_turntable/000001/depth/correction.json").read_text())
    assert told["a"] == pytest.approx(1.0247, abs=0.002)
    assert not (tmp_path / "new/test/000001/depth/correction.json").exists()


def test_offset_is_given_in_millimetres_and_clipping_is_told(tmp_path):
    root = make_dataset(tmp_path / "data")
    path = root / "test/000001/depth/000000.png"
    depth = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    depth[0, :3] = 65535, 65000, 20
    cv2.imwrite(str(path), depth)
    text = output(DepthCorrectConfig(root, a=1.02, b=-5.0, in_place=True))
    assert "corrected 3 depth images with a = 1.02, b = -5 mm" in text
    assert "1 pixels came out at 0 or less: not measured now" in text
    assert "2 pixels came out beyond 16 bits: set to the largest depth" in text
    found = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(found[1:], np.rint(1.02 * depth[1:].astype(float) - 50))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({}, "nothing to do: give --from board"),
        ({"a": 1.02}, "say where to apply them, with --out NEW or --in-place"),
        ({"b": 2.0, "in_place": True}, "--b without --a: give both"),
        ({"in_place": True}, "no correction: give --a and --b"),
        ({"a": 1.02, "in_place": True, "out": Path("x")}, "--out and --in-place: give one of them"),
        ({"a": 1.02, "source": "poses", "out": Path("x")}, "--from estimates a and b: leave out --a and --b"),
        ({"source": "board", "dictionary": "DICT_4X4_50", "out": Path("x")}, "--dictionary without --side"),
        ({"source": "board", "dictionary": "DICT_7"}, "dictionary DICT_7 is not in those of OpenCV"),
        ({"source": "board"}, "no scene of test has a board.json"),
    ],
)
def test_what_cannot_be_done_is_told_in_one_line(tmp_path, options, message):
    root = make_dataset(tmp_path / "data")
    with pytest.raises(InputError, match=message) as caught:
        run(DepthCorrectConfig(root, **options))
    assert "\n" not in str(caught.value)


def test_real_markers_of_unknown_size_are_reported_honestly(shared_data):
    text = output(DepthCorrectConfig(shared_data / "icbin", source="board", dictionary="DICT_ARUCO_ORIGINAL"))
    assert "side / a = 97." in text
    assert "which cannot be told; give it with --side" in text
    assert "is not told apart from 0" in text
