"""Reading and writing the JSON files of BOP datasets."""

import contextlib
import gc
import json
import os
import threading
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import orjson

from pipeline.exceptions import FormatError, InputError, MissingFileError


def read_json(path: Path) -> Any:
    """Content of a JSON file; NaN and Infinity are read as Python does.

    Raises MissingFileError if it cannot be read and FormatError if it is no JSON.
    """
    data = read_bytes(path)
    try:
        return orjson.loads(data)
    except orjson.JSONDecodeError:
        pass  # orjson refuses NaN, which Python's own writer produces
    try:
        return json.loads(data.decode("utf-8-sig"))
    except json.JSONDecodeError as error:
        state = "is empty" if not data.strip() else f"is no complete JSON ({error.msg} at line {error.lineno})"
        raise FormatError(f"{path}: {state}; get the file again") from error
    except (UnicodeDecodeError, RecursionError) as error:
        raise FormatError(f"{path}: is no JSON text; get the file again") from error


@contextlib.contextmanager
def collection_paused() -> Iterator[None]:
    """Pause Python's cyclic garbage collection, for reading a large file.

    The hundred thousands of lists in it would set off collections that find nothing and take as long as all the rest.
    """
    was_enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was_enabled:
            gc.enable()


def read_json_object(path: Path) -> dict[str, Any]:
    """Like `read_json` for a file that must hold an object `{...}`."""
    content = read_json(path)
    if not isinstance(content, dict):
        raise FormatError(f"{path}: holds a {type(content).__name__}; expected an object with ids as keys")
    return content


def read_bytes(path: Path, limit: int = -1) -> bytes:
    """Content of a file, at most `limit` bytes of it. Raises MissingFileError if it cannot be read."""
    try:
        with path.open("rb") as file:
            return file.read(limit)
    except FileNotFoundError as error:
        raise MissingFileError(f"{path}: no such file; get it from the dataset") from error
    except OSError as error:
        raise MissingFileError(
            f"{path}: cannot be read ({error.strerror}); check the file and its permissions"
        ) from error


def write_json_by_id(path: Path, entries: Mapping[int, Any]) -> None:
    """Write an object with ids as keys as BOP does, one image or object a line; other processes never see half a file."""
    lines = [f'  "{key}": {orjson.dumps(entries[key]).decode()}' for key in sorted(entries)]
    write_atomically(path, ("{\n" + ",\n".join(lines) + "\n}\n").encode())


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file under a temporary name and rename it. Raises InputError if it cannot be written."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(data)
        temporary.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); choose a folder that you may write to"
        ) from error
