"""Run folders: growing image by image, killed at any moment, watched from outside."""

import dataclasses
import json
import os
import re
import signal
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from pipeline.bop.results import read_results
from pipeline.exceptions import FormatError, InputError, MissingFileError
from pipeline.recording import NullRecorder, RecordingReader, saved_models
from pipeline.run import IMAGES_FILE, RESULTS_FILE, RUN_FILE, Run
from pipeline.scene import Camera, ImageKey, Model, PoseEstimate

KEY = ImageKey(2, 3)


class Named(NamedTuple):
    """What a run needs of a dataset."""

    name: str = "lmo"
    split: str = "test"
    root: Path = Path("lmo")


@dataclasses.dataclass(frozen=True)
class Config:
    """A method's settings."""

    threshold: float = 0.5
    cache: Path = Path("cache")
    scales: tuple[float, ...] = (1.0, 1.2)


def start(root: Path, **changes: object) -> Run:
    settings = {"dataset": Named(), "method": "epos", "config": Config(), "seed": 4, **changes}
    return Run.create(root, **settings)  # pyright: ignore[reportArgumentType]


def estimate(key: ImageKey = KEY, obj_id: int = 5, score: float = 0.1 + 0.2) -> PoseEstimate:
    pose = np.eye(4)
    pose[:3] = np.random.default_rng(obj_id).normal(size=(3, 4))
    return PoseEstimate(*key, obj_id, score, pose)


def rows(root: Path) -> list[list[str]]:
    lines = (root / RESULTS_FILE).read_text().splitlines()
    assert lines[0] == "scene_id,im_id,obj_id,score,R,t,time"
    return [line.split(",") for line in lines[1:]]


def test_results_are_a_bop_file(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    expected = estimate()
    run.add(KEY, [expected, estimate(obj_id=6)], {"network": 0.25, "fitting": 0.5})
    first, second = rows(run.root)
    assert first[:4] == ["2", "3", "5", "0.30000000000000004"]
    read = read_results(run.results_path).estimate(0)
    np.testing.assert_array_equal(read.camera_from_model, expected.camera_from_model)
    assert first[6] == second[6] == "0.75"


def test_run_json_says_what_was_run(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    run.add(KEY, [], {"network": 0.25})
    run.add(ImageKey(2, 4), [], {"network": 0.5, "fitting": 0.125})
    content = json.loads((run.root / RUN_FILE).read_text())
    assert content["dataset_name"] == "lmo"
    assert content["config"] == {"threshold": 0.5, "cache": "cache", "scales": [1.0, 1.2]}
    assert content["timings"] == {"network": 0.75, "fitting": 0.125}
    assert {"python", "numpy", "pose-inspector", "rerun-sdk"} <= set(content["versions"])
    assert Run.open(run.root).info == run.info


def test_a_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    with start(tmp_path / "run") as run:
        run.add(KEY, [estimate()])
        run.add(ImageKey(2, 4), [])
    with start(tmp_path / "run") as again:
        assert again.info == run.info
        assert again.finished_images() == (KEY, ImageKey(2, 4))
        again.add(ImageKey(2, 5), [estimate(ImageKey(2, 5))])
    assert [row[1] for row in rows(run.root)] == ["3", "5"]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"method": "hashmatch"}, r"another method \(epos, not hashmatch\); give another folder"),
        ({"seed": 5}, r"another seed \(4, not 5\)"),
        ({"config": Config(threshold=0.4)}, "another config"),
        ({"dataset": Named(split="val")}, r"another dataset split \(test, not val\)"),
    ],
)
def test_another_run_is_not_mixed_in(tmp_path: Path, changes: dict[str, object], message: str) -> None:
    start(tmp_path / "run").close()
    with pytest.raises(InputError, match=message):
        start(tmp_path / "run", **changes)


def test_a_folder_with_other_files_is_refused(tmp_path: Path) -> None:
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match=r"holds other files and no run.json"):
        start(tmp_path)


def test_two_writers_are_refused(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    with pytest.raises(InputError, match="another process is writing to this run"):
        start(tmp_path / "run")
    run.close()
    start(tmp_path / "run").close()


def test_only_whole_and_new_images_are_added(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    run.add(KEY, [estimate()])
    with pytest.raises(ValueError, match="scene 2, image 3 is finished already"):
        run.add(KEY, [])
    with pytest.raises(ValueError, match="was given with"):
        run.add(ImageKey(2, 9), [estimate(KEY)])
    with pytest.raises(InputError, match="scene 2, image 9, object 5: epos gave a pose or score that is not finite"):
        run.add(ImageKey(2, 9), [dataclasses.replace(estimate(ImageKey(2, 9)), score=float("nan"))])
    with pytest.raises(ValueError, match="open for reading only"):
        Run.open(run.root).add(ImageKey(2, 9), [])
    assert run.finished_images() == (KEY,)
    assert len(rows(run.root)) == 1


def test_failures_are_kept(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    run.add(KEY, [], failure="object 31 is not in lmo")
    assert Run.open(run.root).finished()[0].failure == "object 31 is not in lmo"


@pytest.mark.parametrize("file", [RESULTS_FILE, IMAGES_FILE])
@pytest.mark.parametrize("cut", [1, 10, 40])
def test_a_cut_last_line_belongs_to_the_image_in_flight(tmp_path: Path, file: str, cut: int) -> None:
    """Rows are written before the line that finishes their image, so a kill leaves a part of either."""
    with start(tmp_path / "run") as run:
        run.add(KEY, [estimate()])
        whole = (run.root / RESULTS_FILE).read_bytes(), (run.root / IMAGES_FILE).read_bytes()
        run.add(ImageKey(2, 4), [estimate(ImageKey(2, 4))])
    if file == RESULTS_FILE:  # killed before the line
        (run.root / IMAGES_FILE).write_bytes(whole[1])
    (run.root / file).write_bytes((run.root / file).read_bytes()[:-cut])
    with start(tmp_path / "run") as again:
        assert again.finished_images() == (KEY,)
        assert ((run.root / RESULTS_FILE).read_bytes(), (run.root / IMAGES_FILE).read_bytes()) == whole
        again.add(ImageKey(2, 4), [estimate(ImageKey(2, 4))])
    assert [row[1] for row in rows(run.root)] == ["3", "4"]


KILLED = """
import sys
from pathlib import Path
from tests.pipeline.test_run import ImageKey, estimate, start
run = start(Path(sys.argv[1]))
done = set(run.finished_images())
for im_id in range(400):
    if ImageKey(2, im_id) not in done:
        run.add(ImageKey(2, im_id), [estimate(ImageKey(2, im_id), obj_id) for obj_id in range(im_id % 4)])
        print(im_id, flush=True)
"""


def test_kill_9_loses_at_most_the_image_in_flight(tmp_path: Path) -> None:
    root = tmp_path / "run"
    repository = Path(__file__).parents[2]
    environment = {**os.environ, "PYTHONPATH": str(repository)}
    reported: list[int] = []
    for stop_after in (5, 20, 60):
        process = subprocess.Popen(
            [sys.executable, "-c", KILLED, str(root)],
            stdout=subprocess.PIPE,
            text=True,
            env=environment,
            cwd=repository,
        )
        assert process.stdout is not None
        for line in process.stdout:
            reported.append(int(line))
            if len(reported) >= stop_after:
                break
        process.send_signal(signal.SIGKILL)
        reported += [int(line) for line in process.stdout.read().split()]
        process.wait()
        process.stdout.close()
    with start(root) as run:
        finished = [key.im_id for key in run.finished_images()]
    assert finished[: len(reported)] == reported
    assert len(finished) <= len(reported) + 1
    expected = [(im_id, obj_id) for im_id in finished for obj_id in range(im_id % 4)]
    assert [(int(row[1]), int(row[2])) for row in rows(root)] == expected


def test_several_threads_add(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    keys = [ImageKey(1, im_id) for im_id in range(40)]
    with ThreadPoolExecutor(8) as pool:
        list(pool.map(lambda key: run.add(key, [estimate(key), estimate(key, 6)], {"all": 0.5}), keys))
    assert sorted(run.finished_images()) == keys
    assert len(rows(run.root)) == 80
    assert run.timings() == {"all": 20.0}


def test_watching_tells_every_image_once(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    run.add(KEY, [])
    watch = Run.open(run.root).watch()
    assert [image.key for image in watch.poll()] == [KEY]
    assert watch.poll() == ()
    run.add(ImageKey(2, 4), [])
    with (run.root / IMAGES_FILE).open("a") as file:
        file.write('{"scene_id": 2, "im')
    assert [image.key for image in watch.poll()] == [ImageKey(2, 4)]
    assert watch.poll() == ()


def test_recordings_of_a_run(tmp_path: Path) -> None:
    run = start(tmp_path / "run")
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], np.float64)
    run.save_models([Model(5, corners, np.array([[0, 1, 2]], np.int32), 1.4)])
    assert saved_models(run.recordings) == {5}
    with run.recorder(KEY, Camera(np.eye(3), 8, 6)) as recorder:
        recorder.poses("estimates", [estimate()])
    assert RecordingReader.open(run.recording_path(KEY)).estimates()[0].obj_id == 5
    assert isinstance(run.recorder(KEY, enabled=False), NullRecorder)
    names = {item.name for item in run.recordings.iterdir()}
    assert names == {"000002_000003.rrd", "000002_000003.rrd.sha256", "models.rrd", "models.rrd.sha256", "layout.rbl"}


@pytest.mark.parametrize(
    ("content", "error", "message"),
    [
        (None, MissingFileError, r"run.json: no such file; .* is no run folder"),
        ('{"version": 1, "meth', FormatError, r"run.json: no valid JSON"),
        ('{"version": 9}', FormatError, r"run format version 9; this program reads version 1"),
        ("[]", FormatError, r"run format version None"),
        ('{"version": 1, "method": "epos"}', FormatError, r"lacks dataset_name, dataset_split"),
        (b"\xff\xfe\x00", FormatError, r"no valid JSON"),
    ],
)
def test_bad_run_json(tmp_path: Path, content: str | bytes | None, error: type[InputError], message: str) -> None:
    if content is not None:
        (tmp_path / RUN_FILE).write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(error, match=message) as caught:
        Run.open(tmp_path)
    assert "\n" not in str(caught.value)


def test_bad_lists_of_images(tmp_path: Path) -> None:
    with start(tmp_path / "run") as run:
        run.add(KEY, [estimate()])
    (run.root / IMAGES_FILE).write_text('{"scene_id": 2}\n')
    with pytest.raises(FormatError, match=re.escape(str(run.root / IMAGES_FILE)) + r".*is no finished image"):
        Run.open(run.root).finished_images()


def test_results_that_somebody_shortened(tmp_path: Path) -> None:
    with start(tmp_path / "run") as run:
        run.add(KEY, [estimate()])
    (run.root / RESULTS_FILE).write_text("scene_id")
    with pytest.raises(FormatError, match=r"results.csv: has 8 bytes, images.jsonl says \d+; restore it"):
        start(tmp_path / "run")


def test_a_full_disk_is_one_line(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    run = start(tmp_path / "run")

    def full(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(
        InputError, match=r"results.csv: cannot write: No space left on device; free space and run again"
    ):
        run.add(KEY, [estimate()])
    monkeypatch.undo()
    run.add(KEY, [estimate()])
    assert len(rows(run.root)) == 1
