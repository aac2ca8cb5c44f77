"""`inspector run hashmatch`: from a dataset to a run, and what a user meets when something is wrong."""

import errno
import io
import json
import logging
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
import tyro
from hashmatch_parts import other_part, part
from parts_dataset import COARSE, POSES, add_train_split, make_parts_dataset, write_models
from rich.console import Console

from inspector.commands.run import RunConfig, run
from inspector.commands.synthesize import SynthesizeConfig
from inspector.commands.synthesize import run as run_synthesize
from pipeline.bop.errors import mssd
from pipeline.bop.results import Results, read_results
from pipeline.exceptions import FormatError, InputError, MissingFileError, UnknownIdError
from pipeline.run import Run
from pipeline.scene import ImageKey

MODELS = {1: part(), 2: other_part()}


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Shared by tests that learn the same objects; not there yet."""
    return tmp_path_factory.mktemp("of_all") / "templates" / "deep"


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return make_parts_dataset(tmp_path / "parts")


def started(root: Path, out: Path, *more: object) -> tuple[int, str]:
    """Exit code and output of `inspector run hashmatch ...` in this process."""
    console = Console(file=io.StringIO(), width=200)
    arguments = ["hashmatch", root, "--out", out, *COARSE, "--workers", 1, "--threads", 1, "--no-record", *more]
    code = run(tyro.cli(RunConfig, args=[str(argument) for argument in arguments]), console)
    return code, console.file.getvalue()  # type: ignore[attr-defined]


def estimates(out: Path) -> Results:
    return read_results(Run.open(out).results_path)


def test_what_is_there_is_found_and_only_what_is_missing_is_learned(root: Path, tmp_path: Path, cache: Path):
    code, said = started(root, tmp_path / "first", "--images", 2, "--objects", 2, "--cache", cache)
    assert code == 0
    assert re.search(r"hashmatch: learned one object .* 360/360 templates", said)
    assert [path.name[:10] for path in cache.iterdir()] == ["obj_000002"]
    code, said = started(root, tmp_path / "run", "--cache", cache)
    assert code == 0
    assert re.search(r"hashmatch: learned one object .* 360/360 templates", said)  # of the other object
    assert "3/3" in said
    made = Run.open(tmp_path / "run")
    assert made.info.config["objects"] == [1, 2]
    assert made.info.config["cache"] == str(cache)
    found = estimates(tmp_path / "run")
    assert len(found) == 5
    for im_id, poses in POSES.items():
        for obj_id, pose in poses.items():
            (estimate,) = found.estimates(ImageKey(1, im_id), obj_id)
            assert mssd(MODELS[obj_id], estimate.camera_from_model, pose).value < 0.004
    assert "templates" not in started(root, tmp_path / "again", "--images", 2, "--cache", cache)[1]


def test_several_processes_find_the_same(root: Path, tmp_path: Path, cache: Path):
    started(root, tmp_path / "alone", "--cache", cache)
    code, _ = started(root, tmp_path / "together", "--cache", cache, "--workers", 2)
    assert code == 0
    one, other = estimates(tmp_path / "alone"), estimates(tmp_path / "together")
    for im_id, poses in POSES.items():
        for obj_id in poses:
            (mine,) = one.estimates(ImageKey(1, im_id), obj_id)
            (theirs,) = other.estimates(ImageKey(1, im_id), obj_id)
            np.testing.assert_array_equal(mine.camera_from_model, theirs.camera_from_model)
            assert mine.score == theirs.score


def test_templates_come_from_a_train_split(root: Path, tmp_path: Path, cache: Path):
    train = add_train_split(root, models=[other_part()])
    more = ("--templates", train, "--cache", cache, "--images", 2, "--objects", 2)
    code, said = started(root, tmp_path / "run", *more)
    assert code == 0
    assert "360/360 templates" in said
    (estimate,) = estimates(tmp_path / "run").estimates(ImageKey(1, 2), 2)
    assert mssd(other_part(), estimate.camera_from_model, POSES[2][2]).value < 0.004
    with pytest.raises(MissingFileError, match=r"parts/train_other: no such file; correct --templates$"):
        started(root, tmp_path / "other", "--templates", root / "train_other", "--cache", cache)
    with pytest.raises(
        InputError, match=r"^parts/train: no image .* shows object 1 alone and wholly; give another split"
    ):
        started(root, tmp_path / "other", "--templates", train, "--cache", tmp_path / "cache")
    assert not (tmp_path / "other").exists()


SINGLE_OBJECTS = """
models = "{models}"
split = "train"

[camera]
width = 240
height = 180
fx = 300.0
fy = 300.0
cx = 118.0
cy = 91.0

[[scene]]
kind = "pasted"
images = 60

[scene.settings]
objects = [1, 1]
truncated = 0.0

[scene.settings.views]
azimuth_deg = [0.0, 360.0]
elevation_deg = [0.0, 90.0]
distance = [0.3, 0.5]
roll_deg = [-40.0, 40.0]
"""


def test_synthesized_images_of_single_objects_do_as_templates(root: Path, tmp_path: Path):
    for name in ("mitsuba", "mitsuba_oidn", "mujoco", "manifold3d"):
        pytest.importorskip(name, reason="the extra `synth` is not installed")
    written = tmp_path / "single.toml"
    written.write_text(SINGLE_OBJECTS.format(models=root))
    config = SynthesizeConfig(written, out=tmp_path / "single", objects=(2,), workers=1)
    assert run_synthesize(config, Console(file=io.StringIO())) == 0
    more = ("--templates", tmp_path / "single" / "train", "--cache", tmp_path / "cache", "--images", 2, "--objects", 2)
    code, said = started(root, tmp_path / "run", *more)
    assert code == 0
    learned_count = re.search(r"learned one object .* (\d+)/\1 templates", said)
    assert learned_count
    assert (
        150 < int(learned_count[1]) <= 300
    )  # views that are nearly alike, and objects beyond the border, are left out
    (estimate,) = estimates(tmp_path / "run").estimates(ImageKey(1, 2), 2)
    assert mssd(other_part(), estimate.camera_from_model, POSES[2][2]).value < 0.004


def without_depth(root: Path) -> None:
    (root / "test" / "000001" / "depth" / "000001.png").unlink()


def with_smaller_depth(root: Path) -> None:
    path = root / "test" / "000001" / "depth" / "000001.png"
    cv2.imwrite(str(path), np.full((90, 240), 5000, np.uint16))


def with_empty_depth(root: Path) -> None:
    path = root / "test" / "000001" / "depth" / "000001.png"
    cv2.imwrite(str(path), np.zeros((180, 240), np.uint16))


def with_focal_length(value: float) -> Callable[[Path], None]:
    def change(root: Path) -> None:
        path = root / "test" / "000001" / "scene_camera.json"
        content = json.loads(path.read_text())
        content["1"]["cam_K"][0] = value
        path.write_text(json.dumps(content))

    return change


@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (without_depth, r"^scene 1, image 1: has no depth image, which HashMatch needs"),
        (with_smaller_depth, r"depth/000001\.png: has 240 x 90 pixels, its image 240 x 180; register it"),
        (with_empty_depth, r"^scene 1, image 1: its depth image is empty; check the file and depth_scale"),
        (with_focal_length(0.0), r"image 1.*K.*0\.0"),
        (with_focal_length(float("nan")), r"image 1.*cam_K.*nan"),
    ],
)
def test_an_image_that_does_not_do_is_told_and_the_others_go_on(
    root: Path, tmp_path: Path, cache: Path, damage: Callable[[Path], None], reason: str
):
    damage(root)
    code, said = started(root, tmp_path / "run", "--cache", cache, "--objects", 2, "--no-refine")
    assert code == 1
    assert "1 of 3 images failed; open it with" in said
    failures = {image.key: image.failure for image in Run.open(tmp_path / "run").finished()}
    assert [key for key, failure in failures.items() if failure is None] == [(1, 0), (1, 2)]
    text = failures[ImageKey(1, 1)]
    assert text is not None
    assert re.search(reason, text, re.IGNORECASE)
    assert "\n" not in text
    assert len(estimates(tmp_path / "run")) == 2


def test_a_bad_camera_of_the_first_image_is_no_harm_to_the_others(root: Path, tmp_path: Path, cache: Path):
    path = root / "test" / "000001" / "scene_camera.json"
    content = json.loads(path.read_text())
    content["0"]["cam_K"][0] = float("nan")
    path.write_text(json.dumps(content))
    code, said = started(root, tmp_path / "run", "--cache", cache, "--objects", 2, "--no-refine")
    assert code == 1
    assert "1 of 3 images failed" in said


def test_what_is_wrong_with_objects_ends_the_command_before_there_is_a_run(root: Path, tmp_path: Path, cache: Path):
    with pytest.raises(UnknownIdError, match=r"^object 9 is not in the targets; available: 1, 2$"):
        started(root, tmp_path / "run", "--objects", 9, "--cache", cache)
    with pytest.raises(InputError, match=r"^these images have no targets of the objects 1; correct --objects"):
        started(root, tmp_path / "run", "--objects", 1, "--images", 2, "--cache", cache)
    listed = tmp_path / "list.json"
    listed.write_text(json.dumps([{"scene_id": 1, "im_id": 0, "obj_id": 7, "inst_count": 1}]))
    with pytest.raises(UnknownIdError, match=r"^object 7 is not in the models of parts; available: 1, 2$"):
        started(root, tmp_path / "run", "--targets", listed, "--cache", cache)
    mesh = root / "models" / "obj_000001.ply"
    lines = mesh.read_text().replace("element face 36", "element face 0").splitlines()
    mesh.write_text("\n".join([line for line in lines if not line.startswith("3 ")] + [""]))
    with pytest.raises(FormatError, match=r"obj_000001\.ply: has no faces; .*export a triangle mesh$"):
        started(root, tmp_path / "run", "--cache", cache)
    assert not (tmp_path / "run").exists()


def test_models_without_colour_are_told_once(root: Path, tmp_path: Path):
    write_models(root / "models", color=False)
    code, said = started(root, tmp_path / "run", "--cache", tmp_path / "cache", "--images", 1, 2, "--no-refine")
    assert code == 0
    note = "note: all models are without colour: test T5, which compares colours, is off for them"
    assert said.count(note) == 1
    assert len(estimates(tmp_path / "run")) == 3


def test_a_run_goes_on_with_the_same_objects_only(root: Path, tmp_path: Path, cache: Path):
    assert started(root, tmp_path / "run", "--cache", cache, "--images", 2, "--no-refine")[0] == 0
    with pytest.raises(
        InputError, match=r"holds a run with another config \(objects \[1, 2\], not \[2\]\); give another"
    ):
        started(root, tmp_path / "run", "--cache", cache, "--objects", 2, "--no-refine")
    assert started(root, tmp_path / "run", "--cache", cache, "--images", 1, 2, "--no-refine")[0] == 0
    assert Run.open(tmp_path / "run").finished_images() == ((1, 2), (1, 1))


def test_a_full_disk_ends_learning_and_leaves_nothing_half_written(
    root: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    def full(self: Path, data: bytes) -> int:
        with self.open("wb") as file:
            file.write(data[:100])
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", full)
        with pytest.raises(
            InputError, match=r"cannot be written \(No space left on device\); .*--cache, or free space"
        ):
            started(root, tmp_path / "run", "--cache", tmp_path / "cache", "--objects", 2)
    assert not list((tmp_path / "cache").iterdir())
    assert not (tmp_path / "run").exists()
    assert started(root, tmp_path / "run", "--cache", tmp_path / "cache", "--objects", 2, "--no-refine")[0] == 0


def test_a_cache_that_cannot_be_is_named(root: Path, tmp_path: Path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"^.*/file/\.obj_000002.* cannot be written .*; choose a folder .* --cache"):
        started(root, tmp_path / "run", "--cache", tmp_path / "file", "--objects", 2)


def test_a_damaged_cache_is_mended(root: Path, tmp_path: Path, caplog: pytest.LogCaptureFixture):
    arguments = ("--cache", tmp_path / "cache", "--objects", 2, "--images", 2, "--no-refine")
    started(root, tmp_path / "first", *arguments)
    (path,) = (tmp_path / "cache").iterdir()
    path.write_bytes(path.read_bytes()[:10_000])
    with caplog.at_level(logging.WARNING):
        assert started(root, tmp_path / "second", *arguments)[0] == 0
    assert f"{path}: is no readable file of templates; they are learned anew" in caplog.text
    one, other = (estimates(tmp_path / name).estimates(ImageKey(1, 2), 2) for name in ("first", "second"))
    np.testing.assert_array_equal(one[0].camera_from_model, other[0].camera_from_model)


def test_ctrl_c_while_learning_keeps_what_was_learned(root: Path, tmp_path: Path):
    cache = tmp_path / "cache"
    arguments = [root, "--out", tmp_path / "run", "--cache", cache, "--workers", 1, "--images", 2, "--no-record"]
    command = [sys.executable, "-m", "inspector", "run", "hashmatch", *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True,
                          cwd=Path(__file__).resolve().parents[2]) as process:  # fmt: skip
        end = time.monotonic() + 120
        while len(list(cache.glob(".obj*.npz"))) < 2:
            assert process.poll() is None
            assert time.monotonic() < end
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGINT)
        said, complaints = process.communicate(timeout=30)
    assert process.returncode == 130
    found = re.search(r"interrupted at (\d+) of 5832 templates; the same command continues where it stopped", said)
    assert found, said
    assert not complaints
    assert not (tmp_path / "run").exists()
    kept = list(cache.iterdir())
    assert all(re.fullmatch(r"\.obj_000001-\w{16}\.part\d\.npz", path.name) for path in kept)
    assert len(kept) == int(found[1]) // 324


def test_help_is_readable(capsys: pytest.CaptureFixture):
    with pytest.raises(SystemExit):
        tyro.cli(RunConfig, args=["hashmatch", "--help"])
    said = " ".join(capsys.readouterr().out.replace("│", " ").split())
    for words in ("--templates {None}|PATH Folder of a split, such as tless/train_primesense", "SiSo the best one",
                  "--cache {None}|PATH Folder in which learned templates are kept, made if absent"):  # fmt: skip
        assert words in said
