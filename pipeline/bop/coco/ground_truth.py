"""Ground truth of 2D detection: the annotations of all scenes' `scene_gt_coco.json` together, in COCO's form."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pipeline.bop.dataset import Dataset
from pipeline.bop.json_files import read_json_object
from pipeline.exceptions import FormatError, InputError, MissingFileError
from pipeline.scene import ImageKey

Entry = dict[str, Any]


@dataclass(frozen=True)
class CocoTruth:
    """Images, annotations and categories (objects); images and annotations have numbers of their own, from 1."""

    images: list[Entry]
    annotations: list[Entry]
    """`ignored` tells which ones do not have to be detected."""
    categories: list[Entry]
    numbers: dict[ImageKey, int]
    """The number of each image; in the order of scenes, and of image ids in each."""

    def of_scene(self, scene_id: int) -> list[int]:
        """Numbers of the images of a scene."""
        return [number for key, number in self.numbers.items() if key.scene_id == scene_id]


def read_coco_truth(dataset: Dataset, images: Sequence[ImageKey], modal: bool) -> CocoTruth:
    """Annotations of some images, with the boxes of the visible silhouettes (`modal`) or of the full ones.

    Raises InputError where there are none, and where a file is missing, damaged or lacks one of the images.
    """
    truth, again = CocoTruth([], [], [], {}), f"make it again: {_maker(dataset, modal)} --force"
    categories: dict[int, Entry] = {}
    for scene_id in dict.fromkeys(key.scene_id for key in images):
        path = _path(dataset, scene_id, modal)
        content = read_json_object(path)
        try:
            categories |= {int(category["id"]): category for category in content["categories"]}
            of_image = {image["id"]: image for image in content["images"]}
            wanted = sorted(key.im_id for key in images if key.scene_id == scene_id)
            if absent := [im_id for im_id in wanted if im_id not in of_image]:
                raise FormatError(f"{path}: image {absent[0]} is on the list of targets and not in it; {again}")
            for im_id in wanted:
                _add_image(truth, ImageKey(scene_id, im_id), of_image[im_id])
            for annotation in content["annotations"]:
                _add_annotation(truth, scene_id, annotation)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise FormatError(f"{path}: is not in COCO's form ({error!r}); {again}") from error
    truth.categories.extend(categories[i] for i in sorted(categories))
    if all(annotation["ignored"] for annotation in truth.annotations):
        raise InputError(
            f"{dataset.name}/{dataset.split}: no instance has to be detected; evaluate a split with public ground truth"
        )
    return truth


def _path(dataset: Dataset, scene_id: int, modal: bool) -> Path:
    """File of the COCO annotations beside the ground truth of a scene."""
    poses = dataset.scene_ground_truth(scene_id).path
    path = poses.with_name(poses.name.replace("scene_gt", "scene_gt_coco_modal" if modal else "scene_gt_coco", 1))
    if not path.is_file():
        raise MissingFileError(f"{path}: no such file; make it: {_maker(dataset, modal)}")
    return path


def _maker(dataset: Dataset, modal: bool) -> str:
    return f"inspector gt-info {dataset.root} --split {dataset.split} --only {'coco-modal' if modal else 'coco'}"


def _add_image(truth: CocoTruth, key: ImageKey, image: Entry) -> None:
    number = truth.numbers[key] = len(truth.numbers) + 1
    truth.images.append(image | {"id": number})


def _add_annotation(truth: CocoTruth, scene_id: int, annotation: Entry) -> None:
    number = truth.numbers.get(ImageKey(scene_id, annotation["image_id"]))
    if number is None:
        return
    crowd = int(annotation.get("iscrowd", 0))
    truth.annotations.append(
        annotation
        | {
            "id": len(truth.annotations) + 1,  # COCO takes 0 for no match
            "image_id": number,
            "iscrowd": crowd,
            "ignored": bool(annotation.get("ignore") or crowd),
        }
    )
