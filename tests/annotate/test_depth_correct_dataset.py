"""Applying a depth correction: to numbers of 16 bits, to a copy or in place, and never twice or by halves."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from annotate.depth import CorrectionPlan, correct_in_place, correct_raw, correct_to
from pipeline.exceptions import InputError
from tests.tiny_dataset import make_dataset

A, B = 1.0247, -0.00519


def raw(root: Path, scene: int, image: int) -> np.ndarray:
    return cv2.imread(str(root / "test" / f"{scene:06d}" / "depth" / f"{image:06d}.png"), cv2.IMREAD_UNCHANGED)


def files(root: Path) -> set[str]:
    return {str(path.relative_to(root)) for path in root.rglob("*") if path.is_file()}


def plan(root: Path, a: float = A, b: float = B) -> CorrectionPlan:
    return CorrectionPlan(root, "test", a, b)


def stopping_after(count: int):
    def progress(done: int, total: int) -> None:
        if done == count:
            raise KeyboardInterrupt

    return progress


def test_values_are_corrected_in_their_scale_and_zero_stays_zero():
    stored = np.array([[0, 5000, 7000], [1, 30000, 65535]], np.uint16)
    found = correct_raw(stored, 0.1, A, B)
    expected = np.rint(A * stored.astype(float) - 51.9)
    np.testing.assert_array_equal(found.raw[0], [0, *expected[0, 1:]])
    assert found.raw[1, 0] == 0  # below 0: not measured
    assert found.raw[1, 2] == 65535
    assert (found.too_near, found.too_far) == (1, 1)
    assert found.raw.dtype == np.uint16
    metres = correct_raw(np.array([[0.0, 700.0]], np.float32), 1.0, A, B)
    np.testing.assert_allclose(metres.raw, [[0.0, 700 * A + 1000 * B]], rtol=1e-6)
    with pytest.raises(InputError, match="depth image of uint8: only 16-bit and floating-point"):
        correct_raw(np.zeros((2, 2), np.uint8), 1.0, A, B)


def test_a_copy_has_corrected_depth_and_all_else_linked(tmp_path):
    root = make_dataset(tmp_path / "data")
    before = {(1, 0): raw(root, 1, 0), (2, 5): raw(root, 2, 5)}
    out = tmp_path / "new"
    done = correct_to(plan(root), out)
    assert (done.images, done.too_near, done.too_far) == (3, 0, 0)
    for key, old in before.items():
        np.testing.assert_array_equal(raw(root, *key), old)
        np.testing.assert_array_equal(raw(out, *key), correct_raw(old, 0.1, A, B).raw)
    added = {f"test/00000{scene}/depth/correction.json" for scene in (1, 2)}
    assert files(out) == files(root) | added
    assert (out / "models" / "obj_000001.ply").samefile(root / "models" / "obj_000001.ply")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data", "new"]


def test_in_place_keeps_the_originals_and_says_what_was_done(tmp_path):
    root = make_dataset(tmp_path / "data")
    old = raw(root, 1, 1)
    correct_in_place(plan(root), progress=lambda done, total: None)
    np.testing.assert_array_equal(raw(root, 1, 1), correct_raw(old, 0.1, A, B).raw)
    kept = cv2.imread(str(root / "test/000001/depth_original/000001.png"), cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(kept, old)
    told = json.loads((root / "test/000001/depth/correction.json").read_text())
    assert (told["a"], told["b_mm"], told["images"], told["original"]) == (A, -5.19, 2, "depth_original")
    assert not [name for name in files(root) if "part" in name or name.startswith(".")]


def test_a_second_correction_is_refused(tmp_path):
    root = make_dataset(tmp_path / "data")
    correct_to(plan(root), tmp_path / "new")
    message = r"is corrected already \(a = 1.0247, b = -5.19 mm, on .*\); a second correction would add to it"
    for again in (
        lambda: correct_in_place(plan(tmp_path / "new")),
        lambda: correct_to(plan(tmp_path / "new"), root / "x"),
    ):
        with pytest.raises(InputError, match=f"{message}|lies inside"):
            again()
    with pytest.raises(InputError, match=message):
        correct_to(plan(tmp_path / "new"), tmp_path / "newer")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["data", "new"]
    with pytest.raises(InputError, match="exists already; name a new folder"):
        correct_to(plan(root), tmp_path / "new")


@pytest.mark.parametrize("stop", [1, 2, 3])
def test_an_interrupted_copy_goes_on_and_is_never_half_there(tmp_path, stop):
    root, out = make_dataset(tmp_path / "data"), tmp_path / "new"
    with pytest.raises(KeyboardInterrupt):
        correct_to(plan(root), out, progress=stopping_after(stop))
    assert not out.exists()
    with pytest.raises(InputError, match=r"an interrupted run was for a = 1.0247, b = -0.00519 m"):
        correct_to(plan(root, 1.1), out)
    correct_to(plan(root), out)
    np.testing.assert_array_equal(raw(out, 2, 5), correct_raw(raw(root, 2, 5), 0.1, A, B).raw)
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("stop", [1, 2, 3])
def test_an_interrupted_run_in_place_goes_on_and_corrects_once(tmp_path, stop):
    root = make_dataset(tmp_path / "data")
    old = {key: raw(root, *key) for key in ((1, 0), (1, 1), (2, 5))}
    with pytest.raises(KeyboardInterrupt):
        correct_in_place(plan(root), progress=stopping_after(stop))
    for key, value in old.items():
        np.testing.assert_array_equal(raw(root, *key), value)
    correct_in_place(plan(root))
    for key, value in old.items():
        np.testing.assert_array_equal(raw(root, *key), correct_raw(value, 0.1, A, B).raw)


@pytest.mark.parametrize("stop", range(4))
def test_a_stop_at_any_rename_loses_nothing_and_corrects_once(tmp_path, monkeypatch, stop):
    root = make_dataset(tmp_path / "data")
    old = {key: raw(root, *key) for key in ((1, 0), (1, 1), (2, 5))}
    rename, count = Path.rename, 0

    def stopped(self: Path, target: Path) -> Path:
        nonlocal count
        if count == stop:
            raise KeyboardInterrupt
        count += 1
        return rename(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", stopped)
        with pytest.raises(KeyboardInterrupt):
            correct_in_place(plan(root))
    correct_in_place(plan(root))
    for (scene, image), value in old.items():
        np.testing.assert_array_equal(raw(root, scene, image), correct_raw(value, 0.1, A, B).raw)
        kept = root / "test" / f"{scene:06d}" / "depth_original" / f"{image:06d}.png"
        np.testing.assert_array_equal(cv2.imread(str(kept), cv2.IMREAD_UNCHANGED), value)
    with pytest.raises(InputError, match="is corrected already"):
        correct_in_place(plan(root))


@pytest.mark.parametrize(
    ("a", "b", "message"),
    [
        (3.0, 0.0, "a = 3: the factor of a depth correction is near 1"),
        (1.02, -5.19, "b = -5190 mm: the offset of a depth correction is below 1 m"),
        (1.0, 0.0, "a = 1 and b = 0 change nothing"),
    ],
)
def test_corrections_that_cannot_be_meant_are_refused(tmp_path, a, b, message):
    root = make_dataset(tmp_path / "data")
    before = files(root)
    with pytest.raises(InputError, match=message):
        correct_in_place(plan(root, a, b))
    assert files(root) == before


def test_a_dataset_without_depth_is_told_and_left_alone(tmp_path):
    root = make_dataset(tmp_path / "data", depth=False)
    before = files(root)
    with pytest.raises(InputError, match="test has no depth images; choose another split"):
        correct_in_place(plan(root))
    assert files(root) == before


def test_a_damaged_image_stops_the_run_before_anything_is_replaced(tmp_path):
    root = make_dataset(tmp_path / "data")
    damaged = root / "test" / "000002" / "depth" / "000005.png"
    whole = damaged.read_bytes()
    damaged.write_bytes(whole[:60])
    with pytest.raises(InputError, match=r"000005.png: is no depth image; get the file again"):
        correct_in_place(plan(root))
    assert not (root / "test/000001/depth_original").exists()
    damaged.write_bytes(whole)
    correct_in_place(plan(root))
    assert (root / "test/000002/depth/correction.json").is_file()
