"""Compiled loops are compiled before they are needed."""

import importlib
from pathlib import Path

import numpy as np

from pipeline import warm_up
from pipeline.bop import errors
from pipeline.scene import Model

PIPELINE = Path(warm_up.__file__).parent


def compiled_functions() -> dict[str, list]:
    """Types that each public function of numba's in the pipeline has been compiled for."""
    files = [file for file in PIPELINE.rglob("*.py") if "import njit" in file.read_text("utf-8")]
    names = [".".join(file.relative_to(PIPELINE.parent).with_suffix("").parts) for file in files]
    found = [item for name in names for item in vars(importlib.import_module(name)).items()]
    # Those with an underscore are compiled into the others.
    return {k: list(v.signatures) for k, v in found if hasattr(v, "signatures") and not k.startswith("_")}


def test_nothing_is_left_to_compile():
    warm_up.main()
    warm = compiled_functions()
    assert warm
    assert [name for name, signatures in warm.items() if not signatures] == []

    # As a dataset gives them: other memory layouts, several symmetries, a matrix of single precision.
    corners = np.asfortranarray(np.random.default_rng(0).normal(size=(100, 3)))
    turn = np.diag([-1.0, -1.0, 1.0, 1.0])
    faces = np.zeros((1, 3), np.int32)
    model = Model(obj_id=2, vertices=corners, faces=faces, diameter=1.0, symmetries=np.stack([np.eye(4), turn]))
    pose = np.eye(4, dtype=np.float32)
    errors.mssd(model, pose, pose)
    errors.mspd(model, np.eye(3, dtype=np.float32), pose, pose)
    errors.add(model, pose, pose)
    assert compiled_functions() == warm
