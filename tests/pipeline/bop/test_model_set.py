"""Which meshes a folder or a file names, and what is said where there is none."""

from pathlib import Path

import numpy as np
import pytest
import trimesh
from tiny_dataset import make_dataset

from pipeline.bop.models_info.model_set import open_models
from pipeline.exceptions import FormatError, MissingFileError, UnknownIdError


@pytest.fixture
def models(tmp_path: Path) -> Path:
    return make_dataset(tmp_path / "tiny") / "models"


def test_a_folder_gives_its_models_and_where_symmetries_go(models: Path):
    found = open_models(models)
    assert [file.obj_id for file in found.files] == [1, 2]
    assert found.info_path == models / "models_info.json"
    assert found.infos()[2]["symmetries_discrete"]
    assert found.read(found.files[0]).diameter == pytest.approx(np.linalg.norm([60, 40, 20]) / 1000)
    assert [file.obj_id for file in open_models(models, [2]).files] == [2]


def test_the_folder_of_a_dataset_is_told_where_its_models_are(models: Path):
    with pytest.raises(MissingFileError, match=r"has no model .*name the folder of models itself: .*tiny/models"):
        open_models(models.parent)


def test_an_object_that_is_not_there_is_told(models: Path):
    with pytest.raises(UnknownIdError, match=r"object 9 is not in .*; available: 1, 2"):
        open_models(models, [1, 9])


def test_a_single_model_writes_to_its_own_entry(models: Path):
    found = open_models(models / "obj_000002.ply")
    assert [file.name for file in found.files] == ["object 2"]
    assert found.info_path == models / "models_info.json"


def test_the_file_that_evaluation_reads_first_is_known(models: Path):
    assert open_models(models).overruled_by is None
    first = models.with_name("models_eval")
    first.mkdir()
    assert open_models(models).overruled_by is None
    for path in models.iterdir():
        (first / path.name).write_bytes(path.read_bytes())
    assert open_models(models).overruled_by == first / "models_info.json"
    assert open_models(first).overruled_by is None


@pytest.mark.parametrize("suffix", [".stl", ".obj", ".off"])
def test_other_meshes_are_read_in_millimetres(tmp_path: Path, suffix: str):
    path = tmp_path / f"part{suffix}"
    trimesh.creation.box((60, 40, 20)).export(path)
    found = open_models(path)
    assert found.info_path is None
    assert found.files[0].name == "part"
    model = found.read(found.files[0])
    assert len(model.vertices) == 8
    assert model.diameter == pytest.approx(np.linalg.norm([0.06, 0.04, 0.02]))


def test_what_is_no_mesh_is_told(tmp_path: Path):
    (tmp_path / "notes.txt").write_text("x")
    (tmp_path / "part.stl").write_bytes(b"solid nothing")
    with pytest.raises(FormatError, match="is no mesh; name a folder of models, or a mesh of one of these kinds"):
        open_models(tmp_path / "notes.txt")
    with pytest.raises(MissingFileError, match="no such file or folder"):
        open_models(tmp_path / "absent")
    broken = open_models(tmp_path / "part.stl")
    with pytest.raises(FormatError, match=r"part\.stl: (is no readable mesh|has no faces)"):
        broken.read(broken.files[0])


def test_colours_come_from_the_folder_beside_where_the_models_have_none(models: Path):
    plain, colored = models.rename(models.with_name("models_eval")), models
    colored.mkdir()
    mesh = trimesh.load_mesh(plain / "obj_000001.ply", process=False)
    mesh.visual.vertex_colors = np.tile([10, 200, 30, 255], (8, 1))
    mesh.export(colored / "obj_000001.ply")
    found = open_models(plain)
    shown = found.read_for_display(found.files[0])
    assert shown.colors is not None
    assert shown.colors[0].tolist() == [10, 200, 30]
    assert found.read_for_display(found.files[1]).colors is None
