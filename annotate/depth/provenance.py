"""What a folder of depth images was corrected with: a file beside them, that keeps it from being done twice."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import orjson

from pipeline.bop.json_files import read_json_object, write_atomically
from pipeline.exceptions import FormatError, InputError

FILE = "correction.json"


@dataclass(frozen=True)
class Provenance:
    """A correction d_c = a d + b that was applied."""

    a: float
    b_mm: float
    """Millimetres, as all lengths in the files of a BOP dataset."""
    when: str
    """UTC, as ISO 8601."""
    images: int
    too_near: int
    """Pixels that came out at 0 or less and became 0: not measured."""
    too_far: int
    """Pixels that came out beyond 16 bits and took the end of the range."""
    original: str | None
    """Folder with the images as they were, from the scene's folder; None where the source is another dataset."""


def write_provenance(folder: Path, provenance: Provenance) -> None:
    """Write the file into a folder of depth images. Raises InputError if it cannot be written."""
    entry = {"model": "d_c = a d + b", **asdict(provenance)}
    write_atomically(folder / FILE, orjson.dumps(entry, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE))


def read_provenance(folder: Path) -> dict[str, Any] | None:
    """What the images of a folder were corrected with; None if nothing says so. Raises FormatError if it is damaged."""
    path = folder / FILE
    return read_json_object(path) if path.is_file() else None


def check_uncorrected(folder: Path) -> None:
    """Raise InputError if the images of a folder have been corrected already."""
    try:
        found = read_provenance(folder)
    except FormatError as error:
        raise InputError(
            f"{error}; as it is there, the images may be corrected already: nothing was changed"
        ) from error
    if found is not None:
        text = f"a = {found.get('a')}, b = {found.get('b_mm')} mm"
        if found.get("when"):
            text += f", on {found['when']}"
        raise InputError(
            f"{folder}: is corrected already ({text}); a second correction would add to it, so start from the original"
        )
