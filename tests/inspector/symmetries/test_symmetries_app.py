"""The page's server: how candidates are shown, and what happens where one cannot be."""

import re
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from tiny_dataset import box, make_dataset

from inspector.symmetries.app import SymmetryApp
from pipeline.bop.models_info.model_set import ModelSet, open_models
from pipeline.scene import Model
from pipeline.symmetry_search.groups import NO_SYMMETRY, Axis, Candidate
from pipeline.symmetry_search.search import SymmetrySearch
from pipeline.symmetry_search.surface import Surface

PATIENCE = 60.0
"""Seconds after which something that should have happened did not."""


@pytest.fixture(scope="module")
def found() -> SymmetrySearch:
    """What a search could say of a square box."""
    about_z = Axis(np.array([0.0, 0.0, 1.0]), np.zeros(3))
    candidates = (
        Candidate("discrete", 4, about_z, 1e-6, 1e-6, 1e-6),
        Candidate("continuous", 0, about_z, 0.008, 0.008, 0.004),
    )
    return SymmetrySearch(candidates, (0,), NO_SYMMETRY, 0.001, 0.015, Surface.of(box(2)), 0.1)


@pytest.fixture
def models(tmp_path: Path) -> ModelSet:
    return open_models(make_dataset(tmp_path / "tiny") / "models")


@pytest.fixture
def app(models: ModelSet, found: SymmetrySearch) -> Iterator[SymmetryApp]:
    """Looking at box 2, of which a half turn is listed; box 1 is still to be searched."""
    app = SymmetryApp(models, port=0)
    app.review.found(1, models.read(models.files[1]), found)
    app.review.select_object(1)
    yield app
    app.stop()


def eventually(check: Callable[[], bool]) -> None:
    end = time.monotonic() + PATIENCE
    while not check():
        assert time.monotonic() < end
        time.sleep(0.02)


def test_a_candidate_begins_at_its_first_turn_and_goes_where_it_is_put(app: SymmetryApp):
    assert app.review.fold == 2  # of the 4-fold axis the file lists only the half turn
    assert app.picture.look.angle == 180
    app.change(angle=30.0)
    app.review.tell("something happens", "info")
    assert app.picture.look.angle == 30
    eventually(lambda: app.picture.measured_mm is not None and app.picture.measured_mm > 1)
    app.command("turn_on")
    assert app.picture.look.angle == 180
    eventually(lambda: app.picture.measured_mm is not None and app.picture.measured_mm < 0.01)
    app.command("more")
    assert (app.review.fold, app.picture.look.angle) == (None, 90)
    app.command("next")
    assert app.picture.look.angle == 75


def test_it_turns_until_somebody_takes_the_angle(app: SymmetryApp):
    app.command("play")
    eventually(lambda: app.picture.look.angle not in (180.0, 90.0))
    app.command("turn_on")
    assert not app.picture.look.playing
    angle = app.picture.look.angle
    assert angle in (0, 180)


def test_a_model_that_cannot_be_drawn_is_told_once(models: ModelSet, monkeypatch: pytest.MonkeyPatch):
    tried = []

    def broken(model: Model) -> None:
        tried.append(model)
        raise RuntimeError("no picture")

    monkeypatch.setattr("inspector.symmetries.picture.shown_model", broken)
    app = SymmetryApp(models, port=0)
    try:
        eventually(lambda: app.review.message == ("this cannot be shown: no picture", "warning"))
        app.review.select_object(1)
        eventually(lambda: len(tried) == 2)
        eventually(lambda: app.review.message[1] == "warning")
        for share in (0.1, 0.2, 0.3):
            app.review.searched(0, share=share)
            app.picture.settle(PATIENCE)
        assert len(tried) == 2
    finally:
        app.stop()


def test_a_damaged_model_is_told_in_one_line(models: ModelSet, caplog: pytest.LogCaptureFixture):
    models.files[0].path.write_text("ply")
    app = SymmetryApp(models, port=0)
    try:
        eventually(lambda: app.review.message[1] == "warning")
        assert re.fullmatch(r"this cannot be shown: .*obj_000001\.ply: .*", app.review.message[0])
        assert app.picture.settle(PATIENCE)
        assert "could not be updated" not in caplog.text
    finally:
        app.stop()


def test_what_cannot_be_saved_is_told_and_stays_unsaved(app: SymmetryApp, models: ModelSet):
    assert models.info_path is not None
    app.command("suggested")
    models.info_path.write_text("{")
    app.command("save")
    text, kind = app.review.message
    assert "models_info.json: is no complete JSON" in text
    assert kind == "warning"
    assert [reviewed.file.obj_id for reviewed in app.review.unsaved] == [2]
    assert models.info_path.read_text() == "{"
    app.command("no such command")
    assert app.review.message == (text, kind)


def test_no_news_after_the_end(models: ModelSet):
    app = SymmetryApp(models, port=0)
    app.stop()
    app.review.searched(0, share=0.5)  # a search ends only with its object
    assert app.review.objects[0].share == 0.5
