"""The files of a dataset beside its images: what each scene's JSON files say, lists of targets, camera, origin."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import orjson

from pipeline.bop.coco.annotations import CocoImage, coco_document
from pipeline.bop.dataset import open_dataset
from pipeline.bop.gt_info.files import write_parts
from pipeline.bop.gt_info.targets import detection_images, list_path, localization_targets, write_detection_images
from pipeline.bop.json_files import write_atomically, write_json_by_id
from pipeline.bop.writer import write_targets
from pipeline.scene import Camera
from pipeline.synth.generation.images import SyntheticRecord
from pipeline.synth.generation.store import Store

PACKAGES = ("mitsuba", "mitsuba-oidn", "mujoco", "open3d", "pyrender", "numpy")
TESTED_SPLITS = ("test", "val")
"""What splits begin with whose targets are listed."""


def write_scene_files(store: Store, scene_id: int, obj_ids: Iterable[int], name: str) -> None:
    """Write the JSON files of a scene from the records of its finished images; nothing where there are none.

    Raises InputError if they cannot be written.
    """
    folder = store.scene_folder(scene_id)
    records = list(store.records(scene_id))
    if not records:
        return
    write_json_by_id(folder / "scene_camera.json", {record.im_id: record.camera for record in records})
    write_json_by_id(folder / "scene_gt_info.json", {record.im_id: record.information.infos for record in records})  # type: ignore[arg-type]
    write_parts(folder / "scene_gt_coco.json", coco_document(name, "synthetic images", obj_ids, lambda: _coco(records)))
    write_json_by_id(folder / "scene_gt.json", {record.im_id: record.ground_truth for record in records})


def _coco(records: Iterable[SyntheticRecord]) -> Iterable[CocoImage]:
    return (record.information.coco for record in records if record.information.coco is not None)


def write_target_lists(store: Store) -> None:
    """Write the lists of targets of a split to be tested on, as `inspector gt-info` does."""
    if not store.split.startswith(TESTED_SPLITS):
        return
    dataset = open_dataset(store.root, store.split)
    write_targets(list_path(store.root, store.split, "bop19"), localization_targets(dataset))
    write_detection_images(list_path(store.root, store.split, "bop24"), detection_images(dataset))


def write_camera(path: Path, camera: Camera, depth_scale_mm: float) -> None:
    """Write `camera.json`, unless there is one."""
    if not path.is_file():
        K = camera.K
        values = {"cx": K[0, 2], "cy": K[1, 2], "depth_scale": depth_scale_mm, "fx": K[0, 0], "fy": K[1, 1]}
        sizes = {"height": camera.height, "width": camera.width}
        data = orjson.dumps(values | sizes, option=orjson.OPT_INDENT_2 | orjson.OPT_SERIALIZE_NUMPY)
        write_atomically(path, data + b"\n")


def write_summary(store: Store, config: Any, scene_ids: Iterable[int]) -> None:
    """Write what the split was made with: configuration, versions, and seconds of each stage over all images."""
    seconds: Counter[str] = Counter()
    images = 0
    for scene_id in scene_ids:
        for record in store.records(scene_id):
            seconds.update(record.seconds)
            images += 1
    content = {
        "config": config,
        "versions": _versions(),
        "images": images,
        "seconds": {name: round(value, 1) for name, value in seconds.items()},
    }
    write_atomically(store.summary, orjson.dumps(content, option=orjson.OPT_INDENT_2) + b"\n")


def _versions() -> Mapping[str, str]:
    found = {}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
