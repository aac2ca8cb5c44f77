"""Whether a user is told that the templates do not show objects as the dataset does."""

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hashmatch_parts import COARSE, other_part, part
from parts_dataset import make_parts_dataset

from pipeline.bop.dataset import open_dataset
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.coverage import advice
from pipeline.hashmatch.rendered_templates import learn
from pipeline.scene import Model

CONFIG = replace(COARSE, angle_step_deg=20, in_plane_limit_deg=40)
MODELS = {1: part(), 2: other_part()}


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return make_parts_dataset(tmp_path / "parts")


def told(root: Path, config: HashMatchConfig = CONFIG, models: Mapping[int, Model] = MODELS) -> list[str]:
    learned = [learn(model, config, 300.0) for model in models.values()]
    return advice(open_dataset(root), models, learned, config)


def turn_camera(root: Path, images: int) -> None:
    """Annotate as if the camera had been held upside down in the first images."""
    path = root / "test" / "000001" / "scene_gt.json"
    content = json.loads(path.read_text())
    for im_id in map(str, range(images)):
        for truth in content[im_id]:
            turned = np.diag([-1.0, -1.0, 1.0]) @ np.reshape(truth["cam_R_m2c"], (3, 3))
            truth["cam_R_m2c"] = turned.ravel().tolist()
    path.write_text(json.dumps(content))


def test_upright_objects_are_covered(root: Path):
    assert told(root) == []


def test_objects_turned_beyond_the_templates_are_counted_with_the_option_that_helps(root: Path):
    turn_camera(root, 2)
    (line,) = told(root)
    assert line == (
        "4 of 5 annotated instances are more than 40 degrees from every template; "
        "add --views sphere --in-plane circle, which takes longer"
    )
    assert told(root, replace(CONFIG, views="sphere", in_plane="circle", angle_step_deg=30)) == []


def test_what_cannot_be_read_or_is_not_annotated_does_not_count(root: Path):
    (root / "test" / "000001" / "scene_gt.json").write_text("[")
    assert told(root) == []
    (root / "test" / "000001" / "scene_gt.json").unlink()
    assert told(root) == []
