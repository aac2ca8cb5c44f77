"""Reading configuration files (TOML) of `inspector synthesize`, and those that come with the program."""

from __future__ import annotations

import difflib
import tomllib
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, Union, get_args, get_origin, get_type_hints

from pipeline.exceptions import FormatError, InputError, MissingFileError
from pipeline.synth.arranging import Falling, Standing
from pipeline.synth.cameras import CameraRanges
from pipeline.synth.generation.config import SCENE_KINDS, SynthesisConfig
from pipeline.synth.render_and_paste import ViewRanges

FOLDER = Path(__file__).with_name("configs")
CHOICES: Mapping[frozenset[type], tuple[str, dict[str, type]]] = {
    frozenset(SCENE_KINDS.values()): ("kind", dict(SCENE_KINDS)),
    frozenset((Falling, Standing)): ("way", {"falling": Falling, "standing": Standing}),
}
"""Where a table may be of several kinds: the key that says which."""
STAND_INS: Mapping[type, type] = {ViewRanges: CameraRanges}
"""What is read where only an interface is asked for."""


def config_names() -> dict[str, str]:
    """Configurations that come with the program, by name, each with the first line of its comment."""
    return {path.stem: path.read_text().partition("\n")[0].removeprefix("# ") for path in sorted(FOLDER.glob("*.toml"))}


def read_config(source: Path) -> SynthesisConfig:
    """Read a file, or the configuration of that name; paths in it are relative to its folder.

    Raises MissingFileError or FormatError: one line that names the file, the setting, its value and the fix.
    """
    path = source if source.is_file() else FOLDER / f"{source}.toml"
    if not path.is_file():
        raise MissingFileError(f"{source}: no such file; give one, or a name: {', '.join(config_names())}")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise MissingFileError(f"{path}: cannot be read ({error.strerror}); check its permissions") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FormatError(f"{path}: is no TOML ({error}); mend it") from error
    try:
        return _Reader(path.parent).table(SynthesisConfig, table, "")
    except InputError as error:
        raise FormatError(f"{path}: {error}") from error


class _Reader:
    """Tables to dataclasses."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def table(self, kind: type, table: Any, where: str) -> Any:
        """The dataclass that a table describes. Raises InputError."""
        if not isinstance(table, Mapping):
            raise InputError(f"{where} is {table!r}; write a table [{where}] with settings of its own")
        hints = _hints(kind)
        settings = {item.name: hints[item.name] for item in fields(kind) if item.init}
        for name in table:
            if name not in settings:
                raise InputError(_unknown(name, settings, where))
        values = {name: self.value(settings[name], value, _joined(where, name)) for name, value in table.items()}
        try:
            return kind(**values)
        except TypeError as error:  # a setting without a default is missing
            missing = ", ".join(str(error).partition("argument")[2].lstrip("s: ").split(" and "))
            raise InputError(f"{where or 'the file'} lacks {missing or error}; add it") from None
        except InputError as error:
            raise InputError(f"{where}: {error}" if where else str(error)) from None

    def value(self, hint: Any, value: Any, where: str) -> Any:
        """The value of a setting. Raises InputError."""
        options = [option for option in _options(hint) if option is not NoneType]
        if (choice := CHOICES.get(frozenset(options))) is not None:
            return self._chosen(*choice, value, where)
        if len(options) == 1:
            kind = STAND_INS.get(options[0], options[0])
            if kind is Path and isinstance(value, str):
                return (self._folder / Path(value).expanduser()).absolute()
            if is_dataclass(kind) and isinstance(kind, type):
                return self.table(kind, value, where)
            inner = get_args(kind)
            if get_origin(kind) is tuple and inner[1:] == (...,) and frozenset(_options(inner[0])) in CHOICES:
                if not isinstance(value, list):
                    raise InputError(f"{where} is {value!r}; write tables [[{where}]]")
                return tuple(self.value(inner[0], item, f"{where} {i + 1}") for i, item in enumerate(value))
        return _plain(hint, value, where)

    def _chosen(self, key: str, kinds: Mapping[str, type], value: Any, where: str) -> Any:
        if not isinstance(value, Mapping) or value.get(key) not in kinds:
            got = value.get(key) if isinstance(value, Mapping) else value
            raise InputError(f"{where}: {key} is {got!r}; write one of: {', '.join(kinds)}")
        return self.table(kinds[value[key]], {name: item for name, item in value.items() if name != key}, where)


def _plain(hint: Any, value: Any, where: str) -> Any:
    """A number, text, or tuple of them."""
    import msgspec

    try:
        return msgspec.convert(value, hint)
    except msgspec.ValidationError as error:
        expected = str(error).partition(" - at")[0].replace("`", "")
        raise InputError(f"{where} is {value!r}: {expected}") from None


def _options(hint: Any) -> tuple[Any, ...]:
    return get_args(hint) if get_origin(hint) in (Union, UnionType) else (hint,)


@cache
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind)


def _joined(where: str, name: str) -> str:
    return f"{where}.{name}" if where else name


def _unknown(name: str, settings: Mapping[str, Any], where: str) -> str:
    near = difflib.get_close_matches(name, settings, 1)
    advice = f"did you mean {near[0]}?" if near else f"there are: {', '.join(settings)}"
    return f"{_joined(where, name)} is no setting; {advice}"
