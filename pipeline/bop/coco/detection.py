"""2D detections and segmentations scored with COCO's measures, as the BOP Challenge does (its `eval_bop22_coco.py`).

Images are those of the list of 2019, else of 2024, and the ground truth is `scene_gt_coco.json` of each scene: boxes
of the full silhouettes (amodal), or of the visible ones from `scene_gt_coco_modal.json`, and masks of the visible
silhouettes. Instances visible by less than 10 % are marked there as to be ignored: they do not have to be detected,
and a detection of one is neither right nor wrong.
"""

import time
from collections.abc import Sequence

import numpy as np

from pipeline.bop.coco.ground_truth import CocoTruth, Entry, read_coco_truth
from pipeline.bop.coco.measures import compared, scores, scores_of_images, scores_of_objects
from pipeline.bop.coco.results import Detections, Measure
from pipeline.bop.dataset import Dataset
from pipeline.bop.evaluation.summary import Summary, counts
from pipeline.bop.target_lists import by_scene, target_list
from pipeline.exceptions import FormatError, InputError
from pipeline.scene import ImageKey


def evaluate_detections(
    dataset: Dataset, detections: Detections, measure: Measure | None = None, *, modal: bool = False
) -> Summary:
    """Score detections by boxes or masks; without `measure` by masks if there are any. `modal` is for boxes.

    Raises:
        InputError: nothing has to be detected, or nothing is in the images asked for; a file is damaged or missing.

    """
    begun = time.perf_counter()
    measure = measure or detections.measure
    listed = target_list(dataset, ("bop19", "bop24"))
    truth = read_coco_truth(dataset, by_scene(listed.images), modal and measure == "bbox")
    inside, notes = _inside(dataset, detections, measure, truth)
    evaluator = compared(truth, _in_coco_form(inside, measure, truth, detections), measure)
    overall, per_object = scores(evaluator), scores_of_objects(evaluator)
    scenes = dict.fromkeys(key.scene_id for key in truth.numbers)
    asked = [annotation["category_id"] for annotation in truth.annotations if not annotation["ignored"]]
    targets_per_object = counts(np.array(asked, dtype=np.int64))
    return Summary(
        dataset=dataset.name,
        split=dataset.split,
        task=measure,
        method=detections.method,
        scores=overall,
        per_object={i: per_object[i] for i in targets_per_object},
        per_scene={scene_id: scores_of_images(evaluator, truth.of_scene(scene_id)) for scene_id in scenes},
        targets=len(asked),
        targets_per_object=targets_per_object,
        seconds=time.perf_counter() - begun,
        time_per_image=detections.time_per_image,
        reasons={name: "no annotated instance is of this size" for name, value in overall.items() if value is None},
        incomplete=listed.incomplete,
        notes=notes,
    )


def _inside(
    dataset: Dataset, detections: Detections, measure: Measure, truth: CocoTruth
) -> tuple[list[Entry], tuple[str, ...]]:
    """Detections that have what is measured and are in the images asked for, and notes on the others."""
    what = {"bbox": "box", "segm": "mask"}[measure]
    measured = detections.of(measure)
    keys = [ImageKey(entry["scene_id"], entry["image_id"]) for entry in measured]
    inside = [entry for key, entry in zip(keys, measured, strict=True) if key in truth.numbers]
    if len(detections) and not inside:
        raise InputError(
            f"{detections.path}: none of its {len(detections)} detections has a {what} and is in an image with targets "
            f"of {dataset.name}/{dataset.split}; give the dataset and split that they are for"
        )
    notes = []
    if without := len(detections) - len(measured):
        notes.append(f"{without} of {len(detections)} detections have no {what} and do not count")
    if outside := len(measured) - len(inside):
        first = next(key for key in keys if key not in truth.numbers)
        notes.append(
            f"{outside} of {len(measured)} detections are not in an image with targets and do not count "
            f"(first: scene {first.scene_id}, image {first.im_id})"
        )
    return inside, tuple(notes)


def _in_coco_form(entries: Sequence[Entry], measure: Measure, truth: CocoTruth, detections: Detections) -> list[Entry]:
    sizes = {image["id"]: [image["height"], image["width"]] for image in truth.images}
    by_box = all(entry.get("bbox") for entry in entries)
    found = []
    for number, entry in enumerate(entries, start=1):
        image = truth.numbers[ImageKey(entry["scene_id"], entry["image_id"])]
        shape = _box(entry) if measure == "bbox" else _mask(entry, sizes[image], by_box, detections)
        own = {"id": number, "image_id": image, "category_id": entry["category_id"], "score": entry["score"]}
        found.append(own | shape | {"iscrowd": 0})
    return found


def _box(entry: Entry) -> Entry:
    return {"bbox": entry["bbox"], "area": entry["bbox"][2] * entry["bbox"][3]}


def _mask(entry: Entry, size: list[int], by_box: bool, detections: Detections) -> Entry:
    """A mask as compressed run lengths; its size class goes by the box where all have one, as in COCO's `loadRes`."""
    from pycocotools import mask

    rle = entry["segmentation"]
    if rle["size"] != size:
        raise FormatError(
            f"{detections.path}: detection in scene {entry['scene_id']}, image {entry['image_id']}: its mask has the size "
            f"{rle['size']} (height, width), the image {size}; give the mask of the whole image"
        )
    packed = mask.frPyObjects(rle, *size) if isinstance(rle["counts"], list) else rle
    return {"segmentation": packed, "area": _box(entry)["area"] if by_box else float(mask.area(packed))}
