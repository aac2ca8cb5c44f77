"""`inspector gt-info`: what it writes, what it refuses, and that it continues whatever ended it."""

import contextlib
import errno
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console

from inspector.commands.gt_info import GtInfoConfig, run
from pipeline.bop.dataset import open_dataset
from pipeline.bop.gt_info import image as gt_info_image
from pipeline.bop.gt_info import run as gt_info_run
from pipeline.bop.gt_info.plan import GtInfoOptions, make_plan
from pipeline.bop.gt_info.views import view_instances
from pipeline.exceptions import FormatError, InputError, MissingFileError, UnknownIdError
from pipeline.scene import ImageKey
from tests.conftest import REPOSITORY
from tests.tiny_dataset import CAMERA, FIRST, make_dataset

BOP19, BOP24 = "test_targets_bop19.json", "test_targets_bop24.json"
ALL = {
    *(f"test/000001/{folder}/{name}.png" for folder in ("mask", "mask_visib") for name in
      ("000000_000000", "000000_000001", "000000_000002", "000001_000000")),
    "test/000001/scene_gt_info.json",
    "test/000001/scene_gt_coco.json",
    BOP19,
    BOP24,
}  # fmt: skip
"""What is made of the tiny dataset."""


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = make_dataset(tmp_path_factory.mktemp("data") / "tiny")
    (root / "test" / "000001" / "scene_gt_info.json").unlink()
    return root


@pytest.fixture
def root(tiny: Path, tmp_path: Path) -> Path:
    """The tiny dataset without any ground-truth information; ours to change."""
    return shutil.copytree(tiny, tmp_path / "tiny")


@pytest.fixture
def three_scenes(root: Path) -> Path:
    for scene_id in (7, 8):
        shutil.copytree(root / "test" / "000001", root / "test" / f"{scene_id:06d}")
    return root


def made(root: Path, **options) -> str:
    """Run the command and return what it prints."""
    console = Console(file=io.StringIO(), width=300)
    assert run(GtInfoConfig(root, workers=options.pop("workers", 1), **options), console) == 0
    return console.file.getvalue()  # type: ignore[attr-defined]


def refused(root: Path, kind: type[InputError] = InputError, **options) -> str:
    """The one line with which it is refused."""
    with pytest.raises(kind) as caught:
        made(root, **options)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def files(root: Path) -> dict[str, bytes]:
    """All files by name."""
    return {path.relative_to(root).as_posix(): path.read_bytes() for path in sorted(root.rglob("*")) if path.is_file()}


def new_files(root: Path, before: dict[str, bytes]) -> set[str]:
    now = files(root)
    assert {name: now[name] for name in before} == before
    return now.keys() - before.keys()


def infos(root: Path, scene: str = "000001", stem: str = "scene_gt_info") -> dict[str, list[dict]]:
    return json.loads((root / "test" / scene / f"{stem}.json").read_text())


# ---- what is written


def test_everything_that_bop_has_is_made_and_nothing_else(root):
    before = files(root)
    told = made(root)
    assert new_files(root, before) == ALL
    assert "tiny/test: made 8 masks, 1 scene_gt_info.json, 1 scene_gt_coco.json, " in told
    assert "no depth" not in told


def test_files_hold_what_is_computed(root):
    made(root)
    dataset = open_dataset(root)
    truths = dataset.ground_truth(FIRST)
    pairs = [(dataset.model(truth.obj_id), truth.camera_from_model) for truth in truths]
    views = view_instances(pairs, CAMERA, dataset.depth(FIRST))
    for index, (truth, view) in enumerate(zip(truths, views, strict=True)):
        assert np.array_equal(dataset.mask(FIRST, index, visible=False), view.mask)
        assert np.array_equal(dataset.mask(FIRST, index, visible=True), view.visible_mask)
        assert truth.visible_fraction == view.info.visib_fract
        entry = infos(root)["0"][index]
        assert entry["bbox_obj"] == list(view.info.bbox_obj)
        assert entry["px_count_all"] == view.info.px_count_all
    assert list(entry) == ["bbox_obj", "bbox_visib", "px_count_all", "px_count_valid", "px_count_visib", "visib_fract"]
    mask = cv2.imread(str(root / "test/000001/mask/000000_000000.png"), cv2.IMREAD_UNCHANGED)
    assert (mask.dtype, set(np.unique(mask).tolist())) == (np.uint8, {0, 255})


def test_lists_name_what_is_visible_enough_and_all_annotated_images(root):
    write_scene_gt(root, lambda gts: gts["1"].append(gts["1"][0] | {"cam_t_m2c": [0.0, 0.0, 900.0]}))  # hidden
    made(root)
    assert json.loads((root / BOP19).read_text()) == [
        {"scene_id": 1, "im_id": 0, "obj_id": 1, "inst_count": 2},
        {"scene_id": 1, "im_id": 0, "obj_id": 2, "inst_count": 1},
        {"scene_id": 1, "im_id": 1, "obj_id": 1, "inst_count": 1},
    ]
    assert json.loads((root / BOP24).read_text()) == [{"scene_id": 1, "im_id": 0}, {"scene_id": 1, "im_id": 1}]
    assert [entry["visib_fract"] for entry in infos(root)["1"]] == [1.0, 0.0]
    assert len(open_dataset(root).targets()) == 3


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # in pycocotools
def test_coco_file_has_the_visible_masks(root, capsys):
    from pycocotools.coco import COCO

    made(root)
    coco, dataset = COCO(str(root / "test/000001/scene_gt_coco.json")), open_dataset(root)
    assert coco.loadImgs([0])[0]["file_name"] == "rgb/000000.png"
    assert (root / "test/000001" / coco.loadImgs([0])[0]["file_name"]).is_file()
    for im_id, count in ((0, 3), (1, 1)):
        annotations = coco.loadAnns(coco.getAnnIds(imgIds=[im_id]))
        assert [a["category_id"] for a in annotations] == [t.obj_id for t in dataset.ground_truth(ImageKey(1, im_id))]
        for index in range(count):
            mask = dataset.mask(ImageKey(1, im_id), index)
            assert np.array_equal(coco.annToMask(annotations[index]).astype(bool), mask)


def test_without_depth_the_rendering_decides_and_the_user_is_told_once(tmp_path):
    root = make_dataset(tmp_path / "tiny", depth=False)
    (root / "test" / "000001" / "scene_gt_info.json").unlink()
    told = made(root)
    assert told.count("2 of 2 images have no depth: there, visibility comes from rendering the annotated") == 1
    assert infos(root)["1"][0]["visib_fract"] == 1.0


def test_several_sensors_get_their_own_files(root):
    scene = root / "test" / "000001"
    for name in ("scene_gt.json", "scene_camera.json", "rgb", "depth"):
        for sensor in ("cam1", "cam2"):
            stem, dot, suffix = name.partition(".")
            target = scene / f"{stem}_{sensor}{dot}{suffix}"
            (shutil.copytree if (scene / name).is_dir() else shutil.copy)(scene / name, target)
        (shutil.rmtree if (scene / name).is_dir() else os.unlink)(scene / name)
    before = files(root)
    made(root)
    per_sensor = {name.removeprefix("test/000001/") for name in ALL if name.startswith("test")} - {BOP19, BOP24}
    expected = {
        "test/000001/" + (f"{name[:-5]}_{s}.json" if name.endswith("json") else name.replace("/", f"_{s}/"))
        for s in ("cam1", "cam2")
        for name in per_sensor
    }
    assert new_files(root, before) == expected | {BOP19, BOP24}
    coco = json.loads((scene / "scene_gt_coco_cam2.json").read_text())
    assert coco["images"][0]["file_name"] == "rgb_cam2/000000.png"
    assert open_dataset(root, sensor="cam2").ground_truth(FIRST)[0].visible_fraction == 1.0


def test_one_sensor_can_be_asked_for(root):
    shutil.copy(root / "test/000001/scene_gt.json", root / "test/000001/scene_gt_cam9.json")
    shutil.copy(root / "test/000001/scene_camera.json", root / "test/000001/scene_camera_cam9.json")
    before = files(root)
    made(root, sensor="", only=("info",))
    assert new_files(root, before) == {"test/000001/scene_gt_info.json"}
    assert "sensor cam3 is not in" in refused(root, UnknownIdError, sensor="cam3")


def test_tolerance_is_that_of_the_dataset_or_the_one_given(root):
    def delta(folder: str, split: str | None = None, **options) -> float:
        return make_plan(root.rename(root.with_name(folder)), GtInfoOptions(split, **options)).delta

    assert delta("tiny") == 0.015
    root = root.with_name("tiny")
    assert delta("itodd") == 0.005
    root = root.with_name("itodd")
    (root / "test").rename(root / "train_pbr")
    assert delta("tiny", "train_pbr") == 0.005
    root = root.with_name("tiny")
    assert delta("tiny", "train_pbr", delta=0.001) == 0.001
    assert "--delta-mm -1: give millimetres from 0" in refused(root, delta_mm=-1.0)


def test_original_models_are_taken_not_those_for_evaluation(root):
    shutil.copytree(root / "models", root / "models_eval")
    assert make_plan(root, GtInfoOptions()).models[1] == root / "models" / "obj_000001.ply"
    (root / "models").rename(root / "models_cad")
    shutil.copytree(root / "models_eval", root / "models_reconst")
    assert make_plan(root, GtInfoOptions()).models[1] == root / "models_cad" / "obj_000001.ply"


# ---- what is asked for


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"only": ("masks",)}, {name for name in ALL if "mask" in name}),
        ({"only": ("info",)}, {"test/000001/scene_gt_info.json"}),
        ({"only": ("coco", "coco-modal")}, {f"test/000001/scene_gt_coco{tail}.json" for tail in ("", "_modal")}),
        ({"only": ("info", "targets")}, {"test/000001/scene_gt_info.json", BOP19, BOP24}),
        ({"only": ("bop24",)}, {BOP24}),
        ({"masks": False}, {name for name in ALL if "mask" not in name}),
    ],
)
def test_only_what_is_asked_for_is_made(root, options, expected):
    before = files(root)
    made(root, **options)
    assert new_files(root, before) == expected


def test_parts_made_one_by_one_equal_the_whole(tiny, root):
    whole = shutil.copytree(tiny, root.parent / "whole" / "tiny")
    made(whole)
    for kind in ("masks", "info", "coco", "targets"):
        made(root, only=(kind,))
    assert files(root) == files(whole)


def test_training_images_get_no_lists_of_targets(root):
    (root / "test").rename(root / "train_pbr")
    made(root)
    assert not list(root.glob("*targets*"))
    assert (root / "train_pbr/000001/scene_gt_coco.json").is_file()


def test_lists_wait_for_all_scenes(three_scenes):
    told = made(three_scenes, scenes=(1, 7))
    assert "no lists of targets yet: they are of all scenes, and" in told
    assert not (three_scenes / BOP19).exists()
    assert not (three_scenes / "test/000008/scene_gt_info.json").exists()
    text = refused(three_scenes, MissingFileError, only=("targets",))
    assert "000008/scene_gt_info.json: no such file; lists of targets need it, so make it first (--only info)" in text
    made(three_scenes, scenes=(8,))
    assert {target["scene_id"] for target in json.loads((three_scenes / BOP19).read_text())} == {1, 7, 8}


def test_list_for_detection_has_the_images_of_an_official_list(root):
    (root / BOP19).write_text(json.dumps([{"scene_id": 1, "im_id": 1, "obj_id": 1, "inst_count": 1}]))
    made(root, only=("masks", "info", "coco", "bop24"))
    assert json.loads((root / BOP24).read_text()) == [{"scene_id": 1, "im_id": 1}]


def test_coco_takes_masks_and_fractions_that_are_there(root):
    made(root, only=("masks", "info"))
    other = np.zeros((48, 64), np.uint8)
    other[10:20, 5:9] = 255
    for folder in ("mask", "mask_visib"):
        cv2.imwrite(str(root / "test/000001" / folder / "000000_000001.png"), other)
    content = infos(root)
    content["0"][1]["visib_fract"] = 0.01
    (root / "test/000001/scene_gt_info.json").write_text(json.dumps(content))
    made(root, only=("coco",))
    annotation = infos(root, stem="scene_gt_coco")["annotations"][1]
    assert (annotation["area"], annotation["bbox"], annotation["ignore"]) == (40, [5, 10, 4, 10], True)


# ---- refusals


def test_nothing_is_written_over_without_force(root):
    (root / BOP19).write_text("[]")
    text = refused(root)
    assert text.startswith(
        f"{root / BOP19}: exists already (1 file in all); make the rest with --only masks info coco bop24"
    )
    assert text.endswith("or write over what exists with --force")
    made(root, only=("masks", "info", "coco", "bop24"))
    before = files(root)
    text = refused(root)
    assert text.startswith(f"{root}/test/000001/mask/000000_000000.png: exists already (12 files in all); write over")
    assert files(root) == before


def test_scenes_that_lack_files_are_named(three_scenes):
    made(three_scenes, scenes=(7,))
    text = refused(three_scenes, only=("masks", "info"))
    assert "make the rest with --scenes 1 8 --only masks info, or" in text
    made(three_scenes, scenes=(1, 8), only=("masks", "info"))


def test_force_writes_over_and_removes_masks_of_annotations_that_are_gone(root):
    made(root)
    write_scene_gt(root, lambda gts: gts["0"].pop())
    before = files(root)
    made(root, force=True)
    assert before.keys() - files(root).keys() == {f"test/000001/{m}/000000_000002.png" for m in ("mask", "mask_visib")}
    assert len(infos(root)["0"]) == 2
    assert json.loads((root / BOP19).read_text())[0]["inst_count"] == 2


def write_scene_gt(root: Path, change: Callable[[dict], object]) -> None:
    path = root / "test" / "000001" / "scene_gt.json"
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def without_truth(root: Path) -> None:
    (root / "test/000001/scene_gt.json").unlink()


def truth_cut_off(root: Path) -> None:
    (root / "test/000001/scene_gt.json").write_text('{"0": [')


def pose_damaged(root: Path) -> None:
    write_scene_gt(root, lambda gts: gts["1"][0].update(cam_t_m2c=[1.0, None, 3.0]))


def object_without_model(root: Path) -> None:
    write_scene_gt(root, lambda gts: gts["1"][0].update(obj_id=31))


def camera_missing(root: Path) -> None:
    path = root / "test/000001/scene_camera.json"
    path.write_text(json.dumps({"0": json.loads(path.read_text())["0"]}))


@pytest.mark.parametrize(
    ("damage", "text"),
    [
        (without_truth, "test: no scene has a scene_gt.json; give the images poses first"),
        (truth_cut_off, "scene_gt.json: is no complete JSON"),
        (pose_damaged, "scene_gt.json: image 1, annotation 0: cam_t_m2c holds None"),
        (object_without_model, "object 31 is not in .*models; available: 1, 2"),
        (camera_missing, "scene_camera.json: image 1 has no entry; add its cam_K"),
    ],
)
def test_bad_input_is_told_before_any_work(root, damage, text):
    damage(root)
    before = files(root)
    with pytest.raises(InputError, match=text):
        made(root)
    assert files(root) == before


def test_unknown_scenes_and_nothing_to_make_are_told(root):
    assert "scene 5 is not in" in refused(root, UnknownIdError, scenes=(5,))
    assert "nothing to make; leave out --no-masks" in refused(root, only=("masks",), masks=False)
    assert "available: test" in refused(root, UnknownIdError, split="val")


def test_annotated_images_that_are_not_on_disk_are_left_out(root):
    for folder in ("rgb", "depth"):
        (root / "test/000001" / folder / "000001.png").unlink()
    assert "1 annotated images are not on disk; they are left out" in made(root)
    assert infos(root).keys() == {"0"}


def test_damaged_depth_ends_the_run_and_when_mended_it_continues(root):
    depth = root / "test/000001/depth/000001.png"
    whole = depth.read_bytes()
    cv2.imwrite(str(depth), np.full((10, 12), 700, np.uint16))
    assert refused(root, FormatError) == f"{depth}: has 12 x 10 pixels, its image 64 x 48; mend it"
    depth.write_bytes(whole)
    assert "completed 8 masks" in made(root)
    assert not list(root.rglob(".*"))


# ---- interruptions


class KilledError(BaseException):
    """Stands for the end of the process."""


@contextlib.contextmanager
def killed_at(monkeypatch: pytest.MonkeyPatch, operation: int) -> Iterator[list[str]]:
    """End at the n-th change of a file, half of it done; gives the list of changes so far."""
    changes: list[str] = []

    def failing(name: str, real: Callable, half: Callable | None = None) -> Callable:
        def call(*args, **kwargs):
            if len(changes) == operation:
                if half:
                    half(*args)
                raise KilledError
            changes.append(name)
            return real(*args, **kwargs)

        return call

    def half_line(handle: int, data: bytes, at: int) -> None:
        pwrite(handle, data[: len(data) // 2], at)

    pwrite = os.pwrite
    with monkeypatch.context() as patch:
        patch.setattr(os, "pwrite", failing("line", os.pwrite, half_line))
        patch.setattr(os, "ftruncate", failing("truncate", os.ftruncate))
        patch.setattr(Path, "replace", failing("rename", Path.replace))
        patch.setattr(Path, "unlink", failing("unlink", Path.unlink))
        with contextlib.suppress(KilledError):
            yield changes


def left_by_another_process(root: Path) -> None:
    """Give what is half-written the name that it has from another process."""
    own = f".{os.getpid()}.{threading.get_ident()}"
    for path in [path for path in root.rglob(".*") if path.name.endswith(own)]:
        path.rename(path.with_name(path.name.removesuffix(own) + ".1.1"))


@pytest.mark.parametrize("force", [False, True], ids=["new", "over old files"])
def test_killed_at_any_moment_it_continues_and_computes_nothing_twice(monkeypatch, root, tmp_path, force):
    computed: list[tuple[int, int]] = []
    shutil.copytree(root / "test" / "000001", root / "test" / "000007")
    plan = make_plan(root, GtInfoOptions())
    if force:
        gt_info_run.make_gt_info(make_plan(root, GtInfoOptions(delta=0.001)))
        for path in (root / "test").glob("*/mask/*.png"):
            path.write_bytes(b"old")
    start = files(root)
    expected = shutil.copytree(root, tmp_path / "whole" / "tiny")
    gt_info_run.make_gt_info(make_plan(expected, GtInfoOptions()), force=force)
    whole = files(expected)

    def counted(recipe, task):
        computed.append((task.scene, task.im_id))
        return gt_info_image.make_image(recipe, task)

    monkeypatch.setattr(gt_info_run, "make_image", counted)
    operation = 0
    while True:
        computed.clear()
        ended = False
        with killed_at(monkeypatch, operation) as changes:
            gt_info_run.make_gt_info(plan, force=force)
            ended = True
        left_by_another_process(root)
        lines = changes.count("line")
        begun = gt_info_run.is_interrupted(plan) and lines
        if not ended:  # whoever continues need not say again that all is to be written over
            gt_info_run.make_gt_info(plan, force=force and not begun)
        assert files(root) == whole, f"after {operation} changes: {changes[-3:]}"
        assert len(computed) <= len(set(computed)) + 1  # the image at work when it ended
        if ended:
            break
        shutil.rmtree(root)
        root.mkdir()
        for name, data in start.items():
            (root / name).parent.mkdir(parents=True, exist_ok=True)
            (root / name).write_bytes(data)
        operation += 1
    assert operation > 30


def crowded(root: Path, count: int) -> Path:
    """Scene 1 with many more images."""
    scene = root / "test" / "000001"
    for stem in ("scene_gt", "scene_camera"):
        content = json.loads((scene / f"{stem}.json").read_text())
        (scene / f"{stem}.json").write_text(json.dumps({im_id: content["0"] for im_id in range(count)}))
    for im_id in range(2, count):
        for folder in ("rgb", "depth"):
            shutil.copy(scene / folder / "000000.png", scene / folder / f"{im_id:06d}.png")
    return root


def masks_of(root: Path) -> dict[Path, tuple[int, int]]:
    """What shows that a mask was not written again."""
    found = {}
    for path in root.glob("test/000001/mask*/[0-9]*.png"):
        with contextlib.suppress(FileNotFoundError):
            found[path] = (path.stat().st_ino, path.stat().st_mtime_ns)
    return found


COMMAND = """
import sys, time
from pathlib import Path
from inspector.commands.gt_info import GtInfoConfig, run
from pipeline.bop.gt_info import files as gt_info_files
write = gt_info_files.write_parts
def slowly(path, parts):
    time.sleep(0.01)
    write(path, parts)
gt_info_files.write_parts = slowly
sys.exit(run(GtInfoConfig(Path(sys.argv[1]), workers=int(sys.argv[2]))))
"""


def command(root: Path, workers: int) -> subprocess.Popen:
    environment = os.environ | {"PYTHONPATH": str(REPOSITORY)}
    return subprocess.Popen(
        [sys.executable, "-c", COMMAND, str(root), str(workers)], env=environment, stdout=subprocess.DEVNULL
    )


def test_process_that_is_killed_loses_no_finished_image(root, tmp_path):
    crowded(root, 40)
    whole = shutil.copytree(root, tmp_path / "whole" / "tiny")
    made(whole)
    for workers, count in ((1, 30), (2, 130)):
        process = command(root, workers)
        try:
            deadline = time.monotonic() + 60
            while len(masks_of(root)) < count and time.monotonic() < deadline:
                assert process.poll() is None, "ended before it could be killed"
                time.sleep(0.005)
        finally:
            process.send_signal(signal.SIGKILL)
            process.wait()
        assert count <= len(masks_of(root)) < 240
        before = masks_of(root)
    assert "completed 240 masks" in made(root)
    assert files(root) == files(whole)
    after = masks_of(root)
    again = [path for path, state in before.items() if after[path] != state]
    assert len({path.name[:6] for path in again}) <= 1  # of the image at work


def test_second_run_at_the_same_time_is_refused(root):
    crowded(root, 40)
    process = command(root, 1)
    try:
        while not masks_of(root):
            assert process.poll() is None
            time.sleep(0.01)
        process.send_signal(signal.SIGSTOP)  # it must not end meanwhile
        for force in (False, True):
            assert ".journal: held by another run on these data; wait until it is done" in refused(root, force=force)
    finally:
        process.send_signal(signal.SIGCONT)
        assert process.wait() == 0
    assert len(masks_of(root)) == 240


def stopped_after(monkeypatch: pytest.MonkeyPatch, root: Path, changes: int, **options) -> None:
    with killed_at(monkeypatch, changes):
        made(root, **options)
    assert (root / ".gt_info_test.journal").is_file()


def test_interrupted_run_is_only_continued_as_it_was(monkeypatch, root):
    stopped_after(monkeypatch, root, 12)
    text = refused(root, only=("info",))
    assert (
        "an interrupted run was to make something else, or for other scenes; give its command again to complete it"
        in text
    )
    assert "made 1 scene_gt_info.json" in made(root, only=("info",), force=True)
    assert not list(root.rglob(".*"))


def test_annotations_that_change_in_between_are_not_mixed(monkeypatch, root):
    stopped_after(monkeypatch, root, 12)
    assert (root / "test/000001/mask/000000_000002.png").is_file()
    write_scene_gt(root, lambda gts: gts["0"].pop())
    made(root)
    assert not (root / "test/000001/mask/000000_000002.png").exists()
    assert [len(entries) for entries in infos(root).values()] == [2, 1]


def test_ctrl_c_says_how_to_go_on(monkeypatch, root):
    def interrupted(recipe, task):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(gt_info_run, "make_image", interrupted)
        console = Console(file=io.StringIO(), width=200)
        assert run(GtInfoConfig(root, workers=1), console) == 130
        assert "interrupted; the same command continues where it stopped" in console.file.getvalue()  # type: ignore[attr-defined]
    assert "completed 8 masks" in made(root)


@pytest.mark.parametrize("number", [0, 3, 12, 15])
def test_full_disk_is_one_line_and_with_room_it_continues(monkeypatch, tiny, root, tmp_path, number):
    whole = shutil.copytree(tiny, tmp_path / "whole" / "tiny")
    made(whole)
    count = 0

    def full(real: Callable) -> Callable:
        def call(*args):
            nonlocal count
            count += 1
            if count > number:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            return real(*args)

        return call

    with monkeypatch.context() as patch:
        patch.setattr(Path, "replace", full(Path.replace))
        patch.setattr(os, "pwrite", full(os.pwrite))
        text = refused(root)
    assert "cannot be written (No space left on device)" in text
    made(root)
    assert files(root) == files(whole)


def test_folder_that_may_not_be_written_is_one_line(monkeypatch, root):
    def denied(*args):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    before = files(root)
    with monkeypatch.context() as patch:
        patch.setattr(os, "open", denied)
        text = refused(root)
    assert "cannot be written (Read-only file system); make room or get permission, then give the same command" in text
    assert files(root) == before


# ---- many images


def test_several_processes_give_the_same_files(three_scenes, tmp_path):
    whole = shutil.copytree(three_scenes, tmp_path / "whole" / "tiny")
    made(whole)
    made(three_scenes, workers=2)
    assert files(three_scenes) == files(whole)


def test_progress_counts_images_and_those_of_an_earlier_run(monkeypatch, three_scenes):
    plan, seen = make_plan(three_scenes, GtInfoOptions()), []
    with killed_at(monkeypatch, 30):
        gt_info_run.make_gt_info(plan, progress=seen.append)
    stopped_at = seen[-1]
    assert 0 < stopped_at < 6
    seen.clear()
    gt_info_run.make_gt_info(plan, progress=seen.append)
    assert seen == sorted(seen)
    assert seen[0] >= stopped_at
    assert seen[-1] == 6
