"""`inspector run`: a method over a dataset, chosen and continued on the command line."""

import io
import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import tyro
from rich.console import Console
from tiny_dataset import FIRST, SECOND, make_dataset, perfect

from inspector.commands.evaluate import EvaluateConfig
from inspector.commands.evaluate import run as run_evaluate
from inspector.commands.record import RecordConfig
from inspector.commands.record import run as run_record
from inspector.commands.run import RunConfig, run
from inspector.methods import METHODS
from pipeline.bop.dataset import open_dataset
from pipeline.bop.evaluation.chosen_targets import chosen_targets
from pipeline.bop.results import read_results, write_results
from pipeline.exceptions import FormatError, InputError, UnknownIdError
from pipeline.recording import RecordingReader
from pipeline.run import Run

REPOSITORY = Path(__file__).resolve().parents[2]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """The tiny dataset, with results for it beside it."""
    write_results(tmp_path / "mine_tiny-test.csv", perfect())
    return make_dataset(tmp_path / "tiny")


def started(*arguments: object) -> tuple[int, str]:
    """Exit code and output of `inspector run ...`."""
    console = Console(file=io.StringIO(), width=200)
    code = run(tyro.cli(RunConfig, args=[str(argument) for argument in arguments]), console)
    return code, console.file.getvalue()  # type: ignore[attr-defined]


def replay(root: Path, *more: object) -> tuple[int, str]:
    csv = root.parent / "mine_tiny-test.csv"
    return started("replay", root, "--out", root.parent / "run", "--results", csv, *more)


def test_a_method_is_run_into_a_folder(root: Path, tmp_path: Path):
    code, said = replay(root)
    assert code == 0
    assert f"{tmp_path / 'run'}: open it with: inspector serve {tmp_path / 'run'}" in said
    made = Run.open(tmp_path / "run")
    assert set(made.finished_images()) == {FIRST, SECOND}
    assert (made.info.method, made.info.dataset_name, made.info.seed) == ("replay", "tiny", 0)
    assert made.info.config == {"results": str(tmp_path / "mine_tiny-test.csv")}
    assert len(read_results(made.results_path)) == 4
    assert "vsd/0/cost" in RecordingReader.open(made.recording_path(SECOND)).kinds()


def test_two_processes_find_the_same(root: Path, tmp_path: Path):
    assert replay(root, "--workers", "2", "--no-record")[0] == 0
    made = Run.open(tmp_path / "run")
    assert set(made.finished_images()) == {FIRST, SECOND}
    assert len(read_results(made.results_path)) == 4
    assert not list(made.recordings.iterdir())


def test_scenes_images_and_lists_are_chosen(root: Path, tmp_path: Path):
    assert replay(root, "--images", SECOND.im_id)[0] == 0
    assert Run.open(tmp_path / "run").finished_images() == (SECOND,)
    code, said = replay(root, "--scenes", "1")
    assert code == 0
    assert "2/2" in said
    assert set(Run.open(tmp_path / "run").finished_images()) == {FIRST, SECOND}


def test_targets_are_chosen(root: Path, tmp_path: Path):
    dataset = open_dataset(root)
    assert chosen_targets(dataset) == [(1, 0, 1, 2), (1, 0, 2, 1), (1, 1, 1, 1)]
    assert chosen_targets(dataset, scenes=[1], images=[1]) == [(1, 1, 1, 1)]
    listed = tmp_path / "list.json"
    listed.write_text(json.dumps([{"scene_id": 2, "im_id": 5, "obj_id": 1, "inst_count": 3}]))
    assert chosen_targets(dataset, listed) == [(2, 5, 1, 3)]
    listed.write_text(json.dumps([{"scene_id": 1, "im_id": 0}]))
    assert chosen_targets(dataset, listed) == [(1, 0, 1, 2), (1, 0, 2, 1)]
    with pytest.raises(UnknownIdError, match=r"^scene 7 is not in tiny/test; available: 1, 2$"):
        chosen_targets(dataset, scenes=[1, 7])
    with pytest.raises(UnknownIdError, match=r"^image 5 is not in the targets of these scenes; available: 0, 1$"):
        chosen_targets(dataset, images=[5])
    with pytest.raises(InputError, match=r"^tiny/test: has no targets for the images here; give a list"):
        chosen_targets(dataset, scenes=[2])
    listed.write_text("{}")
    with pytest.raises(FormatError, match="expected a list of targets"):
        chosen_targets(dataset, listed)


def test_a_run_with_other_settings_is_refused(root: Path, tmp_path: Path):
    assert replay(root)[0] == 0
    other = tmp_path / "other_tiny-test.csv"
    write_results(other, perfect())
    with pytest.raises(InputError, match="holds a run with another config"):
        started("replay", root, "--out", tmp_path / "run", "--results", other)


def test_what_is_missing_ends_the_run(root: Path, tmp_path: Path):
    with pytest.raises(InputError, match=r"absent.csv: no such file; correct --results"):
        started("replay", root, "--out", tmp_path / "run", "--results", tmp_path / "absent.csv")
    assert not (tmp_path / "run").exists()
    with pytest.raises(InputError, match=r"^0 workers; give 1 or more$"):
        replay(root, "--workers", "0")


def test_failures_are_counted(root: Path):
    (root / "test" / "000001" / "depth" / "000000.png").write_bytes(b"no image")
    code, said = replay(root)
    assert code == 1
    assert "1 of 2 images failed; open it with" in said


def test_help_shows_methods_and_their_settings(capsys: pytest.CaptureFixture):
    for arguments, shown in ((["--help"], ["replay", *METHODS]), (["replay", "--help"], ["--results", "--scheduler"])):
        with pytest.raises(SystemExit):
            tyro.cli(RunConfig, args=arguments)
        said = capsys.readouterr().out
        assert all(word in said for word in shown)


def test_recording_takes_several_processes(root: Path, tmp_path: Path):
    console = Console(file=io.StringIO())
    config = RecordConfig(root, tmp_path / "mine_tiny-test.csv", tmp_path / "recorded", workers=2)
    assert run_record(config, console) == 0
    made = Run.open(tmp_path / "recorded")
    assert made.info.method == "mine"
    assert all(RecordingReader.open(made.recording_path(key)).verified for key in (FIRST, SECOND))


# ---- Ctrl-C

SCRIPT = """
import sys, tyro
from inspector.commands.run import RunConfig, run
from pipeline.running import Run
sys.exit(run(tyro.cli(RunConfig)))
"""


@pytest.mark.parametrize("workers", ["1", "2"])
def test_ctrl_c_ends_promptly_and_the_same_command_goes_on(tmp_path: Path, workers: str):
    demo = REPOSITORY / "assets" / "demo"
    csv = demo / "results" / "perturbed-1_demo-test.csv"
    arguments = ["replay", demo, "--out", tmp_path / "run", "--results", csv, "--workers", workers]
    command = [sys.executable, "-c", SCRIPT, *map(str, arguments)]
    images = tmp_path / "run" / "images.jsonl"
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, text=True, cwd=REPOSITORY, start_new_session=True
    ) as process:
        end = time.monotonic() + 60
        while not (images.exists() and images.read_text()):
            assert time.monotonic() < end
            time.sleep(0.01)
        os.killpg(process.pid, signal.SIGINT)
        said, _ = process.communicate(timeout=20)
    finished = len(images.read_text().splitlines())
    assert process.returncode == 130
    assert f"interrupted at {finished} of 24 images; the same command continues where it stopped" in said
    assert not list((tmp_path / "run" / "recordings").glob(".*"))
    made = Run.open(tmp_path / "run")
    assert len(made.finished_images()) == finished < 24
    assert started(*arguments)[0] == 0
    assert len(Run.open(tmp_path / "run").finished_images()) == 24
    assert len(set(Run.open(tmp_path / "run").finished_images())) == 24


# ---- scores of a run


def test_a_run_is_evaluated_by_its_folder(root: Path, tmp_path: Path):
    assert replay(root)[0] == 0
    console = Console(file=io.StringIO(), width=200)
    assert run_evaluate(EvaluateConfig(tmp_path / "run", ()), console) == 0
    said = console.file.getvalue()  # type: ignore[attr-defined]
    assert "tiny/test, 6D localization" in said
    assert re.search(r"replay\s+all\s+4\s+1\.0000", said)
    assert "rename" not in said
    with pytest.raises(InputError, match="no results file; name one or more"):
        run_evaluate(EvaluateConfig(root, ()), console)
