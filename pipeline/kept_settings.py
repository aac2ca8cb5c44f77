"""Settings of a method as `run.json` and recordings keep them, made into the dataclass again."""

from collections.abc import Mapping
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, TypeVar, get_args, get_type_hints

T = TypeVar("T")


def settings_of(kind: type[T], plain: Mapping[str, Any]) -> T:
    """Settings from what JSON holds of them; what this version does not know is left out, what is missing has defaults."""
    kinds = get_type_hints(kind)
    return kind(**{name: _typed(plain[name], own) for name, own in kinds.items() if name in plain})


def _typed(value: Any, kind: Any) -> Any:
    if isinstance(value, dict) and is_dataclass(kind) and isinstance(kind, type):
        return settings_of(kind, value)
    if isinstance(value, list):
        return tuple(value)
    return Path(value) if isinstance(value, str) and Path in (kind, *get_args(kind)) else value
