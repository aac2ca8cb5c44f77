"""Making and writing the ground-truth information of one scene; what an interrupted run had finished stays.

An image is finished when its masks are written and the scene's journal has a line about it; from these lines the JSON
files are put together in the end. Every file appears in whole or not at all.
"""

import contextlib
import os
import re
import threading
from collections.abc import Iterable, Iterator
from pathlib import Path

import orjson

from pipeline.bop.coco.annotations import CocoImage, coco_document
from pipeline.bop.gt_info.image import ImageRecord, ImageTask, MadeImage, image_task
from pipeline.bop.gt_info.plan import Plan
from pipeline.bop.gt_info.scenes import ScenePart, mask_name
from pipeline.bop.journal import Journal, Line, cannot_write
from pipeline.scene import ImageKey

_LEFTOVER = re.compile(r"\.(\d+_\d+\.png|scene_gt_.+\.json|\w+_targets_\w+\.json)\.\d+\.\d+")
"""Temporary names, of `write_parts` and `write_atomically`."""


class SceneMaker:
    """One scene at work, its journal held open."""

    def __init__(self, plan: Plan, number: int, replacing: bool) -> None:
        """`number` is the scene's in the plan; `replacing`: masks of annotations that are no more may lie about.

        Raises InputError if the journal cannot be opened.
        """
        self._plan, self._number, self._part = plan, number, plan.parts[number]
        self._replacing = replacing
        self._journal = Journal(journal_path(self._part))
        try:
            self._lines = self._finished_images()
        except BaseException:
            self._journal.close()
            raise

    @property
    def finished(self) -> int:
        """Number of finished images."""
        return len(self._lines)

    @property
    def is_complete(self) -> bool:
        """Whether all images are finished."""
        return self._lines.keys() >= self._part.instances.keys()

    def tasks(self) -> Iterator[ImageTask]:
        """The images that are not finished."""
        dataset, part = self._part.open(), self._part
        for im_id in sorted(part.instances.keys() - self._lines.keys()):
            key = ImageKey(part.scene_id, im_id)
            yield image_task(dataset, key, part.layout.folder, self._number, self._lasting_masks(im_id))

    def take(self, made: MadeImage) -> None:
        """Write the masks of an image and the line that says that it is finished. Raises InputError."""
        if "masks" in self._plan.kinds:
            self._write_masks(made)
        self._lines[made.record.im_id] = self._journal.append(made.record)

    def write_json(self) -> None:
        """Write the JSON files; no more than one image's record at a time is in memory. Raises InputError."""
        plan, part = self._plan, self._part
        if "info" in plan.kinds:
            write_parts(part.json("info"), _info_document(self._records()))
        for kind in ("coco", "coco-modal"):
            if kind in plan.kinds:
                title, modal = f"{plan.name}_{plan.split}", kind == "coco-modal"
                write_parts(
                    part.json(kind),
                    coco_document(plan.name, title, plan.obj_ids, lambda: _coco(self._records()), modal),
                )

    def close(self) -> None:
        """Let go of the journal, which stays."""
        self._journal.close()

    def _records(self) -> Iterator[ImageRecord]:
        return (ImageRecord.from_json(self._journal.read(self._lines[im_id])) for im_id in sorted(self._lines))

    def _finished_images(self) -> dict[int, Line]:
        """Where the journal tells of the images that were finished before; nowhere if it is about other annotations."""
        part, journal = self._part, self._journal
        remove_leftovers(part.layout.folder, part.mask_folder(visible=False), part.mask_folder(visible=True))
        head = {"fingerprint": part.fingerprint, **self._plan.settings}
        if journal.head == head:
            return {journal.read(line)["im_id"]: line for line in journal.entries}
        self._replacing |= journal.head is not None
        journal.start(head)
        return {}

    def _lasting_masks(self, im_id: int) -> tuple[tuple[Path, Path] | None, ...]:
        """Full and visible mask of each annotation where they exist and are not made anew."""
        count, place = self._part.instances[im_id], self._part.layout
        if "masks" in self._plan.kinds:
            return (None,) * count
        pairs = [(place.mask(im_id, i, visible=False), place.mask(im_id, i, visible=True)) for i in range(count)]
        return tuple((full, visible) if full and visible else None for full, visible in pairs)

    def _write_masks(self, made: MadeImage) -> None:
        im_id = made.record.im_id
        for visible, masks in ((False, made.masks), (True, made.visible_masks)):
            folder = self._part.mask_folder(visible)
            for index, data in enumerate(masks):
                write_parts(folder / mask_name(im_id, index), [data])
            if self._replacing:
                _remove_from(folder, im_id, len(masks))


def journal_path(part: ScenePart) -> Path:
    """Journal of a scene at work."""
    return part.layout.json(".gt_info").with_suffix(".journal")


def write_parts(path: Path, parts: Iterable[bytes]) -> None:
    """Write a file part by part under a temporary name and rename it. Raises InputError if it cannot be written."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.{threading.get_ident()}")
    try:
        path.parent.mkdir(exist_ok=True)
        with temporary.open("wb") as file:
            file.writelines(parts)
        temporary.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise cannot_write(path, error) from error


def remove_leftovers(*folders: Path) -> None:
    """Remove the temporary files of a run that was killed; to be called by whoever holds the journal alone."""
    for folder in folders:
        for path in folder.glob(".*") if folder.is_dir() else ():
            if _LEFTOVER.fullmatch(path.name):
                path.unlink()


def _info_document(records: Iterable[ImageRecord]) -> Iterator[bytes]:
    separator = b"{\n"
    for record in records:
        yield separator + f'  "{record.im_id}": '.encode() + orjson.dumps(record.infos)
        separator = b",\n"
    yield b"\n}\n" if separator == b",\n" else b"{}\n"


def _coco(records: Iterable[ImageRecord]) -> Iterator[CocoImage]:
    return (record.coco for record in records if record.coco is not None)


def _remove_from(folder: Path, im_id: int, index: int) -> None:
    """Remove the masks of an image from an index on."""
    while (path := folder / mask_name(im_id, index)).is_file():
        path.unlink()
        index += 1
