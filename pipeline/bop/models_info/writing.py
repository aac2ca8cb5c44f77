"""Writing symmetries to `models_info.json`: what is there stays as it is, and a copy of the file before is kept."""

import codecs
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import orjson

from pipeline.bop.json_files import read_bytes, write_atomically, write_json_by_id
from pipeline.bop.models import diameter_of, read_models_info
from pipeline.bop.models_info.json_edit import members, with_members
from pipeline.bop.models_info.symmetries import CONTINUOUS, DISCRETE, entries_of
from pipeline.bop.units import millimetres
from pipeline.exceptions import FormatError
from pipeline.scene import Model
from pipeline.symmetry_search.groups import SymmetryGroup


class Written(NamedTuple):
    """What writing has done."""

    path: Path
    backup: Path | None
    """Copy of the file as it was; None if there was none, or nothing to change."""
    changed: bool
    """Whether the file is different now."""


def model_entry(model: Model) -> dict[str, float]:
    """Diameter and bounding box of a model as BOP lists them: `diameter`, `min_x`..., `size_x`..., millimetres."""
    low, size = model.vertices.min(axis=0), np.ptp(model.vertices, axis=0)
    entry = {"diameter": diameter_of(model.vertices)}
    entry |= {f"min_{axis}": value for axis, value in zip("xyz", low, strict=True)}
    entry |= {f"size_{axis}": value for axis, value in zip("xyz", size, strict=True)}
    rounded = np.round(millimetres(np.array(list(entry.values()))), 6)
    return {name: value + 0.0 for name, value in zip(entry, rounded.tolist(), strict=True)}


def write_symmetries(
    path: Path, groups: Mapping[int, SymmetryGroup], facts: Mapping[int, Mapping[str, Any]], *, backup: bool = True
) -> Written:
    """Write the symmetries of some objects; an empty set removes what the file lists for the object.

    Every other member and every other object keeps its text as it is. The file before is kept as
    `models_info.json.bak`, or with a number where that exists.

    Args:
        path: The `models_info.json`; it is made if there is none.
        groups: Symmetries by object id.
        facts: Entries (of `model_entry`): of all models if there is no file, else of those that it does not list yet.
        backup: Keep a copy of the file as it was.

    Raises:
        FormatError: The file is there, but is no `models_info.json`.
        InputError: It cannot be read or written.

    """
    if not path.is_file():
        entries = {obj_id: {**fact, **_symmetries(groups, obj_id)} for obj_id, fact in facts.items()}
        write_json_by_id(path, entries)
        return Written(path, None, True)
    read_models_info(path)  # names what is wrong with the file
    before = read_bytes(path)
    after = _changed(path, before, groups, facts)
    if after == before:
        return Written(path, None, False)
    kept = _backup_name(path) if backup else None
    if kept is not None:
        write_atomically(kept, before)
    write_atomically(path, after)
    return Written(path, kept, True)


def _changed(
    path: Path, before: bytes, groups: Mapping[int, SymmetryGroup], facts: Mapping[int, Mapping[str, Any]]
) -> bytes:
    mark = codecs.BOM_UTF8 if before.startswith(codecs.BOM_UTF8) else b""
    try:
        text = before[len(mark) :].decode()
        keys = {int(member.key): member for member in members(text)[0]}
        changes = {}
        for obj_id, group in groups.items():
            if obj_id in keys:
                old = text[keys[obj_id].value : keys[obj_id].end]
                lists = entries_of(group)
                new = {name: _json(lists[name]) if name in lists else None for name in (DISCRETE, CONTINUOUS)}
                changes[keys[obj_id].key] = with_members(old, new)
        missing = sorted(groups.keys() - keys.keys())
        changes |= {str(i): _json({**facts[i], **_symmetries(groups, i)}) for i in missing}
        return mark + with_members(text, changes).encode()
    except ValueError as error:
        raise FormatError(f"{path}: is no complete JSON text; get the file again") from error


def _symmetries(groups: Mapping[int, SymmetryGroup], obj_id: int) -> dict[str, Any]:
    return entries_of(groups[obj_id]) if obj_id in groups else {}


def _json(value: Any) -> str:
    return orjson.dumps(value).decode()


def _backup_name(path: Path) -> Path:
    """The first name for a copy that is free."""
    names = (path.with_name(f"{path.name}.bak{number or ''}") for number in range(1_000_000) if number != 1)
    return next(name for name in names if not name.exists())
