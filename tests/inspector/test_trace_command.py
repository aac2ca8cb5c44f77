"""`inspector trace`: from a run to the stage at which an instance was lost."""

import io
import json
import shutil
from pathlib import Path
from typing import Any, NamedTuple

import pytest
import tyro
from hashmatch_parts import CAMERA
from parts_dataset import COARSE, make_parts_dataset
from rich.console import Console
from tiny_dataset import make_dataset, perfect

from inspector.commands.record import RecordConfig
from inspector.commands.record import run as run_record
from inspector.commands.run import RunConfig
from inspector.commands.run import run as run_run
from inspector.commands.trace import TraceConfig, run
from pipeline.bop.results import write_results
from pipeline.exceptions import InputError, MissingFileError, UnknownIdError
from pipeline.explaining import recorded_explanations
from pipeline.hashmatch.tracing.verdicts import STAGES
from pipeline.recording import RecordingReader
from pipeline.run import Run
from pipeline.scene import ImageKey


class Runs(NamedTuple):
    """Runs over the same images."""

    dataset: Path
    recorded: Path
    unrecorded: Path
    without_objectness: Path


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Runs:
    folder = tmp_path_factory.mktemp("runs")
    made = Runs(make_parts_dataset(folder / "parts"), *(folder / name for name in ("first", "second", "third")))
    common = ["hashmatch", made.dataset, *COARSE, "--workers", 1, "--threads", 1, "--cache", folder / "templates"]
    for out, more in (
        (made.recorded, ["--record"]),
        (made.unrecorded, ["--no-record", "--images", 1]),
        (made.without_objectness, ["--record", "--edgel-share", 1000, "--images", 1]),
    ):
        arguments = [str(argument) for argument in (*common, "--out", out, *more)]
        assert run_run(tyro.cli(RunConfig, args=arguments), Console(file=io.StringIO())) == 0
    return made


def said(*arguments: object) -> str:
    """What `inspector trace ...` prints."""
    console = Console(file=io.StringIO(), width=160)
    assert run(tyro.cli(TraceConfig, args=[str(argument) for argument in arguments]), console) == 0
    return console.file.getvalue()  # type: ignore[attr-defined]


def traced(*arguments: object) -> Any:
    return json.loads(said(*arguments, "--json"))


def an_image(out: Path) -> tuple[ImageKey, int]:
    """An image of a run, and an annotated instance in it."""
    key = Run.open(out).finished_images()[0]
    return key, min(recorded_explanations(RecordingReader.open(Run.open(out).recording_path(key))))


def at(key: ImageKey) -> tuple[object, ...]:
    return "--scene", key.scene_id, "--image", key.im_id


def test_an_instance_is_traced_in_words_and_as_json(runs: Runs):
    key, gt = an_image(runs.recorded)
    text = said(runs.recorded, *at(key), "--gt", gt)
    content = traced(runs.recorded, *at(key), "--gt", gt)
    assert f"scene {key.scene_id}, image {key.im_id}, instance {gt}" in text
    assert content["verdict"] in text
    assert content["stage"] == "found"
    for name in ("depth edgels", "votes", "T2 normals", "error of the nearest estimate"):
        assert name in text
    assert len(text.splitlines()) < 30
    assert set(content) == {"gt_index", "obj_id", "stage", "verdict", "evidence", "details"}
    assert {
        "template",
        "window",
        "objectness",
        "votes",
        "tests",
        "failed_test",
        "detections",
        "refinement",
        "followed",
    } <= set(content["details"])
    assert 0 <= content["details"]["window"]["u"] < CAMERA.width


def test_all_instances_of_an_image_are_listed(runs: Runs):
    key, _ = an_image(runs.recorded)
    everything = traced(runs.recorded, *at(key))
    text = said(runs.recorded, *at(key))
    for one in everything:
        assert one["stage"] in STAGES
        assert one["verdict"] in text
        assert one == traced(runs.recorded, *at(key), "--gt", one["gt_index"])


def test_a_run_that_was_not_recorded_is_computed_again_with_the_same_result(runs: Runs):
    (key,) = Run.open(runs.unrecorded).finished_images()
    assert not Run.open(runs.unrecorded).recording_path(key).exists()
    assert traced(runs.unrecorded, *at(key)) == traced(runs.recorded, *at(key))


def test_an_instance_is_lost_where_the_run_lost_it(runs: Runs):
    (key,) = Run.open(runs.without_objectness).finished_images()
    for one in traced(runs.without_objectness, *at(key)):
        assert one["stage"] == "objectness"
        edgels = next(evidence for evidence in one["evidence"] if evidence["name"] == "depth edgels")
        assert not edgels["passed"]
        assert edgels["value"] <= edgels["limit"]
    assert "lost at objectness" in said(runs.without_objectness, *at(key), "--gt", 0)


def test_a_dataset_that_has_moved_is_named_and_can_be_given(runs: Runs, tmp_path: Path):
    (key,) = Run.open(runs.unrecorded).finished_images()
    moved = shutil.copytree(runs.unrecorded, tmp_path / "run")
    info = json.loads((moved / "run.json").read_text())
    info["dataset_root"] = str(tmp_path / "gone")
    (moved / "run.json").write_text(json.dumps(info))
    with pytest.raises(MissingFileError, match=str(tmp_path / "gone")):
        said(moved, *at(key))
    assert traced(moved, *at(key), "--dataset", runs.dataset) == traced(runs.recorded, *at(key))


def test_unknown_names_are_answered_with_those_that_are_known(runs: Runs):
    key, _ = an_image(runs.recorded)
    with pytest.raises(UnknownIdError, match=r"scene 77 is not in .*first; available: 1"):
        said(runs.recorded, "--scene", 77, "--image", 0)
    with pytest.raises(UnknownIdError, match=r"image 99 is not in scene 1 of .*first; available: "):
        said(runs.recorded, "--scene", 1, "--image", 99)
    where = f"what was sought in scene {key.scene_id}, image {key.im_id}"
    with pytest.raises(UnknownIdError, match=f"ground-truth instance 9 is not in {where}; available: 0"):
        said(runs.recorded, *at(key), "--gt", 9)


def test_runs_that_cannot_be_traced_are_told(tmp_path: Path):
    root = make_dataset(tmp_path / "tiny")
    write_results(tmp_path / "mine_tiny-test.csv", perfect())
    config = RecordConfig(root, tmp_path / "mine_tiny-test.csv", tmp_path / "run", workers=1)
    assert run_record(config, Console(file=io.StringIO())) == 0
    with pytest.raises(InputError, match="is a run of mine, which cannot be traced; give a run of hashmatch"):
        said(tmp_path / "run", "--scene", 1, "--image", 0)
    with Run.create(tmp_path / "empty", dataset=Named(root), method="hashmatch"):
        pass
    with pytest.raises(InputError, match=r"empty: has no finished images yet; go on with it by `inspector run`"):
        said(tmp_path / "empty", "--scene", 1, "--image", 0)
    with pytest.raises(MissingFileError, match="is no run folder"):
        said(root, "--scene", 1, "--image", 0)


class Named:
    """What a run keeps of a dataset."""

    name, split = "tiny", "test"

    def __init__(self, root: Path) -> None:
        self.root = root


def test_an_image_that_failed_says_why(runs: Runs, tmp_path: Path):
    failed = shutil.copytree(runs.unrecorded, tmp_path / "failed")
    lines = (failed / "images.jsonl").read_text().splitlines()
    line = {**json.loads(lines[0]), "failure": "scene 1, image 1: has no depth image"}
    (failed / "images.jsonl").write_text(json.dumps(line) + "\n")
    (key,) = Run.open(failed).finished_images()
    with pytest.raises(InputError, match="hashmatch failed on this image: scene 1, image 1: has no depth image"):
        said(failed, *at(key))
