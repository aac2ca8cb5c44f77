"""The object models that images are made of."""

from __future__ import annotations

import shutil
from functools import cached_property
from pathlib import Path

from pipeline.bop import layout
from pipeline.bop.facts import dataset_facts
from pipeline.bop.model_folders import ModelFolders
from pipeline.exceptions import InputError, MissingFileError, UnknownIdError
from pipeline.scene import Model

SMALLEST, LARGEST = 0.005, 3.0
"""Metres: diameters of rigid objects that people handle. What is outside has the wrong unit."""


class ModelLibrary:
    """Models with their appearance, by object id; read when asked for and kept."""

    def __init__(self, root: Path | None) -> None:
        """Take those of a BOP dataset (its folder, or that of the models themselves); None for our own parts.

        Raises MissingFileError if there are no models.
        """
        self.root = root
        if root is not None and not root.is_dir():
            raise MissingFileError(f"models = {root}: no such folder; give that of a BOP dataset")
        if root is not None and not self._folders:
            raise MissingFileError(f"models = {root}: has no folder models with obj_000001.ply and so on")

    def __reduce__(self) -> tuple[type, tuple[Path | None]]:
        """Other processes read the models themselves."""
        return ModelLibrary, (self.root,)

    @property
    def name(self) -> str:
        """Of the dataset that the models come from."""
        return "parts" if self.root is None else self._dataset_root.name

    @cached_property
    def obj_ids(self) -> tuple[int, ...]:
        """All there are."""
        if self.root is None:
            from pipeline.synth.demo.parts import PARTS

            return tuple(part.obj_id for part in PARTS)
        return self._models.obj_ids

    def chosen(self, *choices: tuple[int, ...]) -> tuple[int, ...]:
        """The first choice that is one, else all. Raises UnknownIdError, which lists the ids."""
        wanted = next((choice for choice in choices if choice), self.obj_ids)
        for obj_id in wanted:
            if obj_id not in self.obj_ids:
                raise UnknownIdError("object", obj_id, f"the models of {self.name}", self.obj_ids)
        return tuple(wanted)

    def model(self, obj_id: int) -> Model:
        """A model, the same one each time. Raises InputError if it is damaged, or its unit is not the millimetre."""
        if self.root is None:
            from pipeline.synth.demo.part_files import part_display_model

            return part_display_model(obj_id)
        model = self._models.model(obj_id, "display")
        if not SMALLEST <= (size := _size(model)) <= LARGEST:
            hint = "metres: multiply its vertices by 1000" if size < SMALLEST else "a smaller unit: scale its vertices"
            raise InputError(
                f"{self._models.path(obj_id, 'display')}: the object is {1000 * size:.3g} mm large, but BOP models are in "
                f"millimetres; it looks like {hint}"
            )
        return model

    def copy_to(self, root: Path) -> None:
        """Put the models into a dataset, unless it is the one that they come from, or has models already."""
        if self.root is None:
            from pipeline.synth.demo import part_files

            if not (root / "models").is_dir():
                part_files.write_part_models(root / "models")
                part_files.write_eval_models(root / "models_eval")
            return
        for folder in self._folders:
            if not (root / folder.name).exists():
                _copy_folder(folder, root / folder.name)

    @cached_property
    def _models(self) -> ModelFolders:
        return ModelFolders(self._dataset_root, dataset_facts(self._dataset_root.name))

    @property
    def _folders(self) -> tuple[Path, ...]:
        return tuple(path for path in layout.model_folders(self._dataset_root, ()) if layout.model_files(path))

    @property
    def _dataset_root(self) -> Path:
        assert self.root is not None
        return self.root.parent if layout.model_files(self.root) else self.root


def _size(model: Model) -> float:
    """Length of the bounding box's diagonal, metres; `models_info.json` may be right where the mesh is not."""
    extent = model.vertices.max(axis=0) - model.vertices.min(axis=0)
    return float((extent**2).sum() ** 0.5)


def _copy_folder(source: Path, target: Path) -> None:
    """Copy all files; the folder appears in whole or not at all."""
    temporary = target.with_name(f".{target.name}.partial")
    try:
        shutil.rmtree(temporary, ignore_errors=True)
        shutil.copytree(source, temporary)
        temporary.rename(target)
    except OSError as error:
        shutil.rmtree(temporary, ignore_errors=True)
        raise InputError(f"{target}: models cannot be copied there ({error}); make room, and run again") from error
