"""A folder of object models, or a single mesh, as the search of symmetries takes them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.bop import layout
from pipeline.bop.models import diameter_of, read_model, read_models_info
from pipeline.exceptions import FormatError, InputError, MissingFileError, UnknownIdError
from pipeline.scene import Model

FOREIGN = (".stl", ".obj", ".off")
"""Meshes of other formats, taken for millimetres; only alone, for they have no place in a BOP folder."""
DISPLAY_FOLDERS = ("models", "models_fine", "models_reconst", "models_cad")
"""Beside a folder of models without colours, where the same models may have them."""


@dataclass(frozen=True)
class ModelFile:
    """One mesh."""

    obj_id: int | None
    """None for a mesh whose name is not obj_ID: nothing can be written for it."""
    path: Path

    @property
    def name(self) -> str:
        """How to speak of it."""
        return self.path.stem if self.obj_id is None else f"object {self.obj_id}"


@dataclass(frozen=True)
class ModelSet:
    """Meshes and the `models_info.json` beside them; `open_models` makes it."""

    path: Path
    """As asked for."""
    files: tuple[ModelFile, ...]
    info_path: Path | None
    """Where symmetries are written, whether it exists or not; None where they cannot be."""

    @property
    def overruled_by(self) -> Path | None:
        """The file of the same dataset that evaluation reads first, where it is another than `info_path`."""
        if self.info_path is None or not self.info_path.parent.name.startswith("models"):
            return None
        first = self.info_path.parent.with_name("models_eval") / self.info_path.name
        return first if first != self.info_path and first.is_file() else None

    def infos(self) -> dict[int, dict[str, Any]]:
        """Entries of `models_info.json` by object id, empty if there is none. Raises FormatError if it is damaged."""
        return read_models_info(self.info_path) if self.info_path is not None and self.info_path.is_file() else {}

    def read(self, file: ModelFile, info: dict[str, Any] | None = None) -> Model:
        """The mesh in metres, with its diameter as computed or as listed. Raises FormatError, MissingFileError."""
        listed = {"diameter": info["diameter"]} if info and "diameter" in info else {}
        if file.path.suffix.lower() in FOREIGN:
            return _read_foreign(file.path)
        return read_model(file.path, file.obj_id or 0, listed, appearance=False)

    def read_for_display(self, file: ModelFile) -> Model:
        """The mesh with colours or texture, from a folder of models beside it where its own has none."""
        if file.path.suffix.lower() in FOREIGN:
            return _read_foreign(file.path)
        folders = [file.path.parent, *(file.path.parent.parent / name for name in DISPLAY_FOLDERS)]
        shown: Model | None = None
        for folder in folders if file.obj_id is not None else folders[:1]:
            path = folder / file.path.name
            if path.is_file():
                try:
                    model = read_model(path, file.obj_id or 0, {"diameter": 1.0})
                except InputError:
                    continue
                shown = shown or model
                if model.colors is not None or (model.texture is not None and model.texture_uv is not None):
                    return model
        return shown or self.read(file)


def open_models(path: Path, obj_ids: Sequence[int] = ()) -> ModelSet:
    """List the models of a folder (obj_ID.ply or .glb), or take a single mesh; nothing large is read yet.

    Raises MissingFileError if there is none, UnknownIdError if one of `obj_ids` is not among them.
    """
    if path.is_file():
        return _single(path, obj_ids)
    if not path.is_dir():
        raise MissingFileError(f"{path}: no such file or folder; name a folder of models or a mesh")
    files = layout.model_files(path)
    if not files:
        raise MissingFileError(f"{path}: has no model (obj_000001.ply); {_where(path)}")
    for obj_id in obj_ids:
        if obj_id not in files:
            raise UnknownIdError("object", obj_id, str(path), files)
    chosen = {obj_id: files[obj_id] for obj_id in sorted(files) if not obj_ids or obj_id in obj_ids}
    return ModelSet(path, tuple(ModelFile(i, p) for i, p in chosen.items()), path / "models_info.json")


def _single(path: Path, obj_ids: Sequence[int]) -> ModelSet:
    if path.suffix.lower() not in (*layout.MODEL_SUFFIXES, *FOREIGN):
        known = ", ".join((*layout.MODEL_SUFFIXES, *FOREIGN))
        raise FormatError(f"{path}: is no mesh; name a folder of models, or a mesh of one of these kinds: {known}")
    number = path.stem.removeprefix("obj_")
    own = path.suffix.lower() in layout.MODEL_SUFFIXES and number != path.stem and number.isdecimal()
    file = ModelFile(int(number) if own else None, path)
    for obj_id in obj_ids:
        if obj_id != file.obj_id:
            raise UnknownIdError("object", obj_id, str(path), () if file.obj_id is None else (file.obj_id,))
    return ModelSet(path, (file,), path.with_name("models_info.json") if own else None)


def _where(path: Path) -> str:
    folders = [folder.name for folder in layout.model_folders(path, ()) if layout.model_files(folder)]
    if folders:
        return f"name the folder of models itself: {', '.join(str(path / name) for name in folders)}"
    return "name a folder that holds obj_000001.ply and so on, or a single mesh"


def _read_foreign(path: Path) -> Model:
    """A mesh of another format, its parts as one, in millimetres."""
    import trimesh

    try:
        mesh = trimesh.load_mesh(path, process=False)
        vertices, faces = np.asarray(mesh.vertices, float) / 1000.0, np.asarray(mesh.faces, np.int32)
    except Exception as error:  # the loader raises all kinds of errors on damaged files
        raise FormatError(f"{path}: is no readable mesh ({type(error).__name__}); export it again") from error
    if not len(faces) or not np.isfinite(vertices).all():
        raise FormatError(f"{path}: has no faces, or a vertex that is no number; export a triangle mesh")
    vertices, joined = np.unique(vertices, axis=0, return_inverse=True)  # STL repeats a vertex for each face
    model = Model(0, vertices, joined.ravel()[faces].astype(np.int32), 1.0)
    return replace(model, diameter=diameter_of(vertices))
