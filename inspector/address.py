"""A selection as the query of an address, and back; what an address gets wrong is as at the start."""

from collections.abc import Iterator
from dataclasses import fields, is_dataclass, replace
from functools import cache
from types import UnionType
from typing import Any, Literal, get_args, get_origin, get_type_hints
from urllib.parse import parse_qsl, urlencode

from inspector.selection import RowKey, Selection

_NONE = "none"
_RANGES = {"zoom": (0.2, 200.0), "display.opacity": (0.0, 1.0), "center_u": (-1.0, 2.0), "center_v": (-1.0, 2.0)}


def to_query(selection: Selection, default: Selection | None = None) -> str:
    """Write the selection as a URL query; only what differs from `default` is named."""
    usual = dict(_leaves(default or Selection()))
    pairs = [(name, _to_text(value)) for name, value in _leaves(selection) if value != usual[name]]
    return urlencode(pairs, safe=",/")


def from_query(query: str, default: Selection | None = None) -> Selection:
    """Read a selection back from a URL query; what is missing or does not parse is as in `default`."""
    return _read(default or Selection(), dict(parse_qsl(query.lstrip("?"))))


def _leaves(part: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """Name and value of all fields, those of parts as `part.field`."""
    for item in fields(part):
        value = getattr(part, item.name)
        if is_dataclass(value):
            yield from _leaves(value, f"{prefix}{item.name}.")
        else:
            yield prefix + item.name, value


def _read(default: Any, values: dict[str, str], prefix: str = "") -> Any:
    changes = {}
    for item in fields(default):
        name, usual = prefix + item.name, getattr(default, item.name)
        if is_dataclass(usual):
            changes[item.name] = _read(usual, values, f"{name}.")
        elif name in values:
            try:
                changes[item.name] = _from_text(name, values[name], _types(type(default))[item.name])
            except ValueError:
                continue
    return replace(default, **changes)


@cache
def _types(owner: type) -> dict[str, Any]:
    return get_type_hints(owner)


def _to_text(value: object) -> str:
    if value is None:
        return _NONE
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, tuple):
        return ",".join(map(_to_text, value))
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def _from_text(name: str, text: str, kind: Any) -> Any:
    """Read a value of a type; ValueError if it is none."""
    if get_origin(kind) is UnionType:
        if text == _NONE:
            return None
        (kind,) = [one for one in get_args(kind) if one is not type(None)]
    if get_origin(kind) is Literal:
        return text if text in get_args(kind) else _refuse(text)
    if kind is RowKey:
        return RowKey(*map(int, text.split(","))) if text.count(",") == 4 else _refuse(text)
    if kind is bool:
        return bool(int(text))
    if kind is int:
        return int(text)
    if kind is float:
        lowest, highest = _RANGES.get(name, (-1e9, 1e9))
        return min(max(_finite(text), lowest), highest)
    if get_origin(kind) is tuple:
        numbers = tuple(_finite(part) for part in text.split(","))
        return numbers if len(numbers) == len(get_args(kind)) else _refuse(text)
    return text


def _finite(text: str) -> float:
    number = float(text)
    return number if abs(number) < 1e12 else _refuse(text)


def _refuse(text: str) -> Any:
    raise ValueError(text)
