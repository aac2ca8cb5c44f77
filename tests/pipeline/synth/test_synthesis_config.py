"""Configuration files of `inspector synthesize`: read as they are meant, and refused in one line where they are not."""

from dataclasses import replace
from pathlib import Path

import pytest

from pipeline.exceptions import FormatError, InputError, MissingFileError
from pipeline.synth.arranging import Falling, Standing
from pipeline.synth.generation.config import BoardScene, PastedScene, SynthesisConfig, TracedScene
from pipeline.synth.generation.config_file import config_names, read_config
from pipeline.synth.generation.planning import as_json, difference, intrinsics, make_recipes, sensor


def config_of(tmp_path: Path, text: str) -> SynthesisConfig:
    path = tmp_path / "config.toml"
    path.write_text(text)
    return read_config(path)


def refusal(tmp_path: Path, text: str) -> str:
    with pytest.raises(InputError) as caught:
        make_recipes(config_of(tmp_path, text))
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("name", config_names())
def test_what_comes_with_the_program_can_be_made(name: str):
    config = read_config(Path(name))
    recipes = make_recipes(config)
    assert len(recipes) == sum(scene.scenes for scene in config.scene)
    assert config_names()[name]


def test_settings_arrive_where_they_belong(tmp_path: Path):
    (tmp_path / "pictures").mkdir()
    config = config_of(
        tmp_path,
        """
        models = "lmo"
        split = "train_pbr"
        seed = 4
        [camera]
        sensor = "kinect_v1"
        [depth]
        sensor = "kinect_v2"
        a = 1.5
        [[scene]]
        kind = "traced"
        scenes = 2
        arrangements = 3
        images = 4
        worlds = ["kitchen"]
        [scene.arranging]
        way = "standing"
        gap = [0.01, 0.02]
        [scene.cameras]
        elevation_deg = [10, 20]
        [[scene]]
        kind = "pasted"
        images = 7
        [scene.settings]
        backgrounds = "pictures"
        [[scene]]
        kind = "board"
        azimuths_deg = [0, 90]
        elevations_deg = [30]
        [scene.board]
        dictionary = "DICT_APRILTAG_36h11"
        """,
    )
    traced, pasted, board = config.scene
    assert config.models == tmp_path / "lmo"
    assert isinstance(traced, TracedScene)
    assert traced.arranging == Standing(gap=(0.01, 0.02))
    assert traced.cameras.elevation_deg == (10.0, 20.0)
    assert isinstance(pasted, PastedScene)
    assert pasted.settings.backgrounds == tmp_path / "pictures"
    assert isinstance(board, BoardScene)
    assert board.board.dictionary == "DICT_APRILTAG_36h11"
    assert config.images == 2 * 3 * 4 + 7 + 2
    assert [scene_id for scene_id, _ in config.scenes()] == [0, 1, 2, 3]
    assert sensor(config.depth).a == 1.5
    assert sensor(config.depth).b == sensor(replace(config.depth, a=None)).b
    assert intrinsics(config.camera).width == 640


def test_an_object_falls_unless_it_is_to_stand(tmp_path: Path):
    (scene,) = config_of(tmp_path, '[[scene]]\nkind = "traced"').scene
    assert isinstance(scene, TracedScene)
    assert scene.arranging == Falling()


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("", "no \\[\\[scene\\]\\]|lacks"),
        ("speed = 3", "speed is no setting; did you mean seed\\?"),
        ('seed = "x"', "seed is 'x': Expected int, got str"),
        ('[[scene]]\nkind = "painted"', "scene 1: kind is 'painted'; write one of: traced, pasted, board"),
        ("[[scene]]\nimages = 3", "scene 1: kind is None"),
        ('[[scene]]\nkind = "traced"\nimagse = 3', "scene 1.imagse is no setting; did you mean images"),
        ('[[scene]]\nkind = "traced"\nimages = 0', "give 1 or more"),
        ('[[scene]]\nkind = "traced"\nworlds = ["cellar"]', "world cellar is not in the worlds; available: cube_room"),
        ('[[scene]]\nkind = "traced"\nworlds = ["office"]\nstages = ["roof"]', "stage roof is not in world office"),
        ('[[scene]]\nkind = "traced"\nquality = "best"', "best"),
        ('[[scene]]\nkind = "traced"\ncount = [3, 2]', "count is \\[3, 2\\]; give the least"),
        ('[[scene]]\nkind = "traced"\nobjects = [77]', "object 77 is not in the models of parts; available: 1, 2"),
        ('[[scene]]\nkind = "traced"\n[scene.cameras]\ndistance = [2, 1]', "the lower limit is above the upper"),
        ('[[scene]]\nkind = "traced"\n[scene.arranging]\nway = "flying"', "way is 'flying'; write one of: falling"),
        ('[[scene]]\nkind = "board"\nazimuths_deg = []', "sets 0; give 1 or more"),
        ('[[scene]]\nkind = "board"\n[scene.board]\ndictionary = "DICT_X"', "DICT_X"),
        ('[[scene]]\nkind = "pasted"\n[scene.settings]\nbackgrounds = "none"', "none"),
        ('models = "absent"\n[[scene]]\nkind = "pasted"', "absent: no such folder"),
        ('[camera]\nwidth = 640\n[[scene]]\nkind = "pasted"', "width without height, fx, fy, cx, cy"),
        ('[camera]\nsensor = "leica"\n[[scene]]\nkind = "pasted"', "leica"),
        ('[depth]\nsensor = "leica"\n[[scene]]\nkind = "pasted"', "leica"),
        ('depth_scale = 0\n[[scene]]\nkind = "pasted"', "depth_scale is 0"),
        ('split = "a/b"\n[[scene]]\nkind = "pasted"', "split is 'a/b'"),
        ('seed = -1\n[[scene]]\nkind = "pasted"', "seed is -1; give 0 or more"),
        ("seed = ", "is no TOML"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line(tmp_path: Path, text: str, told: str):
    import re

    message = refusal(tmp_path, text)
    assert re.search(told, message), message


def test_a_file_that_is_not_there_is_answered_with_the_names_that_are():
    with pytest.raises(MissingFileError, match="bop20, demo"):
        read_config(Path("nothing.toml"))


def test_models_in_metres_are_caught(tmp_path: Path):
    from pipeline.synth.demo.part_files import write_part_models

    write_part_models(tmp_path / "set" / "models")
    path = tmp_path / "set" / "models" / "obj_000002.ply"
    head, _, body = path.read_bytes().partition(b"end_header\n")
    import numpy as np

    count = int(head.split(b"element vertex ")[1].split()[0])
    vertices = np.frombuffer(body, np.dtype([("p", "<f4", 3), ("n", "<f4", 3), ("c", "u1", 3)]), count).copy()
    vertices["p"] /= 1000.0
    path.write_bytes(head + b"end_header\n" + vertices.tobytes() + body[vertices.nbytes :])
    message = refusal(tmp_path, 'models = "set"\n[[scene]]\nkind = "pasted"')
    assert "obj_000002.ply: the object is 0.0951 mm large" in message
    assert "multiply its vertices by 1000" in message


def test_the_first_setting_that_differs_is_named(tmp_path: Path):
    one = config_of(tmp_path, '[[scene]]\nkind = "traced"\n[scene.cameras]\ndistance = [0.5, 1]')
    other = config_of(tmp_path, '[[scene]]\nkind = "traced"\n[scene.cameras]\ndistance = [0.6, 1]')
    assert difference(as_json(one), as_json(one)) == ""
    assert difference(as_json(one), as_json(other)) == "scene 1.cameras.distance was [0.5, 1.0], now [0.6, 1.0]"


def test_damaged_text_is_told(tmp_path: Path):
    path = tmp_path / "config.toml"
    path.write_bytes(b"\xff\xfe")
    with pytest.raises(FormatError, match="is no TOML"):
        read_config(path)


def test_the_configuration_in_the_readme_can_be_read(tmp_path: Path):
    import re

    readme = (Path(__file__).parents[3] / "README.md").read_text("utf-8")
    found = re.search(r"```toml\n(.*?)```", readme, re.DOTALL)
    assert found
    config = config_of(tmp_path, found[1].replace("# cameras_of", "cameras_of"))
    assert config.images == 2 * 40 * 25
    assert config.scene[0].cameras_of == tmp_path / "path" / "to" / "lmo"  # type: ignore[union-attr]
