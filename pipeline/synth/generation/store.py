"""Where a synthesis keeps its files: those of the dataset, and those by which it continues after an interruption.

An image is finished when its record is there, which is written last; its colours, depth and masks are in the dataset
then. Arrangements are kept too, so that the rest of their images show the same. Both lie in `.synthesis` in the
folder of the split, until the dataset is complete.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import orjson

from pipeline.bop.json_files import read_json, write_atomically
from pipeline.bop.writer import AnnotatedImage, write_image_files
from pipeline.exceptions import FormatError
from pipeline.scene import Image, ImageKey
from pipeline.synth.generation.images import SyntheticImage, SyntheticRecord


class Store:
    """The files of one split; many processes may write images at the same time."""

    def __init__(self, root: Path, split: str, rgb_suffix: str, depth_scale_mm: float) -> None:
        self.root, self.split = root, split
        self._suffix, self._depth_scale = rgb_suffix, depth_scale_mm
        self._counts: dict[str, tuple[int, int]] = {}
        """Of finished images by the folder of their records, each with the time of the folder's last change."""

    @property
    def folder(self) -> Path:
        """Of the split."""
        return self.root / self.split

    @property
    def journal(self) -> Path:
        """Held by the process that makes the split, while it does."""
        return self.root / f".synthesis_{self.split}.journal"

    @property
    def summary(self) -> Path:
        """What a complete split was made with."""
        return self.folder / "synthesis.json"

    def scene_folder(self, scene_id: int) -> Path:
        """Folder of a scene."""
        return self.folder / f"{scene_id:06d}"

    def write(self, key: ImageKey, image: SyntheticImage) -> None:
        """Write all files of an image, its record last. Raises InputError if that fails: the image is not finished then."""
        truths, views = image.annotated()
        masks, visible = [view.mask for view in views], [view.visible_mask for view in views]
        annotated = AnnotatedImage(Image(key, image.camera, image.rgb, image.depth), truths, masks, visible)
        write_image_files(self.scene_folder(key.scene_id), annotated, self._depth_scale, self._suffix)
        name = f"rgb/{key.im_id:06d}{self._suffix}"
        record = SyntheticRecord.of(key.im_id, image, truths, views, name, self._depth_scale)
        write_atomically(self._record(key), orjson.dumps(record))

    def is_finished(self, key: ImageKey) -> bool:
        """Whether an image is there with all its files."""
        return self._record(key).is_file()

    def finished(self) -> int:
        """Number of finished images; only folders that have changed since the last time are looked through."""
        if self._work.is_dir():
            for folder in self._work.iterdir():
                changed = folder.stat().st_mtime_ns
                if self._counts.get(folder.name, (0, 0))[0] != changed:
                    self._counts[folder.name] = changed, sum(1 for _ in folder.glob("image_*.json"))
        return sum(count for _, count in self._counts.values())

    def records(self, scene_id: int) -> Iterator[SyntheticRecord]:
        """Those of the finished images of a scene, by image id. Raises FormatError if one was damaged."""
        for path in sorted((self._work / f"{scene_id:06d}").glob("image_*.json")):
            yield SyntheticRecord.from_json(read_json(path))

    def keep_arrangement(self, scene_id: int, index: int, content: Any) -> None:
        """Keep an arrangement, made of dataclasses, numbers and texts."""
        write_atomically(self._arrangement(scene_id, index), orjson.dumps(content, option=orjson.OPT_SERIALIZE_NUMPY))

    def arrangement(self, scene_id: int, index: int) -> Any:
        """What was kept of an arrangement, None if nothing was."""
        path = self._arrangement(scene_id, index)
        try:
            return read_json(path) if path.is_file() else None
        except FormatError:
            return None  # it is made again, and comes out the same

    def remove_work(self) -> None:
        """Forget what is needed for continuing only."""
        shutil.rmtree(self._work, ignore_errors=True)

    @property
    def _work(self) -> Path:
        return self.folder / ".synthesis"

    def _record(self, key: ImageKey) -> Path:
        return self._work / f"{key.scene_id:06d}" / f"image_{key.im_id:06d}.json"

    def _arrangement(self, scene_id: int, index: int) -> Path:
        return self._work / f"{scene_id:06d}" / f"arrangement_{index:06d}.json"
