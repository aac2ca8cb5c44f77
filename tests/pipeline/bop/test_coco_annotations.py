"""COCO files, as pycocotools reads them."""

import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.bop.coco.annotations import CocoImage, coco_document, coco_instance, run_lengths

SHAPE = (6, 8)


def mask(*pixels: tuple[slice | int, slice | int]) -> np.ndarray:
    found = np.zeros(SHAPE, bool)
    for rows, columns in pixels:
        found[rows, columns] = True
    return found


FULL = mask((slice(1, 5), slice(2, 7)))
PART = mask((slice(3, 5), slice(2, 4)))
CORNER = mask((0, 0), (5, 7))
EMPTY = mask()


def write(folder: Path, images: list[CocoImage], *, modal: bool = False) -> Path:
    path = folder / "scene_gt_coco.json"
    path.write_bytes(b"".join(coco_document("parts", "parts_test", [1, 2, 5], lambda: images, modal)))
    return path


@pytest.fixture
def images() -> list[CocoImage]:
    first = (
        coco_instance(5, 0.2, FULL, PART),
        coco_instance(1, 0.0, FULL, EMPTY),
        coco_instance(1, 0.09, CORNER, CORNER),
    )
    return [
        CocoImage(3, "rgb/000003.png", 8, 6, first),
        CocoImage(4, "rgb/000004.png", 8, 6, ()),
        CocoImage(12, "rgb/000012.png", 8, 6, (coco_instance(2, 0.1, FULL, FULL),)),
    ]


@pytest.mark.parametrize("density", [0.0, 0.1, 0.5, 0.9, 1.0])
@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (7, 1), (5, 9)])
def test_run_lengths_count_pixels_column_by_column(shape, density):
    pixels = np.random.default_rng(5).random(shape) < density
    counts, value, length = [], False, 0
    for pixel in pixels.T.ravel().tolist():
        if pixel != value:
            counts.append(length)
            value, length = pixel, 0
        length += 1
    assert run_lengths(pixels) == (*counts, length)


@pytest.mark.filterwarnings("ignore:__array__ implementation:DeprecationWarning")  # in pycocotools
def test_pycocotools_reads_the_masks_back(tmp_path, images, capsys):
    from pycocotools.coco import COCO

    coco = COCO(str(write(tmp_path, images)))
    found = [coco.annToMask(annotation).astype(bool) for annotation in coco.dataset["annotations"]]
    assert [np.array_equal(a, b) for a, b in zip(found, [PART, CORNER, FULL], strict=True)] == [True] * 3
    assert [len(coco.getAnnIds(imgIds=[im_id])) for im_id in (3, 4, 12)] == [2, 0, 1]
    assert coco.getCatIds() == [1, 2, 5]
    assert coco.loadImgs([12])[0]["file_name"] == "rgb/000012.png"


def test_fields_are_those_of_bop(tmp_path, images):
    content = json.loads(write(tmp_path, images).read_text())
    assert content.keys() >= {"info", "licenses", "categories", "images", "annotations"}
    assert content["categories"][2] == {"id": 5, "name": "5", "supercategory": "parts"}
    image = content["images"][0]
    assert (image["id"], image["width"], image["height"]) == (3, 8, 6)
    first, second, third = content["annotations"]
    assert first == {
        "id": 1,
        "image_id": 3,
        "category_id": 5,
        "iscrowd": 0,
        "area": 4,
        "bbox": [2, 1, 5, 4],
        "segmentation": {"counts": [15, 2, 4, 2, 25], "size": [6, 8]},
        "width": 8,
        "height": 6,
        "ignore": False,
    }
    assert (second["id"], second["ignore"], second["bbox"]) == (2, True, [0, 0, 8, 6])
    assert (third["id"], third["ignore"]) == (3, False)  # a tenth is visible enough


def test_modal_boxes_are_those_of_what_is_visible(tmp_path, images):
    content = json.loads(write(tmp_path, images, modal=True).read_text())
    assert content["annotations"][0]["bbox"] == [2, 3, 2, 2]


def test_scene_without_images_is_a_sound_file(tmp_path, capsys):
    from pycocotools.coco import COCO

    assert COCO(str(write(tmp_path, []))).getImgIds() == []
