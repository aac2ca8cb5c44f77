"""`inspector train epos` and `inspector run epos`: from a dataset to a network to a run, on the command line."""

import io
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
import tyro
from rich.console import Console
from tiny_dataset import FIRST, SECOND, make_dataset

from inspector.commands.run import RunConfig
from inspector.commands.run import run as run_run
from inspector.commands.train import TrainConfig, run
from pipeline.bop.dataset import open_dataset
from pipeline.bop.results import read_results
from pipeline.epos.checkpoint import TrainedNetwork, TrainedObject, load_network, save_network
from pipeline.epos.fragments import fragments_of
from pipeline.epos.networks.config import NetworkConfig
from pipeline.epos.networks.network import EposNetwork
from pipeline.exceptions import FormatError, InputError, MissingFileError, UnknownIdError
from pipeline.recording import RecordingReader
from pipeline.run import Run

REPOSITORY = Path(__file__).resolve().parents[2]
SMALL = ("--fragments", 4, "--crop", 32, 32, "--batch", 2, "--steps", 3, "--workers", 0, "--device", "cpu")
FROM_TEST = ("--split", "test", "--pasted-share", 0)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return make_dataset(tmp_path / "tiny")


def trained(root: Path, *more: object) -> tuple[int, str]:
    """Exit code and output of `inspector train epos`, into a folder beside the dataset."""
    console = Console(file=io.StringIO(), width=200)
    arguments = ["epos", root, "--out", root.parent / "out", *SMALL, *FROM_TEST, *more]
    code = run(tyro.cli(TrainConfig, args=[str(argument) for argument in arguments]), console)
    return code, console.file.getvalue()  # type: ignore[attr-defined]


def ran(root: Path, *more: object) -> tuple[int, str]:
    """Exit code and output of `inspector run epos`, in this process."""
    console = Console(file=io.StringIO(), width=200)
    arguments = ["epos", root, "--out", root.parent / "run", "--workers", 1, *more]
    code = run_run(tyro.cli(RunConfig, args=[str(argument) for argument in arguments]), console)
    return code, console.file.getvalue()  # type: ignore[attr-defined]


def checkpoint_of(root: Path, *obj_ids: int, biases: tuple[float, ...] = (), n: int = 4) -> Path:
    """A network for objects of the dataset that finds each everywhere, as likely as its bias says; background first."""
    dataset, path = open_dataset(root), root.parent / "network.pt"
    models = [dataset.model(obj_id, "display") for obj_id in obj_ids]
    torch.manual_seed(0)
    network = EposNetwork(NetworkConfig(), [n] * len(models))
    torch.nn.init.zeros_(network.object_head.weight)
    network.object_head.bias.data = torch.tensor(biases or (0.0,) * (1 + len(models)))
    save_network(path, TrainedNetwork(network, tuple(TrainedObject.of(m, fragments_of(m, n)) for m in models)))
    return path


def test_training_says_what_comes_next_and_the_network_runs(root: Path):
    code, said = trained(root, "--record-every", 3, "--sample-images", 1)
    network = root.parent / "out" / "network.pt"
    assert code == 0
    assert f"{network}: trained in 3 steps" in said
    assert f"inspector run epos {root} --checkpoint {network} --out RUN" in said
    assert f"inspector serve {root.parent / 'out'}" in said
    assert "3/3" in said
    assert "images/s" in said
    recording = RecordingReader.open(root.parent / "out" / "recordings" / "000001_000000.rrd")
    assert {"epos/training/total", "epos/targets/object", "epos/targets/fragments/1"} <= set(recording.kinds())

    code, said = ran(root, "--checkpoint", network)
    made = Run.open(root.parent / "run")
    assert code == 0
    assert f"open it with: inspector serve {root.parent / 'run'}" in said
    assert set(made.finished_images()) == {FIRST, SECOND}
    assert (made.info.method, made.info.config["checkpoint"]) == ("epos", str(network))
    assert not any(image.failure for image in made.finished())
    assert "epos/hypotheses/1" in RecordingReader.open(made.recording_path(FIRST)).kinds()


def test_ctrl_c_keeps_the_step_and_the_same_command_goes_on(root: Path):
    program = [sys.executable, "-u", "-m", "inspector", "train", "epos", str(root), "--out", str(root.parent / "parts")]
    arguments = [str(a) for a in (*SMALL, *FROM_TEST, "--steps", 400, "--sample-images", 0, "--workers", 1)]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY), "COLUMNS": "200", "FORCE_COLOR": "1"}
    begun = subprocess.Popen(
        [*program, *arguments],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        env=environment,
        start_new_session=True,
    )
    assert begun.stdout is not None
    said = ""
    while "loss" not in said:  # the first step is made
        character = begun.stdout.read(1)
        assert character, said
        said += character
    os.killpg(begun.pid, signal.SIGINT)  # as a terminal does: the workers get it, too
    rest, _ = begun.communicate(timeout=120)
    assert begun.returncode == 130, rest
    assert "which is saved in" in rest
    assert "the same command goes on there" in rest
    assert "Traceback" not in rest
    losses = torch.load(root.parent / "parts" / "state.pt", weights_only=True)["losses"]
    assert 1 <= len(losses) < 400
    assert f"stopped at step {len(losses)} of 400" in rest


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (("--steps", 5), r"holds a run with another config \(steps 3, not 5\); give another folder"),
        (("--optimization.learning-rate", 0.5), r"\(optimization.learning_rate 0.001, not 0.5\)"),
    ],
)
def test_folder_of_another_training_is_refused(root: Path, more, message):
    assert trained(root)[0] == 0
    with pytest.raises(InputError, match=message):
        trained(root, *more)


@pytest.mark.parametrize(
    ("more", "message"),
    [
        (
            ("--pasted-share", 0.5, "--pasted.backgrounds", "nowhere"),
            "nowhere: no such file or folder; correct --pasted",
        ),
        (("--start-from", "network.pt"), "network.pt: no such file or folder; correct --start-from"),
        (("--split", "train_pbr"), "train_pbr"),
        (("--objects", 7), "object 7 is not in tiny; available: 1, 2"),
        (("--crop", 320, 240), "training image of 64 x 48 pixels: smaller than the crop of 320 x 240"),
    ],
)
def test_what_is_missing_is_named_in_one_line(root: Path, more, message):
    with pytest.raises(InputError, match=message) as error:
        trained(root, *more)
    assert "\n" not in str(error.value)


def test_no_training_split_no_backgrounds_no_models(root: Path, tmp_path: Path):
    arguments = ["epos", str(root), "--out", str(tmp_path / "out"), "--pasted-share", "0.5"]
    with pytest.raises(InputError, match="has no training split; name a split, or make all images on the fly"):
        run(tyro.cli(TrainConfig, args=arguments), Console(file=io.StringIO()))
    (tmp_path / "empty").mkdir()
    with pytest.raises(MissingFileError, match="has no background photographs"):
        trained(root, "--pasted-share", 0.5, "--pasted.backgrounds", tmp_path / "empty")
    for path in (root / "models").iterdir():
        path.unlink()
    with pytest.raises(InputError, match="has no models of objects to learn"):
        trained(root)
    assert not (tmp_path / "out").exists()


def test_without_a_checkpoint_it_is_said_what_to_do(root: Path, monkeypatch):
    monkeypatch.setattr("pipeline.epos.checkpoint.SHIPPED", root.parent)
    with pytest.raises(InputError, match=r"no network comes with this; train one \(inspector train epos\)"):
        ran(root)
    checkpoint_of(root, 1, 2)  # lies where those that come with the program do
    assert ran(root, "--no-record")[0] == 0


def test_checkpoint_that_does_not_fit_is_refused_before_there_is_a_run(root: Path):
    path = checkpoint_of(root, 1, 2)
    content = load_network(path)
    other = replace(content.objects[0], obj_id=31)
    save_network(path, TrainedNetwork(EposNetwork(NetworkConfig(), [4]), (other,)))
    with pytest.raises(InputError, match="was trained on objects 31, none of which tiny has"):
        ran(root, "--checkpoint", path)
    save_network(path, TrainedNetwork(EposNetwork(NetworkConfig(), [8, 4]), content.objects))
    with pytest.raises(FormatError, match="its parts do not fit together"):  # heads of another n
        ran(root, "--checkpoint", path)
    assert not (root.parent / "run").exists()


def test_objects_that_the_network_does_not_know_are_told_and_left_out(root: Path):
    code, said = ran(root, "--checkpoint", checkpoint_of(root, 1), "--no-record")
    assert code == 0
    assert "note: the network was not trained on objects 2; they are not looked for" in said
    assert set(read_results(root.parent / "run" / "results.csv").obj_id.tolist()) <= {1}
    with pytest.raises(UnknownIdError, match="object 9 is not in the targets"):
        ran(root, "--checkpoint", root.parent / "network.pt", "--objects", 9)


@pytest.mark.parametrize(
    ("biases", "more"),
    [
        ((20.0, 0.0, 0.0), ()),  # nothing above tau_a
        ((0.0, 9.0, 0.0), ("--correspondences.no-regression",)),  # one point per fragment: see below
    ],
)
def test_nothing_to_fit_is_an_empty_result(root: Path, biases, more):
    path = checkpoint_of(root, 1, 2, biases=biases, n=1)
    code, _ = ran(root, "--checkpoint", path, *more)
    assert code == 0
    assert len(read_results(root.parent / "run" / "results.csv")) == 0


def test_output_that_is_not_finite_fails_the_image_with_its_reason(root: Path):
    path = checkpoint_of(root, 1, 2, biases=(float("nan"), 0.0, 0.0))
    code, said = ran(root, "--checkpoint", path)
    assert code == 1
    assert "2 of 2 images failed" in said
    failures = {image.failure for image in Run.open(root.parent / "run").finished()}
    assert failures == {"EPOS: no output of the network is a finite number; train it again, or give another checkpoint"}
