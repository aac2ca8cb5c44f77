"""Templates on disk, found again by what they were made from.

One file per object, and while it is learned one per part, so that learning goes on where it stopped and a new object
leaves the others as they are. Names hold a digest of all that the templates depend on but this program, which the
content names: what another version of it made, and what is damaged, is made anew.
"""

import hashlib
import io
import logging
import zipfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from pipeline.bop.json_files import write_atomically
from pipeline.exceptions import FormatError, InputError
from pipeline.hashmatch.template_source import TemplateSource
from pipeline.hashmatch.templates import Templates

log = logging.getLogger(__name__)

_MAKERS = (
    "captured_templates", "captured_views", "channels", "objectness", "rendered_templates", "template_making", "templates",
    "view_points", "viewpoints", "views", "../ray_casting", "../rendering", "../shading",
)  # fmt: skip
"""Modules that decide what templates hold."""


@cache
def version() -> str:
    """Digest of the part of this program that makes templates."""
    digest = hashlib.sha256()
    for name in _MAKERS:
        digest.update((Path(__file__).parent / f"{name}.py").read_bytes())
    return digest.hexdigest()[:12]


def default_folder() -> Path:
    """Folder of the templates in the user's cache."""
    from platformdirs import user_cache_path

    return user_cache_path("inspector") / "templates"


class OtherVersionError(FormatError):
    """Templates that another version of this program made."""


@dataclass(frozen=True)
class TemplateCache:
    """A folder of templates, made when the first ones are put there."""

    folder: Path

    def name(self, source: TemplateSource, obj_id: int) -> str:
        """Name of an object's templates. Raises InputError if the source cannot make any."""
        return f"obj_{obj_id:06d}-{source.digest(obj_id)}"

    def find(self, name: str, part: int | None = None) -> Templates | None:
        """Templates of an object, or of a part of it; None if there are none that can be used."""
        path = self.path(name, part)
        if not path.exists():
            return None
        try:
            return read_templates(path)
        except FormatError as error:  # after an update that is as it should be
            level = logging.INFO if isinstance(error, OtherVersionError) else logging.WARNING
            log.log(level, "%s; they are learned anew", error)
            return None

    def put(self, templates: Templates, name: str, part: int | None = None) -> None:
        """Keep templates; other processes never see half a file. Raises InputError if the disk is full, for example."""
        content = io.BytesIO()
        np.savez(content, version=version(), **vars(templates))
        try:
            write_atomically(self.path(name, part), content.getvalue())
        except InputError as error:
            text = f"{error} with --cache, or free space; what was learned before is kept"
            raise InputError(text) from error

    def drop_parts(self, name: str) -> None:
        """Remove the parts of an object that is kept as a whole."""
        for path in self.folder.glob(f".{name}.part*.npz"):
            path.unlink(missing_ok=True)

    def path(self, name: str, part: int | None = None) -> Path:
        """File of an object, or of a part of it."""
        return self.folder / (f"{name}.npz" if part is None else f".{name}.part{part}.npz")


def read_templates(path: Path) -> Templates:
    """Read templates. Raises OtherVersionError, and FormatError if the file is damaged."""
    try:
        with np.load(path, allow_pickle=False) as content:
            made_by = str(content["version"])
            values = {} if made_by != version() else {name: content[name] for name in content if name != "version"}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise FormatError(f"{path}: is no readable file of templates") from error
    if made_by != version():
        raise OtherVersionError(f"{path}: has templates that another version of this program made")
    scalars = {name: value.item() for name, value in values.items() if value.ndim == 0}
    try:
        return Templates(**{**values, **scalars})
    except TypeError as error:
        raise FormatError(f"{path}: lacks some of what templates hold") from error
