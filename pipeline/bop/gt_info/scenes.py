"""The scenes of a dataset whose ground-truth information is to be made, and the files that this gives."""

import hashlib
import os
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from pipeline.bop import layout
from pipeline.bop.annotations import read_cameras
from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.json_files import read_bytes
from pipeline.exceptions import FormatError, UnknownIdError

SceneKind = Literal["masks", "info", "coco", "coco-modal"]
"""Masks of both sorts; `scene_gt_info.json`; `scene_gt_coco.json`; the same with the boxes of what is visible."""

SCENE_KINDS: tuple[SceneKind, ...] = ("masks", "info", "coco", "coco-modal")
STEMS: Mapping[SceneKind, str] = {
    "info": "scene_gt_info",
    "coco": "scene_gt_coco",
    "coco-modal": "scene_gt_coco_modal",
}
"""JSON files of a scene."""


@dataclass(frozen=True, eq=False)
class ScenePart:
    """One scene as seen by one sensor."""

    root: Path
    split: str
    scene_id: int
    layout: layout.SceneLayout
    instances: Mapping[int, int]
    """Number of annotations by image id, of the annotated images that are on disk, in order."""
    obj_ids: frozenset[int]
    """Objects annotated in these images."""
    without_depth: int
    """How many of these images have no depth."""
    not_on_disk: int
    """How many annotated images have no file."""
    fingerprint: str
    """Changes with the annotations, the cameras and the depth images that there are."""

    @property
    def sensor(self) -> str:
        """Suffix of the sensor, empty in the classic layout."""
        return self.layout.sensor

    def open(self) -> Dataset:
        """The dataset as this sensor sees it."""
        return _open(self.root, self.split, self.layout)

    def json(self, kind: SceneKind) -> Path:
        """JSON file of a kind."""
        return self.layout.json(STEMS[kind])

    def mask_folder(self, visible: bool) -> Path:
        """Folder of full or visible masks, whether it exists or not."""
        return self.layout.json("mask_visib" if visible else "mask").with_suffix("")

    def existing(self, kind: SceneKind) -> list[Path]:
        """Files of a kind that are there and would be written over."""
        if kind != "masks":
            return [self.json(kind)] if self.json(kind).is_file() else []
        wanted = {mask_name(im_id, index) for im_id, count in self.instances.items() for index in range(count)}
        folders = [self.mask_folder(visible) for visible in (False, True)]
        return [folder / name for folder in folders for name in sorted(wanted & _names(folder))]


def mask_name(im_id: int, index: int) -> str:
    """Name of an annotation's mask in either folder."""
    return f"{im_id:06d}_{index:06d}.png"


def find_parts(root: Path, split: str, scenes: Collection[int] = (), sensor: str | None = None) -> Iterator[ScenePart]:
    """All scenes with annotations, or those asked for, by each of their sensors or the one asked for.

    Raises UnknownIdError for a scene that is not there, FormatError for damaged annotations or cameras.
    """
    folders = layout.scene_folders(root / split)
    for scene_id in scenes:
        if scene_id not in folders:
            raise UnknownIdError("scene", scene_id, str(root / split), folders)
    for scene_id in sorted(set(scenes) or folders):
        for name in layout.sensors(folders[scene_id]) or ("",):
            place = layout.SceneLayout(folders[scene_id], name)
            if sensor in (None, name) and place.json("scene_gt").is_file():
                yield _part(root, split, scene_id, place)


def _part(root: Path, split: str, scene_id: int, place: layout.SceneLayout) -> ScenePart:
    dataset = _open(root, split, place)
    truth, cameras = dataset.scene_ground_truth(scene_id), read_cameras(place.json("scene_camera"))
    for problem in (*truth.damage.values(), *cameras.damage.values()):
        raise FormatError(problem)
    on_disk = set(dataset.image_ids(scene_id))
    instances = {im_id: span.stop - span.start for im_id, span in truth.spans.items() if im_id in on_disk}
    for im_id in sorted(instances.keys() - cameras.rows.keys()):
        cameras.row(im_id)  # raises
    depths = layout.numbered_files(place.depth_folder())
    return ScenePart(
        root=root,
        split=split,
        scene_id=scene_id,
        layout=place,
        obj_ids=frozenset(truth.obj_ids[np.isin(truth.im_ids, list(instances))].tolist()),
        instances=instances,
        without_depth=len(instances.keys() - depths.keys()),
        not_on_disk=len(truth.spans.keys() - instances.keys()),
        fingerprint=_fingerprint(place, sorted(instances), sorted(depths)),
    )


def _open(root: Path, split: str, place: layout.SceneLayout) -> Dataset:
    return open_dataset(root, split, place.sensor if place.sensor in layout.sensors(place.folder) else None)


def _fingerprint(place: layout.SceneLayout, *ids: list[int]) -> str:
    content = [read_bytes(place.json(stem)) for stem in ("scene_gt", "scene_camera")]
    return hashlib.blake2b(b"".join([*content, repr(ids).encode()]), digest_size=16).hexdigest()


def _names(folder: Path) -> set[str]:
    return set(os.listdir(folder)) if folder.is_dir() else set()  # noqa: PTH208 - paths of 100,000 files take a second
