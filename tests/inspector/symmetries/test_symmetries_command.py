"""`inspector symmetries` without a browser: what it prints, writes and refuses to replace."""

import io
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console
from tiny_dataset import make_dataset

from inspector.commands.symmetries import SymmetriesConfig, run
from pipeline.exceptions import InputError, MissingFileError
from pipeline.scene import Model
from pipeline.symmetry_search.search import SymmetrySearch, find_symmetries


@pytest.fixture
def models(tmp_path: Path) -> Path:
    return make_dataset(tmp_path / "tiny") / "models"


@pytest.fixture(scope="module", autouse=True)
def searched_once() -> Iterator[None]:
    """A search takes seconds; what it finds for a model is the same each time."""
    found: dict[int, SymmetrySearch] = {}

    def find(model: Model, *arguments: Any, **options: Any) -> SymmetrySearch:
        if model.obj_id not in found:
            found[model.obj_id] = find_symmetries(model, *arguments, **options)
        return found[model.obj_id]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("inspector.symmetries.unattended.find_symmetries", find)
        yield


def told(config: SymmetriesConfig) -> tuple[int, str]:
    output = io.StringIO()
    code = run(config, Console(file=output, width=200))
    return code, output.getvalue()


def test_all_that_was_found_is_written_as_json(models: Path, tmp_path: Path):
    out = tmp_path / "found.json"
    code, text = told(SymmetriesConfig(models, objects=(2,), json=out))
    assert code == 0
    assert "D4: 4-fold and flips" in text
    content = json.loads(out.read_text())["objects"]
    assert list(content) == ["2"]
    found = content["2"]
    assert found["candidate_bound_mm"] == 15
    assert found["epsilon_mm"] == pytest.approx(0.6, abs=0.01)  # 1 % of the diameter: it fits exactly
    assert len(found["suggested"]["symmetries_discrete"]) == 7
    assert found["listed"] == "C2: 2-fold"
    assert found["suggested_is_listed"] is False
    best = found["candidates"][0]
    assert (best["kind"], best["fold"], best["axis"], best["suggested"]) == ("discrete", 4, [0, 0, 1], True)
    assert best["distance_mm"] < 0.01
    assert not (models / "models_info.json.bak").exists()


def test_what_is_suggested_is_written_but_replaces_nothing_unasked(models: Path):
    path = models / "models_info.json"
    before = json.loads(path.read_text())
    code, text = told(SymmetriesConfig(models, write=True))
    after = json.loads(path.read_text())
    assert code == 1
    assert "object 2: models_info.json lists C2: 2-fold, suggested is D4: 4-fold and flips; kept" in text
    assert after["2"] == before["2"]
    assert len(after["1"]["symmetries_discrete"]) == 3
    assert json.loads(path.with_name("models_info.json.bak").read_text()) == before
    code, text = told(SymmetriesConfig(models, objects=(2,), write=True, force=True))
    assert code == 0
    assert "1 object changed; the file before is models_info.json.bak2" in text
    assert len(json.loads(path.read_text())["2"]["symmetries_discrete"]) == 7


def test_models_that_cannot_be_searched_are_left_out_and_the_others_written(models: Path, tmp_path: Path):
    path, out = models / "models_info.json", tmp_path / "found.json"
    content = json.loads(path.read_text())
    content["2"]["symmetries_discrete"] = [[1, 2, 3]]
    path.write_text(json.dumps(content))
    (models / "obj_000003.ply").write_text("ply")
    code, text = told(SymmetriesConfig(models, write=True, json=out))
    assert code == 1
    assert "models_info.json: object 2: symmetries_discrete holds [1, 2, 3]; expected 16 finite numbers" in text
    assert re.search(r"left out: .*obj_000003\.ply: ", text)
    assert list(json.loads(out.read_text())["objects"]) == ["1"]
    after = json.loads(path.read_text())
    assert len(after["1"]["symmetries_discrete"]) == 3
    assert after["2"] == content["2"]


def test_every_candidate_is_printed_and_the_suggested_ones_marked(models: Path, tmp_path: Path):
    _, text = told(SymmetriesConfig(models, objects=(2,), json=tmp_path / "found.json"))
    lines = [line for line in text.splitlines() if "about" in line]
    assert len(lines) >= 5
    assert "✓ 4-fold about z " in lines[0]
    assert any("✓" not in line for line in lines)


def test_nothing_found_leaves_no_file(tmp_path: Path):
    models = tmp_path / "models"
    models.mkdir()
    (models / "obj_000001.ply").write_text("ply")
    code, _ = told(SymmetriesConfig(models, write=True))
    assert code == 1
    assert not (models / "models_info.json").exists()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"epsilon_mm": 0.0}, r"--epsilon-mm is 0.0; give millimetres above 0"),
        ({"epsilon_mm": float("nan")}, "--epsilon-mm is nan"),
        ({"force": True}, "--force goes with --write"),
        ({"objects": (5,)}, "object 5 is not in .*; available: 1, 2"),
    ],
)
def test_options_that_make_no_sense_are_named(models: Path, options: dict, message: str):
    with pytest.raises(InputError, match=message):
        run(SymmetriesConfig(models, **options))


def test_a_mesh_without_an_id_is_not_written(models: Path):
    part = models / "part.ply"
    part.write_bytes((models / "obj_000001.ply").read_bytes())
    with pytest.raises(InputError, match=r"part\.ply: is not named obj_ID\.ply, so no entry is its own"):
        run(SymmetriesConfig(part, write=True))


def test_a_folder_without_models_is_named(tmp_path: Path):
    with pytest.raises(MissingFileError, match=r"has no model \(obj_000001\.ply\)"):
        run(SymmetriesConfig(tmp_path))
