"""The folders of object models in a dataset: which file of an object to take, and what `models_info.json` says of it."""

import logging
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

from pipeline.bop import layout
from pipeline.bop.facts import DatasetFacts
from pipeline.bop.memo import Memo
from pipeline.bop.models import read_model, read_models_info
from pipeline.exceptions import FormatError, InputError, UnknownIdError
from pipeline.scene import Model

log = logging.getLogger(__name__)

ModelKind = Literal["eval", "display"]
"""Models for evaluation (resampled, without colour) or for display (with colour, where there is one)."""


class ModelFolders:
    """The models of a dataset, from `models[_cad|_reconst|_eval|_fine]`; read when asked for and kept."""

    def __init__(self, root: Path, facts: DatasetFacts) -> None:
        self._root, self._facts, self._memo = root, facts, Memo()

    @property
    def problems(self) -> tuple[InputError, ...]:
        """What is wrong with the `models_info.json` files; diameters are computed then, and symmetries unknown."""
        folders = self._folders("eval")
        return tuple(error for folder in folders if (error := self._infos(folder)[1]) is not None)

    @property
    def obj_ids(self) -> tuple[int, ...]:
        """Ids of all objects that have a model in any folder."""
        return tuple(sorted({obj_id for files in self._files.values() for obj_id in files}))

    def model(self, obj_id: int, kind: ModelKind = "eval") -> Model:
        """Model of an object, the same one each time; symmetries and diameter are those for evaluation.

        Raises UnknownIdError if the object has no model, FormatError or MissingFileError if its file is damaged.
        """
        return self._memo.get(("model", obj_id, kind), lambda: self._read(obj_id, kind))

    def path(self, obj_id: int, kind: ModelKind = "eval") -> Path:
        """File of an object's model in the most suitable folder that has one. Raises UnknownIdError if none has."""
        for folder in self._folders(kind):
            if obj_id in self._files[folder]:
                return self._files[folder][obj_id]
        names = ", ".join(f"{self._root.name}/{folder.name}" for folder in self._files)
        raise UnknownIdError("object", obj_id, names or f"{self._root}, which has no models folder", self.obj_ids)

    def info(self, obj_id: int) -> dict[str, Any]:
        """Entry of an object in the first `models_info.json` that has it, millimetres; empty if none has."""
        for folder in self._folders("eval"):
            entries, _ = self._infos(folder)
            if obj_id in entries:
                return entries[obj_id]
        return {}

    def _read(self, obj_id: int, kind: ModelKind) -> Model:
        return read_model(self.path(obj_id, kind), obj_id, self.info(obj_id), appearance=kind == "display")

    def _infos(self, folder: Path) -> tuple[dict[int, dict[str, Any]], InputError | None]:
        return self._memo.get(("info", folder), lambda: _read_infos(folder / "models_info.json"))

    @cached_property
    def _files(self) -> dict[Path, dict[int, Path]]:
        return {folder: layout.model_files(folder) for folder in self._folders("eval")}

    def _folders(self, kind: ModelKind) -> tuple[Path, ...]:
        """All folders of models, the most suitable first."""
        wanted = {
            "eval": (self._facts.eval_models, "models_eval", "object_models_eval", "models", "models_cad"),
            "display": (self._facts.display_models, "models", "models_reconst", "models_fine", "object_models"),
        }
        return layout.model_folders(self._root, wanted[kind])


def _read_infos(path: Path) -> tuple[dict[int, dict[str, Any]], InputError | None]:
    """Entries of a `models_info.json`, none if it is absent or damaged, and what is wrong with it."""
    try:
        return (read_models_info(path) if path.is_file() else {}), None
    except InputError as error:
        told = FormatError(f"{error}; until then objects count as without symmetries, and diameters are computed")
        log.warning("%s", told)
        return {}, told
