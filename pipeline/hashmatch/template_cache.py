"""Templates on disk, found again by what they were made from.

One file per object, and while it is learned one file per part of its views: learning that was cancelled goes on where it
stopped, and a new object leaves the others as they are. Names hold a digest of model, config and version.
"""

import hashlib
import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np

from pipeline.bop.json_files import write_atomically
from pipeline.exceptions import FormatError, InputError
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.templates import Templates, check_model, joined, learn_views, view_chunks
from pipeline.scene import Model

VERSION = 1
"""Of what the files hold and how it is computed; a change makes all templates anew."""

_OF_TEMPLATES = (
    "views", "in_plane", "angle_step_deg", "in_plane_limit_deg", "skip_symmetric_views", "edgel_threshold", "grid",
    "points", "orientation_margin_deg", "template_gradient_threshold",
)  # fmt: skip
"""Settings on which templates depend."""


def cached_templates(
    model: Model,
    config: HashMatchConfig,
    focal_px: float,
    folder: Path | None = None,
    progress: Callable[[float], None] = lambda _: None,
) -> Templates:
    """Templates of an object, from the cache or learned and put there.

    Args:
        model: With colour, if there is one.
        config: What the templates depend on.
        focal_px: Focal length; rounded to pixels, so that cameras of one kind share templates.
        folder: Of the cache, made if absent; by default in the user's cache.
        progress: Called with the share done, 0..1; what it raises ends learning, to be gone on with.

    Raises:
        InputError: the model cannot be rendered, the cache is of another version or damaged, or cannot be written.

    """
    check_model(model)
    folder = folder or default_folder()
    focal_px = float(round(focal_px))
    name = f"obj_{model.obj_id:06d}-{_digest(model, config, focal_px)}"
    path = folder / f"{name}.npz"
    if path.exists():
        progress(1.0)
        return read_templates(path)
    chunks, parts = [], view_chunks(model, config)
    for i, rotations in enumerate(parts):
        progress(i / len(parts))
        part = folder / f".{name}.part{i}.npz"
        if part.exists():
            chunks.append(read_templates(part))
        else:
            chunks.append(learn_views(model, rotations, config, focal_px))
            write_templates(part, chunks[-1])
    found = joined(chunks)
    write_templates(path, found)
    for part in folder.glob(f".{name}.part*.npz"):
        part.unlink(missing_ok=True)
    progress(1.0)
    return found


def default_folder() -> Path:
    """Folder of the templates in the user's cache."""
    from platformdirs import user_cache_path

    return user_cache_path("inspector") / "templates"


def write_templates(path: Path, templates: Templates) -> None:
    """Write templates; other processes never see half a file. Raises InputError if the disk is full, for example."""
    content = io.BytesIO()
    np.savez(content, version=VERSION, **vars(templates))
    try:
        write_atomically(path, content.getvalue())
    except InputError as error:
        text = f"{error}; or free space: learned parts are kept, learning goes on where it stopped"
        raise InputError(text) from error


def read_templates(path: Path) -> Templates:
    """Read templates. Raises FormatError if the file is damaged or of another version of this program."""
    try:
        with np.load(path, allow_pickle=False) as content:
            version = int(content["version"]) if "version" in content else 0
            values = {} if version != VERSION else {name: content[name] for name in content if name != "version"}
    except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise FormatError(f"{path}: is no readable file of templates; delete it, they are learned anew") from error
    if version != VERSION:
        raise FormatError(f"{path}: has templates of version {version}, this program uses {VERSION}; delete the file")
    scalars = {name: value.item() for name, value in values.items() if value.ndim == 0}
    try:
        return Templates(**{**values, **scalars})
    except TypeError as error:
        raise FormatError(f"{path}: lacks a part of the templates; delete it, they are learned anew") from error


def _digest(model: Model, config: HashMatchConfig, focal_px: float) -> str:
    digest = hashlib.sha256()
    arrays = (model.vertices, model.faces, model.normals, model.colors, model.texture, model.texture_uv)
    for array in (*arrays, model.symmetries if config.skip_symmetric_views else None):
        digest.update(b"-" if array is None else np.ascontiguousarray(array).tobytes())
    settings = [getattr(config, name) for name in _OF_TEMPLATES]
    digest.update(repr((VERSION, model.obj_id, model.diameter, focal_px, settings)).encode())
    return digest.hexdigest()[:16]
