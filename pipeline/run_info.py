"""What a run was made of: `run.json`."""

import dataclasses
import json
import os
import platform
import secrets
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, Protocol, runtime_checkable

from pipeline.exceptions import FormatError, InputError, MissingFileError

RUN_FILE = "run.json"
RUN_VERSION = 1

_PACKAGES = ("pose-inspector", "numpy", "rerun-sdk")


@runtime_checkable
@runtime_checkable
class DatasetName(Protocol):
    """What a run keeps of a dataset; `pipeline.bop.dataset.Dataset` has it."""

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def split(self) -> str: ...  # noqa: D102
    @property
    def root(self) -> Path: ...  # noqa: D102


@dataclasses.dataclass(frozen=True)
class RunInfo:
    """What `run.json` says."""

    dataset_name: str
    dataset_split: str
    dataset_root: str
    method: str
    config: Mapping[str, Any]
    seed: int
    recording_id: str
    """Shared by the recordings of all images."""
    created: str
    """ISO 8601, UTC."""
    versions: Mapping[str, str]


_KINDS: dict[str, type] = {
    field.name: {"config": dict, "versions": dict, "seed": int}.get(field.name, str)
    for field in dataclasses.fields(RunInfo)
}
_EXPECTED = {str: "text", int: "a whole number", dict: "an object {...}"}


def read_info(root: Path) -> RunInfo:
    """What `run.json` in a run folder says.

    Raises:
        MissingFileError: there is none.
        FormatError: it is damaged or of another version.

    """
    path = root / RUN_FILE
    try:
        content = json.loads(path.read_bytes())
    except FileNotFoundError as error:
        raise MissingFileError(
            f"{path}: no such file; {root} is no run folder (`inspector record` makes one)"
        ) from error
    except OSError as error:
        raise MissingFileError(f"{path}: cannot be read: {error.strerror}") from error
    except ValueError as error:
        raise FormatError(f"{path}: no valid JSON ({error}); the run has to be started again") from error
    found = content.get("version") if isinstance(content, dict) else None
    if found != RUN_VERSION:
        text = f"run format version {found}; this program reads version {RUN_VERSION}"
        raise FormatError(f"{path}: {text}; open it with the program that wrote it, or run again")
    missing = [name for name in _KINDS if name not in content]
    if missing:
        raise FormatError(f"{path}: lacks {', '.join(missing)}; the run has to be started again")
    for name, kind in _KINDS.items():
        if not isinstance(content[name], kind):
            raise FormatError(f"{path}: {name} is {content[name]!r:.60}; expected {_EXPECTED[kind]}")
    return RunInfo(**{name: content[name] for name in _KINDS})


def new_info(dataset: DatasetName, method: str, config: object, seed: int) -> RunInfo:
    """What a run that starts now is made of; `config` is a dataclass or a mapping that JSON can hold."""
    if dataclasses.is_dataclass(config) and not isinstance(config, type):
        config = dataclasses.asdict(config)
    return RunInfo(
        dataset_name=dataset.name,
        dataset_split=dataset.split,
        dataset_root=str(dataset.root.resolve()),
        method=method,
        config=json.loads(json.dumps(config or {}, default=str)),  # as it will be read back, to be compared
        seed=seed,
        recording_id=secrets.token_hex(16),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        versions={"python": platform.python_version(), **{name: _version(name) for name in _PACKAGES}},
    )


def same_run(root: Path, old: RunInfo, new: RunInfo) -> RunInfo:
    """The run in the folder, if it can be gone on with as `new`; InputError if the two differ."""
    for name in ("dataset_name", "dataset_split", "method", "config", "seed"):
        if getattr(old, name) != getattr(new, name):
            text = _difference("", getattr(old, name), getattr(new, name))
            raise InputError(f"{root}: holds a run with another {name.replace('_', ' ')} ({text}); give another folder")
    return old


def _difference(name: str, old: object, new: object) -> str:
    """What differs, of mappings only the entries that do."""
    if isinstance(old, Mapping) and isinstance(new, Mapping):
        start = f"{name}." if name else ""
        keys = [key for key in {**old, **new} if old.get(key) != new.get(key)]
        return ", ".join(_difference(f"{start}{key}", old.get(key), new.get(key)) for key in keys)
    return f"{name} {old}, not {new}".lstrip()


def write_info(root: Path, info: RunInfo, timings: Mapping[str, float]) -> None:
    """Write `run.json`, whole or not at all; `timings` are seconds by stage."""
    content = {"version": RUN_VERSION, **dataclasses.asdict(info), "timings": timings}
    temporary = root / f".{RUN_FILE}.{os.getpid()}"
    temporary.write_text(json.dumps(content, indent=2) + "\n")
    temporary.replace(root / RUN_FILE)


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "unknown"
