"""Records to arrow columns and back, without loss.

The columns of a record stand beside what rerun's viewer draws, in components called `pose_inspector.KIND:FIELD`.
`layout`, a JSON text, holds the plain fields and for each array its dtype, shape and the component with its values:
our own column, or the buffer of the image that the viewer draws, so that no image is stored twice.
"""

import json
from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np
import pyarrow as pa

from pipeline.recording.records import KINDS, RECORD_TYPES, Record

PREFIX = "pose_inspector."
LAYOUT_VERSION = 1


def encode(record: Record, drawn: Mapping[str, str]) -> dict[str, pa.Array]:
    """Columns of a record by component name; `drawn` names the viewer's component for fields that it already holds."""
    archetype = PREFIX + KINDS[type(record)]
    columns: dict[str, pa.Array] = {}

    def describe(name: str, value: Any) -> Any:
        if isinstance(value, Mapping):
            return {"mapping": {key: describe(f"{name}.{key}", np.asarray(item)) for key, item in value.items()}}
        if not isinstance(value, np.ndarray):
            return value
        component = drawn.get(name, f"{archetype}:{name}")
        if name not in drawn:
            columns[component] = _to_arrow(name, value)
        return {"component": component, "dtype": value.dtype.str, "shape": value.shape}

    described = {field.name: describe(field.name, getattr(record, field.name)) for field in fields(record)}
    layout = json.dumps({"version": LAYOUT_VERSION, "fields": described}, default=_plain)
    return {f"{archetype}:layout": pa.array([layout]), **columns}


def decode(kind: str, columns: Mapping[str, pa.Array]) -> Any:
    """The record of a kind from its columns by component name.

    Raises:
        ValueError: the columns are of a layout that this version does not know.

    """
    layout = json.loads(columns[f"{PREFIX}{kind}:layout"][0].as_py())
    if layout["version"] != LAYOUT_VERSION:
        raise ValueError(f"record layout {layout['version']}; this version reads {LAYOUT_VERSION}")

    def restore(described: Any) -> Any:
        if isinstance(described, list):
            return tuple(described)
        if not isinstance(described, dict):
            return described
        if "mapping" in described:
            return {key: restore(item) for key, item in described["mapping"].items()}
        return _to_numpy(columns[described["component"]], described["dtype"], described["shape"])

    return RECORD_TYPES[kind](**{name: restore(described) for name, described in layout["fields"].items()})


def _plain(value: Any) -> Any:
    """NumPy scalars as Python numbers, for JSON."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"cannot record a {type(value).__name__}")


def _to_arrow(name: str, array: np.ndarray) -> pa.Array:
    if array.dtype.kind not in "biufU" or not array.dtype.isnative:
        raise ValueError(f"cannot record {name} of dtype {array.dtype}; use native numbers, booleans or strings")
    return pa.array(np.ascontiguousarray(array).reshape(-1))


def _to_numpy(values: pa.Array, dtype: str, shape: list[int]) -> np.ndarray:
    if pa.types.is_list(values.type):  # the viewer's image buffer: one row of bytes
        array = np.frombuffer(values[0].values.to_numpy(), np.dtype(dtype)).reshape(shape)
    else:
        array = values.to_numpy(zero_copy_only=False).astype(dtype, copy=False).reshape(shape)
    array.flags.writeable = False
    return array
