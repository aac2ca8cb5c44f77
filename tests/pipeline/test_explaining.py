"""Methods that say why they found or lost an instance: when they are asked, what is kept, and what is read back."""

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import pytest
from tiny_dataset import ANNOTATED, FIRST, SECOND, claim, make_dataset

from pipeline import explaining
from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.exceptions import InputError
from pipeline.explaining import Evidence, Explain, Explanation, recorded_explanations
from pipeline.kept_settings import settings_of
from pipeline.recording import RecordingReader, StageRecorder, Table, Text
from pipeline.run import Run
from pipeline.running import run_estimator
from pipeline.scene import GroundTruth, Image, Model, PoseEstimate, Target

ASKED: list[int] = []
"""Indices of the instances that were explained."""


class Method:
    """Estimates nothing right."""

    def estimate(self, image: Image, targets: Sequence[Target], recorder: StageRecorder) -> list[PoseEstimate]:
        return [claim(image.key, target.obj_id, ANNOTATED[FIRST][0][1]) for target in targets]


def explained(
    estimator: Method, image: Image, targets: Sequence[Target], recorder: StageRecorder
) -> tuple[list[PoseEstimate], Explain]:
    estimates = estimator.estimate(image, targets, recorder)

    def explain(truth: GroundTruth, model: Model) -> Explanation:
        ASKED.append(truth.index)
        if truth.index == 1:
            raise InputError("object 1: nothing is known")
        evidence = (Evidence("votes", 2, 3, "votes", False), Evidence("score", 0.25))
        assert model.obj_id == truth.obj_id
        return Explanation(truth.index, truth.obj_id, "hashing", "too few votes", evidence, {"rank": None})

    return estimates, explain


@pytest.fixture
def run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Run:
    ASKED.clear()
    monkeypatch.setitem(explaining.EXPLAINERS, (Method.__module__, "Method"), __name__)
    root = make_dataset(tmp_path / "tiny")
    return Run.create(tmp_path / "run", dataset=open_dataset(root), method="mine")


def dataset_of(run: Run) -> Dataset:
    return open_dataset(Path(run.info.dataset_root))


def test_what_is_said_about_the_targets_is_recorded_and_read_back(run: Run):
    with run:
        assert run_estimator(Method(), dataset_of(run), run, targets=[Target(*FIRST, 1, 2)]) == 0
    assert ASKED == [0, 1]  # the third instance is of an object that was not sought
    reader = RecordingReader.open(run.recording_path(FIRST))
    told = recorded_explanations(reader)
    assert list(told) == [0]
    assert told[0] == Explanation(
        0,
        1,
        "hashing",
        "too few votes",
        (Evidence("votes", 2, 3, "votes", False), Evidence("score", 0.25)),
        {"rank": None},
    )
    assert reader.read("diagnosis/0/verdict", Text).text == "too few votes"
    columns = reader.read("diagnosis/0", Table).columns
    assert columns["name"].tolist() == ["votes", "score"]
    assert columns["passed"].tolist() == [0, -1]
    assert "instance 1 is not explained: object 1: nothing is known" in [one.text for one in reader.read_all("log")]
    assert len(reader.estimates()) == 1


def test_nothing_is_explained_where_nothing_is_recorded(run: Run):
    with run:
        assert run_estimator(Method(), dataset_of(run), run, record=False) == 0
    assert not ASKED
    assert FIRST in run.finished_images()


def test_a_method_that_cannot_explain_is_recorded_as_ever(run: Run, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(explaining, "EXPLAINERS", {})
    with run:
        assert run_estimator(Method(), dataset_of(run), run, targets=[Target(*SECOND, 1, 1)]) == 0
    assert recorded_explanations(RecordingReader.open(run.recording_path(SECOND))) == {}
    assert not explaining.can_explain(Method())


@dataclass(frozen=True)
class Inner:
    """A part of settings."""

    tau: float = 0.5


@dataclass(frozen=True)
class Settings:
    """Settings with all that JSON changes."""

    folder: Path | None = None
    ids: tuple[int, ...] = ()
    inner: Inner = field(default_factory=Inner)


def test_settings_come_back_as_they_were_kept():
    made = Settings(Path("a/b"), (3, 1), Inner(0.25))
    kept = json.loads(json.dumps(asdict(made), default=str))
    assert settings_of(Settings, kept) == made
    assert settings_of(Settings, {"ids": [2], "of another version": 1}) == Settings(ids=(2,))
