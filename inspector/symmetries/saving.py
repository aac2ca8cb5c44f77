"""Saving what was decided about symmetries to the `models_info.json` of a set of models."""

from collections.abc import Sequence
from contextlib import suppress
from typing import Any

from inspector.symmetries.verdicts import Reviewed
from pipeline.bop.json_files import read_bytes
from pipeline.bop.models_info.model_set import ModelFile, ModelSet
from pipeline.bop.models_info.writing import Written, model_entry, write_symmetries
from pipeline.exceptions import InputError


class InfoFile:
    """The `models_info.json` of a set of models while it is under review."""

    def __init__(self, models: ModelSet) -> None:
        """Read it. Raises FormatError if it is damaged."""
        self._models = models
        self._infos = models.infos()
        self._last_written: bytes | None = None

    def entry(self, file: ModelFile) -> dict[str, Any]:
        """What it says of a model; empty where it says nothing."""
        return {} if file.obj_id is None else self._infos.get(file.obj_id, {})

    @property
    def exists(self) -> bool:
        """Whether there is one on the disk."""
        return self._models.info_path is not None and self._models.info_path.is_file()

    def write(self, objects: Sequence[Reviewed]) -> Written:
        """Write the sets of those objects that are unsaved, and make the file with all objects if there is none.

        A copy is kept of what others wrote, not of every save of one's own. Raises InputError if it cannot be written.
        """
        path = self._models.info_path
        if path is None:
            raise InputError(f"{self._models.path}: is not named obj_ID.ply; rename it, or use --json FILE")
        groups = {one.file.obj_id: one.group for one in objects if one.unsaved and one.file.obj_id is not None}
        before = read_bytes(path) if path.is_file() else None
        named = [one for one in objects if before is None or one.file.obj_id in groups]
        written = write_symmetries(path, groups, self._facts(named), backup=before != self._last_written)
        self._last_written = read_bytes(path)
        return written

    def _facts(self, objects: Sequence[Reviewed]) -> dict[int, dict[str, float]]:
        """Sizes of models, of those that can be read."""
        facts = {}
        for one in objects:
            if one.file.obj_id is not None:
                with suppress(InputError):
                    facts[one.file.obj_id] = model_entry(one.model or self._models.read(one.file))
        return facts


def told(written: Written, count: int, models: ModelSet) -> str:
    """How to tell that `count` objects were saved."""
    kept = f"; before: {written.backup.name}" if written.backup is not None else ""
    return f"saved {count} object{'' if count == 1 else 's'} to {written.path.name}{kept}{overruled(models)}"


def overruled(models: ModelSet) -> str:
    """A warning where what is written has no effect on evaluation; else nothing."""
    first = models.overruled_by
    return "" if first is None else f"; but evaluation reads {first.parent.name}/{first.name}"
