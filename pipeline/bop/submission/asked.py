"""What a dataset asks a method for, as sorted arrays of keys that many rows can be compared with at once."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Int

from pipeline.bop import layout
from pipeline.bop.dataset import Dataset
from pipeline.bop.json_files import read_json
from pipeline.bop.submission.findings import Task
from pipeline.bop.target_lists import target_list
from pipeline.exceptions import FormatError
from pipeline.scene import ImageKey, Target

_SHIFT = 31
"""Ids are below 2**31, so two of them fit in an int64."""

_NONE = np.empty(0, np.int64)

_LISTS = {"siso": ("bop18", "bop19"), "detection": ("bop24", "bop19")}
"""Years of the lists of targets that count, as in the evaluation."""


@dataclass(frozen=True, eq=False)
class Asked:
    """The images, objects and targets of a split."""

    where: str
    """Dataset and split, for people."""
    scenes: Int[np.ndarray, " s"]
    images: Int[np.ndarray, " i"]
    """Keys of all images on disk."""
    objects: Int[np.ndarray, " o"]
    """Empty where unknown."""
    listed: Int[np.ndarray, " l"]
    """Keys of the images in the list of targets, on disk or not; empty where there is no list."""
    target_images: Int[np.ndarray, " k"]
    """Keys of the images on disk that estimates are asked for; empty where it is unknown."""
    targets: Int[np.ndarray, " t"] = field(default_factory=lambda: _NONE)
    """By `target_keys`; empty in 6D detection, where objects are not told."""
    instances: Int[np.ndarray, " t"] = field(default_factory=lambda: _NONE)
    """How many instances of each target are asked for."""

    def target_keys(self, images: Int[np.ndarray, " n"], obj_ids: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Keys of an object in an image; -1 where the image has no target."""
        places = np.minimum(np.searchsorted(self.target_images, images), len(self.target_images) - 1)
        return np.where(self.target_images[places] == images, places << _SHIFT | obj_ids, -1)

    def target_name(self, key: int) -> str:
        """Name a target for people."""
        return f"object {key & (1 << _SHIFT) - 1} of {image_name(int(self.target_images[key >> _SHIFT]))}"


def image_keys(scene_ids: Int[np.ndarray, " n"], im_ids: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
    """One number for scene and image."""
    return scene_ids << _SHIFT | im_ids


def image_name(key: int) -> str:
    """Name an image for people."""
    return f"scene {key >> _SHIFT}, image {key & (1 << _SHIFT) - 1}"


def asked_of(dataset: Dataset, task: Task) -> Asked:
    """What a method is asked for on a split. Raises FormatError if the list of targets is damaged."""
    targets, asked_images, lists = _wanted(dataset, task)
    images = _keys(dataset.images())
    asked = Asked(
        where=f"{dataset.name}/{dataset.split}",
        scenes=np.array(dataset.scene_ids, np.int64),
        images=images,
        objects=np.array(sorted({*dataset.obj_ids, *dataset.facts.obj_ids}), np.int64),
        listed=_listed_images(lists, images),
        target_images=_keys(asked_images),
    )
    found = [target for target in targets if target.inst_count > 0]
    return _with_targets(asked, np.array(found, np.int64), task) if found else asked


def _wanted(dataset: Dataset, task: Task) -> tuple[Sequence[Target], Sequence[ImageKey], Sequence[Path]]:
    """Targets, images, and the lists that they may stand in."""
    if task == "localization":
        targets = dataset.targets()
        return targets, [target.image for target in targets], layout.target_files(dataset.root, dataset.split)
    found = target_list(dataset, _LISTS[task])
    return found.targets if task == "siso" else (), found.images, [found.path] if found.path else []


def _keys(images: Iterable[ImageKey]) -> Int[np.ndarray, " k"]:
    """Keys of images, sorted, each once; ids that no results file can have are left out."""
    ids = np.array([tuple(key) for key in images if max(key) < 1 << _SHIFT], np.int64).reshape(-1, 2)
    return np.unique(image_keys(ids[:, 0], ids[:, 1]))


def _with_targets(asked: Asked, targets: Int[np.ndarray, "n 4"], task: Task) -> Asked:
    keys = asked.target_keys(image_keys(targets[:, 0], targets[:, 1]), targets[:, 2])
    unique, rows = np.unique(keys, return_index=True)
    return replace(asked, targets=unique, instances=np.ones_like(rows) if task == "siso" else targets[rows, 3])


def _listed_images(lists: Sequence[Path], on_disk: Int[np.ndarray, " i"]) -> Int[np.ndarray, " l"]:
    """Images in the first list of which some is on disk."""
    for path in lists:
        content = read_json(path)
        listed = _keys([_image_of(path, i, e) for i, e in enumerate(content if isinstance(content, list) else [])])
        if np.isin(listed, on_disk).any():
            return listed
    return _NONE


def _image_of(path: Path, index: int, entry: Any) -> ImageKey:
    scene_id, im_id = (entry.get(name) if isinstance(entry, dict) else None for name in ("scene_id", "im_id"))
    if type(scene_id) is not int or type(im_id) is not int:
        found = f"scene_id is {scene_id!r} and im_id {im_id!r}"
        raise FormatError(f"{path}: target {index}: {found}; expected whole numbers")
    return ImageKey(scene_id, im_id)
