"""Annotations of a scene in COCO's form, as BOP's `scene_gt_coco.json` holds them.

One category per object of the dataset, image ids as in BOP, annotation ids counted from 1 within the scene. The
segmentation is the visible silhouette as run lengths, the box that of the full silhouette inside the image (amodal),
or in `scene_gt_coco_modal.json` that of the visible one. Instances of which nothing is visible are left out; those
of which less than a tenth is visible are to be ignored.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import orjson
from jaxtyping import Bool

from pipeline.bop.targets import MIN_VISIBLE_FRACTION

PixelBox = tuple[int, int, int, int]
"""x, y, width, height in pixels, as COCO counts them."""


@dataclass(frozen=True)
class CocoInstance:
    """An annotated instance with its silhouettes."""

    obj_id: int
    visible_fraction: float
    """0..1; not known from the silhouettes, which end at the border of the image."""
    area: int
    """Visible pixels."""
    box: PixelBox | None
    """Of the full silhouette inside the image, None where there is none."""
    visible_box: PixelBox | None
    """Of the visible silhouette, None where there is none."""
    run_lengths: tuple[int, ...]
    """The visible silhouette, see `run_lengths`; empty where nothing is visible."""


@dataclass(frozen=True)
class CocoImage:
    """An image with its annotated instances."""

    im_id: int
    file_name: str
    """Path from the scene's folder."""
    width: int
    height: int
    instances: tuple[CocoInstance, ...]


def coco_instance(
    obj_id: int, visible_fraction: float, mask: Bool[np.ndarray, "h w"], visible_mask: Bool[np.ndarray, "h w"]
) -> CocoInstance:
    """Describe an instance by its full and its visible silhouette, both of the whole image."""
    area, visible_box = int(np.count_nonzero(visible_mask)), _pixel_box(visible_mask)
    lengths = run_lengths(visible_mask) if area else ()
    return CocoInstance(obj_id, visible_fraction, area, _pixel_box(mask), visible_box, lengths)


def run_lengths(mask: Bool[np.ndarray, "h w"]) -> tuple[int, ...]:
    """COCO's uncompressed run lengths: column by column, how many pixels are off, then on, then off and so on."""
    columns = np.flatnonzero(mask.any(axis=0))
    if not len(columns):
        return (mask.size,)
    height, first = len(mask), int(columns[0])
    pixels = mask[:, first : columns[-1] + 1].ravel(order="F")  # the columns between are quick to put in order
    changes = first * height + np.flatnonzero(np.diff(pixels, prepend=False, append=False))
    lengths = np.diff(changes, prepend=0, append=mask.size).tolist()
    return tuple(lengths if lengths[-1] else lengths[:-1])


def coco_document(
    dataset_name: str,
    description: str,
    obj_ids: Iterable[int],
    images: Callable[[], Iterable[CocoImage]],
    modal: bool = False,
) -> Iterator[bytes]:
    """The file as parts to be written one after the other; `images` is called twice and need hold one at a time."""
    categories = [{"id": obj_id, "name": str(obj_id), "supercategory": dataset_name} for obj_id in obj_ids]
    head = {"info": {"description": description, "version": "1"}, "licenses": [], "categories": categories}
    yield orjson.dumps(head)[:-1] + b',\n"images": [\n'
    yield from _lines(map(_image_entry, images()))
    yield b'],\n"annotations": [\n'
    yield from _lines(_annotation_entries(images(), modal))
    yield b"]}\n"


def _image_entry(image: CocoImage) -> dict[str, Any]:
    return {
        "id": image.im_id,
        "file_name": image.file_name,
        "width": image.width,
        "height": image.height,
        "date_captured": "",
        "license": 1,
        "coco_url": "",
        "flickr_url": "",
    }


def _annotation_entries(images: Iterable[CocoImage], modal: bool) -> Iterator[dict[str, Any]]:
    annotation_id = 0
    for image in images:
        for instance in image.instances:
            box = instance.visible_box if modal else instance.box
            if not instance.area or box is None:
                continue
            annotation_id += 1
            yield {
                "id": annotation_id,
                "image_id": image.im_id,
                "category_id": instance.obj_id,
                "iscrowd": 0,
                "area": instance.area,
                "bbox": box,
                "segmentation": {"counts": instance.run_lengths, "size": [image.height, image.width]},
                "width": image.width,
                "height": image.height,
                "ignore": instance.visible_fraction < MIN_VISIBLE_FRACTION,
            }


def _lines(entries: Iterable[dict[str, Any]]) -> Iterator[bytes]:
    """Entries of a JSON list, a line each."""
    separator = b""
    for entry in entries:
        yield separator + orjson.dumps(entry)
        separator = b",\n"
    yield b"\n"


def _pixel_box(mask: Bool[np.ndarray, "h w"]) -> PixelBox | None:
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return None
    left, top = int(columns[0]), int(rows[0])
    return left, top, int(columns[-1]) - left + 1, int(rows[-1]) - top + 1
