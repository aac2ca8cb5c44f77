"""Targets of a dataset split: from the lists that come with BOP datasets, or from the ground truth."""

from collections.abc import Callable, Collection, Mapping
from itertools import repeat
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.bop.annotations import SceneGroundTruth
from pipeline.bop.json_files import read_json
from pipeline.exceptions import FormatError
from pipeline.scene import ImageKey, Target

MIN_VISIBLE_FRACTION = 0.1
"""Visible share from which an annotated instance is a target (thesis sec. bop_6d_object_localization)."""


def read_targets(
    path: Path,
    images: Mapping[int, Collection[int]],
    targets_of_image: Callable[[ImageKey], tuple[Target, ...]],
) -> tuple[Target, ...]:
    """Targets of a list such as `test_targets_bop19.json` whose images (ids by scene id) are on disk, in its order.

    Lists for detection (BOP 2024) name images only; their targets are those that `targets_of_image` gives.
    Raises FormatError that names the entry if one is damaged.
    """
    content = read_json(path)
    if not isinstance(content, list):
        raise FormatError(f"{path}: holds a {type(content).__name__}; expected a list of targets")
    found: list[Target] = []
    for index, entry in enumerate(content):
        key = ImageKey(_whole(path, index, entry, "scene_id"), _whole(path, index, entry, "im_id"))
        if key.im_id not in images.get(key.scene_id, ()):
            continue
        if "obj_id" in entry:
            count = _whole(path, index, entry, "inst_count") if "inst_count" in entry else 1
            found.append(Target(*key, _whole(path, index, entry, "obj_id"), count))
        else:
            found += targets_of_image(key)
    return tuple(found)


def targets_from_ground_truth(scene_id: int, truth: SceneGroundTruth, image_ids: Collection[int]) -> tuple[Target, ...]:
    """Objects of a scene with the number of their instances that are visible enough or of unknown visibility."""
    counted = ~(truth.visible_fraction < MIN_VISIBLE_FRACTION) & np.isin(truth.im_ids, np.fromiter(image_ids, np.int64))
    pairs = np.stack([truth.im_ids[counted], truth.obj_ids[counted]], axis=1)
    unique, counts = np.unique(pairs, axis=0, return_counts=True)
    return tuple(map(Target, repeat(scene_id), unique[:, 0].tolist(), unique[:, 1].tolist(), counts.tolist()))


def _whole(path: Path, index: int, entry: Any, name: str) -> int:
    value = entry.get(name) if isinstance(entry, dict) else None
    if type(value) is not int:
        raise FormatError(f"{path}: target {index}: {name} is {value!r}; expected a whole number")
    return value
