"""Whole datasets by `inspector synthesize`: complete, consistent to the pixel, the same again, and never half-made."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.doctor import diagnose
from pipeline.exceptions import InputError
from pipeline.geometry import inverse
from pipeline.parallel import open_workers
from pipeline.rendering import render_scene
from pipeline.scene import ImageKey
from pipeline.synth.generation.config import SynthesisConfig
from pipeline.synth.generation.config_file import read_config
from pipeline.synth.generation.run import synthesize

pytest.importorskip("mitsuba", reason="needs the extra synth")
pytest.importorskip("mujoco", reason="needs the extra synth")

HEAD = """
split = "test"
objects = [1, 2]
rgb = "png"
[camera]
width = 96
height = 72
fx = 90
fy = 90
cx = 47.5
cy = 35.5
"""
TRACED = """
[[scene]]
kind = "traced"
images = 2
worlds = ["cube_room"]
quality = "low"
[scene.cameras]
elevation_deg = [20, 70]
distance = [0.35, 0.5]
"""
PASTED = """
[[scene]]
kind = "pasted"
images = 3
"""
BOARD = """
[[scene]]
kind = "board"
azimuths_deg = [0, 90]
elevations_deg = [45]
distance = 0.5
quality = "low"
[scene.arranging]
way = "falling"
orientation = "canonical"
[scene.depth]
sensor = "carmine"
"""


def config_of(folder: Path, *parts: str) -> SynthesisConfig:
    path = folder / "config.toml"
    path.write_text("".join((HEAD, *parts)))
    return read_config(path)


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A dataset with a scene of each kind."""
    folder = tmp_path_factory.mktemp("synthesis")
    assert synthesize(config_of(folder, TRACED, PASTED, BOARD), folder / "set")
    return folder / "set"


def mask_of(dataset: Dataset, key: ImageKey, index: int, visible: bool = True) -> np.ndarray:
    mask = dataset.mask(key, index, visible)
    assert mask is not None
    return mask


def keys(dataset: Dataset) -> list[ImageKey]:
    return list(dataset.images())


def files(root: Path) -> dict[str, bytes]:
    """All files but the one that tells how long it took."""
    found = (path for path in root.rglob("*") if path.is_file() and path.name != "synthesis.json")
    return {str(path.relative_to(root)): path.read_bytes() for path in found}


def test_is_a_complete_dataset(made: Path):
    dataset = open_dataset(made)
    assert [len(dataset.image_ids(scene_id)) for scene_id in dataset.scene_ids] == [2, 3, 2]
    assert [finding for finding in diagnose(made) if finding.severity == "error"] == []
    names = {path.name for path in made.iterdir()}
    assert names == {
        "camera.json",
        "models",
        "models_eval",
        "test",
        "test_targets_bop19.json",
        "test_targets_bop24.json",
    }
    scene = {path.name for path in (made / "test" / "000000").iterdir()}
    assert scene == {
        *("rgb", "depth", "mask", "mask_visib"),
        *("scene_camera.json", "scene_gt.json", "scene_gt_info.json", "scene_gt_coco.json"),
    }
    assert not list(made.rglob(".*"))
    assert dataset.targets()


def test_masks_and_depth_agree_with_the_poses_to_the_pixel(made: Path):
    dataset = open_dataset(made)
    for key in keys(dataset):
        truths = dataset.ground_truth(key)
        things = [(dataset.model(truth.obj_id, "display"), truth.camera_from_model) for truth in truths]
        scene = render_scene(things, dataset.camera(key), pixel_center=0.0)
        is_drawn = key.scene_id == 1  # by OpenGL, whose outlines may differ by single pixels
        for k, (truth, alone) in enumerate(zip(truths, scene.renderings, strict=True)):
            mask, visible = (mask_of(dataset, key, truth.index, kind) for kind in (False, True))
            assert np.count_nonzero(mask != alone.mask) <= (2 if is_drawn else 0)
            assert not (visible & ~mask).any()
            assert np.count_nonzero(visible & (scene.instance_ids != k)) <= (2 if is_drawn else 0)
            if key.scene_id == 0:
                depth = dataset.depth(key)
                assert depth is not None
                np.testing.assert_allclose(depth[visible], scene.depth[visible], atol=6e-5)


def test_visible_fractions_are_those_of_an_independent_count(made: Path):
    from dataclasses import replace

    dataset = open_dataset(made)
    for key in keys(dataset):
        camera = dataset.camera(key)
        shift = np.array([[1.0, 0, 2 * camera.width], [0, 1.0, 2 * camera.height], [0, 0, 1.0]])
        wide = replace(camera, K=shift @ camera.K, width=5 * camera.width, height=5 * camera.height)
        for truth in dataset.ground_truth(key):
            visible = mask_of(dataset, key, truth.index)
            model = dataset.model(truth.obj_id, "display")
            whole = render_scene([(model, truth.camera_from_model)], wide, pixel_center=0.0).depth > 0
            assert truth.visible_fraction == pytest.approx(visible.sum() / whole.sum(), abs=2e-3)


def test_objects_of_a_scene_stay_where_they_are(made: Path):
    dataset = open_dataset(made)
    for scene_id in (0, 2):
        places: dict[int, np.ndarray] = {}
        for im_id in dataset.image_ids(scene_id):
            key = ImageKey(scene_id, im_id)
            world_from_camera = dataset.camera(key).world_from_camera
            assert world_from_camera is not None
            for truth in dataset.ground_truth(key):
                found = world_from_camera @ truth.camera_from_model
                np.testing.assert_allclose(places.setdefault(truth.obj_id, found), found, atol=1e-8)
        assert set(places) == {1, 2}


def test_the_board_is_described_and_its_depth_is_biased(made: Path):
    from pipeline.synth.boards import read_board
    from pipeline.synth.sensors import depth_sensor

    dataset = open_dataset(made)
    assert len(read_board(made / "test" / "000002" / "board.json").ids) > 40
    errors = []
    for im_id in dataset.image_ids(2):
        key = ImageKey(2, im_id)
        things = [(dataset.model(t.obj_id), t.camera_from_model) for t in dataset.ground_truth(key)]
        exact, depth = render_scene(things, dataset.camera(key), pixel_center=0.0).depth, dataset.depth(key)
        assert depth is not None
        seen = (depth > 0) & np.logical_or.reduce([mask_of(dataset, key, t.index) for t in dataset.ground_truth(key)])
        carmine = depth_sensor("carmine")
        errors.append(depth[seen] - (exact[seen] - carmine.b) / carmine.a)
    assert abs(np.median(np.concatenate(errors))) < 0.002  # the bias is 8 mm there


def test_says_what_it_was_made_with(made: Path):
    summary = json.loads((made / "test" / "synthesis.json").read_text())
    assert summary["images"] == 7
    assert summary["config"]["scene"][0]["kind"] == "traced"
    assert summary["seconds"]["colour"] > 0
    assert "mitsuba" in summary["versions"]


def test_comes_out_the_same_from_several_processes(made: Path, tmp_path: Path):
    with open_workers(2) as workers:
        synthesize(config_of(tmp_path, TRACED, PASTED, BOARD), tmp_path / "set", workers, 2)
    mine, theirs = files(tmp_path / "set"), files(made)
    assert mine.keys() == theirs.keys()
    for name in mine:
        if "/rgb/" in name:  # rays are added up in any order, which can be a level here or there
            images = [cv2.imdecode(np.frombuffer(found[name], np.uint8), cv2.IMREAD_COLOR) for found in (mine, theirs)]
            assert np.abs(images[0].astype(int) - images[1]).max() <= 1, name
        else:
            assert mine[name] == theirs[name], name


def test_another_seed_gives_other_images(made: Path, tmp_path: Path):
    from dataclasses import replace

    synthesize(replace(config_of(tmp_path, PASTED), seed=1), tmp_path / "set")
    image = "test/000000/rgb/000000.png"
    assert (tmp_path / "set" / image).read_bytes() != (made / "test/000001/rgb/000000.png").read_bytes()


def test_a_dataset_that_is_complete_is_left_alone_and_no_other_is_mixed_in(tmp_path: Path):
    from dataclasses import replace

    config = config_of(tmp_path, PASTED)
    assert synthesize(config, tmp_path / "set")
    before = files(tmp_path / "set")
    assert not synthesize(config, tmp_path / "set")
    with pytest.raises(InputError, match="was made with other settings: seed was 0, now 5"):
        synthesize(replace(config, seed=5), tmp_path / "set")
    assert files(tmp_path / "set") == before


def test_a_folder_with_other_images_is_refused(tmp_path: Path):
    (tmp_path / "set" / "test").mkdir(parents=True)
    (tmp_path / "set" / "test" / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="is not empty and was not made by this"):
        synthesize(config_of(tmp_path, PASTED), tmp_path / "set")
    assert (tmp_path / "set" / "test" / "notes.txt").read_text() == "mine"


def test_another_split_joins_a_dataset(tmp_path: Path):
    from dataclasses import replace

    config = config_of(tmp_path, PASTED)
    synthesize(config, tmp_path / "set")
    synthesize(replace(config, split="train_paste"), tmp_path / "set")
    assert len(keys(open_dataset(tmp_path / "set", "train_paste"))) == 3


def command(folder: Path, *more: str) -> list[str]:
    return [
        sys.executable,
        "-m",
        "inspector",
        "synthesize",
        str(folder / "config.toml"),
        "--out",
        str(folder / "set"),
        *more,
    ]


def test_goes_on_after_a_kill_and_loses_and_repeats_nothing(tmp_path: Path):
    config = config_of(tmp_path, PASTED.replace("images = 3", "images = 40"))
    process = subprocess.Popen(command(tmp_path, "--workers", "2"), stdout=subprocess.DEVNULL, start_new_session=True)
    records = tmp_path / "set" / "test" / ".synthesis"
    deadline = time.monotonic() + 120
    while len(list(records.glob("*/image_*.json"))) < 6 and time.monotonic() < deadline and process.poll() is None:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGKILL)
    process.wait()
    finished = {path.stem: path.stat().st_mtime_ns for path in records.glob("*/image_*.json")}
    assert 6 <= len(finished) < 40
    images = {path: path.stat().st_mtime_ns for path in (tmp_path / "set" / "test").glob("*/rgb/*.png")}
    assert subprocess.run(command(tmp_path), stdout=subprocess.DEVNULL, check=False).returncode == 0
    kept = {f"image_{path.stem}" for path, changed in images.items() if path.stat().st_mtime_ns == changed}
    assert set(finished) <= kept
    synthesize(config, tmp_path / "again" / "set")
    again, mine = files(tmp_path / "again" / "set"), files(tmp_path / "set")
    assert [name for name in again if again[name] != mine.get(name)] == []
    assert again.keys() == mine.keys()


def test_a_full_disk_leaves_what_is_finished_and_says_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    from pipeline.bop import writer

    config = config_of(tmp_path, PASTED)
    write, written = writer.write_atomically, []

    def full(path: Path, data: bytes) -> None:
        if path.parent.name == "depth" and len(written) == 2:
            raise InputError(f"{path}: cannot be written (No space left on device); make room")
        written.append(path) if path.parent.name == "depth" else None
        write(path, data)

    monkeypatch.setattr(writer, "write_atomically", full)
    with pytest.raises(InputError, match="No space left"):
        synthesize(config, tmp_path / "set")
    dataset = open_dataset(tmp_path / "set")
    assert [len(dataset.ground_truth(ImageKey(0, k))) > 0 for k in (0, 1)] == [True, True]
    monkeypatch.setattr(writer, "write_atomically", write)
    assert synthesize(config, tmp_path / "set")
    assert len(keys(open_dataset(tmp_path / "set"))) == 3


def test_cameras_that_cannot_be_are_told_after_a_bounded_number_of_tries(tmp_path: Path):
    far = TRACED.replace("[0.35, 0.5]", "[8, 9]")
    with pytest.raises(InputError, match=r"scene 0, arrangement 0: tried 6; .* outside the room; shorten distance"):
        synthesize(config_of(tmp_path, far), tmp_path / "set")


def test_distractors_hide_but_are_not_annotated(tmp_path: Path):
    from pipeline.synth.demo.part_files import write_part_models

    write_part_models(tmp_path / "others" / "models")
    more = (
        TRACED.replace("images = 2", "images = 4")
        + '[scene.distractors]\nmodels = "others"\nobjects = [3]\ncount = [1, 1]\n'
    )
    config = config_of(
        tmp_path,
        more.replace(
            "[scene.distractors]", '[scene.arranging]\nway = "falling"\ninstances = [2, 2]\n[scene.distractors]'
        ),
    )
    synthesize(config, tmp_path / "set")
    dataset = open_dataset(tmp_path / "set")
    annotated = {truth.obj_id for key in keys(dataset) for truth in dataset.ground_truth(key)}
    assert annotated == {1, 2}


def test_render_and_paste_imitates_another_dataset(made: Path, tmp_path: Path):
    text = f'[[scene]]\nkind = "pasted"\nimages = 2\nposes_of = "{made}"\n'
    synthesize(config_of(tmp_path, text), tmp_path / "set")
    mine, theirs = open_dataset(tmp_path / "set"), open_dataset(made)
    for key in keys(mine):
        wanted = {t.obj_id: t.camera_from_model for t in theirs.ground_truth(key)}
        for truth in mine.ground_truth(key):
            np.testing.assert_allclose(truth.camera_from_model, wanted[truth.obj_id], atol=1e-9)
        np.testing.assert_array_equal(mine.camera(key).K, theirs.camera(key).K)


def test_the_command_lists_what_there_is(capsys: pytest.CaptureFixture[str]):
    from inspector.commands.synthesize import SynthesizeConfig, run

    assert run(SynthesizeConfig()) == 0
    text = capsys.readouterr().out
    assert "bop20" in text
    assert "turntable" in text
    with pytest.raises(InputError, match="no --out"):
        run(SynthesizeConfig(Path("bop20")))


def test_what_the_command_line_says_takes_precedence(tmp_path: Path):
    from inspector.commands.synthesize import SynthesizeConfig, _changed

    given = SynthesizeConfig(Path("bop20"), objects=(3,), scenes=1, arrangements=2, images=4, quality="low", seed=9)
    changed = _changed(read_config(Path("bop20")), given)
    assert (changed.images, changed.seed, changed.objects) == (8, 9, (3,))
    assert changed.scene[0].quality == "low"  # type: ignore[union-attr]


def test_world_and_camera_poses_are_inverse_of_each_other(made: Path):
    dataset = open_dataset(made)
    entry = json.loads((made / "test" / "000000" / "scene_camera.json").read_text())["0"]
    camera_from_world = inverse(dataset.camera(ImageKey(0, 0)).world_from_camera)  # type: ignore[arg-type]
    np.testing.assert_allclose(np.reshape(entry["cam_R_w2c"], (3, 3)), camera_from_world[:3, :3], atol=1e-9)
