"""Symmetries of object models into `models_info.json`, everything else in it as it was."""

import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import orjson
from jaxtyping import Float

from pipeline.bop import layout
from pipeline.bop.json_files import read_json_object, write_atomically
from pipeline.bop.models import read_model, read_models_info
from pipeline.bop.units import millimetres
from pipeline.exceptions import InputError, MissingFileError
from pipeline.scene import Model
from pipeline.symmetry_search.groups import SymmetryGroup

INFO_FILE = "models_info.json"
_DIGITS = 9
"""Decimals that are written: far below the nanometre, and no -1.2e-17."""


def model_paths(path: Path) -> dict[int, Path]:
    """Model files by object id: of a folder all `obj_*`, of a file its own (0 if its name has no number).

    Raises MissingFileError if there is none.
    """
    if path.is_file():
        number = path.stem.removeprefix("obj_")
        return {int(number) if number.isdecimal() else 0: path}
    found = layout.model_files(path) if path.is_dir() else {}
    if not found:
        problem = "has no models (obj_000001.ply, ...)" if path.is_dir() else "no such folder or file"
        raise MissingFileError(f"{path}: {problem}; give a dataset's models folder, such as models_eval")
    return found


def read_models(paths: Mapping[int, Path]) -> dict[int, Model]:
    """Models with their colours. Raises InputError that names the file if one cannot be read."""
    folder = next(iter(paths.values())).parent
    infos = read_models_info(folder / INFO_FILE) if (folder / INFO_FILE).is_file() else {}
    return {obj_id: read_model(path, obj_id, infos.get(obj_id)) for obj_id, path in paths.items()}


def symmetry_entry(group: SymmetryGroup) -> dict[str, list[Any]]:
    """The keys that BOP has for a set of symmetries, millimetres; none for a key without symmetries."""
    entry: dict[str, list[Any]] = {}
    if len(group.discrete):
        entry["symmetries_discrete"] = [_rounded(_matrix_mm(turn).ravel()) for turn in group.discrete]
    if group.continuous:
        entry["symmetries_continuous"] = [
            {"axis": _rounded(axis.direction), "offset": _rounded(millimetres(axis.through))}
            for axis in group.continuous
        ]
    return entry


def write_symmetries(folder: Path, groups: Mapping[int, SymmetryGroup], models: Mapping[int, Model]) -> Path | None:
    """Write sets of symmetries into a folder's `models_info.json`, which is made if it is absent.

    Other objects, and other keys of an object, stay as they are; what was there is kept beside it.

    Args:
        folder: Folder of the models.
        groups: By object id; a set without symmetries removes those that are listed.
        models: The folder's models by object id, of which an absent file's sizes are computed.

    Returns:
        The copy of the earlier file; None if there was none.

    Raises:
        InputError: The file is damaged or cannot be written; nothing is changed then.

    """
    path = folder / INFO_FILE
    content = read_json_object(path) if path.is_file() else {}
    for obj_id in groups.keys() | (models.keys() if not content else set()):
        entry = content.setdefault(str(obj_id), {} if obj_id not in models else size_entry(models[obj_id]))
        if obj_id in groups:
            for key in ("symmetries_discrete", "symmetries_continuous"):
                entry.pop(key, None)
            entry |= symmetry_entry(groups[obj_id])
    backup = _kept(path) if path.is_file() else None
    lines = [f"  {orjson.dumps(key).decode()}: {orjson.dumps(content[key]).decode()}" for key in _in_order(content)]
    write_atomically(path, ("{\n" + ",\n".join(lines) + "\n}\n").encode())
    return backup


def size_entry(model: Model) -> dict[str, float]:
    """What BOP says of a model's size, millimetres."""
    low, high = millimetres(model.vertices.min(axis=0)), millimetres(model.vertices.max(axis=0))
    corners = {f"min_{axis}": value for axis, value in zip("xyz", low.tolist(), strict=True)}
    sizes = {f"size_{axis}": value for axis, value in zip("xyz", (high - low).tolist(), strict=True)}
    return {"diameter": model.diameter * 1000, **corners, **sizes}


def _matrix_mm(turn: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    matrix = turn.copy()
    matrix[:3, 3] = millimetres(turn[:3, 3])
    return matrix


def _rounded(values: Float[np.ndarray, "n"]) -> list[float]:
    return (np.round(values, _DIGITS) + 0.0).tolist()


def _in_order(content: Mapping[str, Any]) -> list[str]:
    """Keys of objects by number, others behind them."""
    return sorted(content, key=lambda key: (not key.isdecimal(), int(key) if key.isdecimal() else 0, key))


def _kept(path: Path) -> Path:
    """Copy a file to the first free name beside it."""
    number = next(n for n in range(1, 10_000) if not path.with_name(f"{path.name}.bak{n}").exists())
    backup = path.with_name(f"{path.name}.bak{number}")
    try:
        shutil.copy2(path, backup)
    except OSError as error:
        raise InputError(
            f"{backup}: cannot be written ({error.strerror}); free space or allow writing there"
        ) from error
    return backup
