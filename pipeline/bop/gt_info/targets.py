"""Making the lists of targets that come with a BOP dataset, from its ground truth.

`test_targets_bop19.json`, for localization, names the objects of each image with the number of their instances that
are visible enough (visible fraction at least 0.1, thesis sec. bop_6d_object_localization). `test_targets_bop24.json`,
for detection, tells nothing of the objects and names the images alone, as the public lists do since 2024. The official
lists of some datasets name a selection of the images, to save time; these name all.
"""

from collections.abc import Iterable
from pathlib import Path

import orjson

from pipeline.bop.dataset import Dataset
from pipeline.bop.json_files import write_atomically
from pipeline.bop.targets import read_targets, targets_from_ground_truth
from pipeline.exceptions import FormatError
from pipeline.scene import ImageKey, Target


def list_path(root: Path, split: str, year: str) -> Path:
    """File of a list, such as `test_targets_bop19.json` for any test split; `year` is bop19 or bop24."""
    return root / f"{split.partition('_')[0]}_targets_{year}.json"


def localization_targets(dataset: Dataset) -> list[Target]:
    """Targets of all annotated images on disk, by scene, image and object.

    Without a `scene_gt_info.json` all instances of a scene count. Raises FormatError for one that does not fit the
    annotations, and for damaged annotations.
    """
    targets: list[Target] = []
    for scene_id in dataset.scene_ids:
        truth = dataset.scene_ground_truth(scene_id)
        for problem in (*truth.damage.values(), *truth.warnings):
            raise FormatError(problem)
        targets += targets_from_ground_truth(scene_id, truth, dataset.image_ids(scene_id))
    return targets


def detection_images(dataset: Dataset, localization: Path | None = None) -> list[ImageKey]:
    """Images on disk of a list for detection: those of the list for localization, if given, else all annotated ones."""
    on_disk = {scene_id: frozenset(dataset.image_ids(scene_id)) for scene_id in dataset.scene_ids}
    if localization is not None:
        return list(dict.fromkeys(target.image for target in read_targets(localization, on_disk, lambda key: ())))
    return [
        ImageKey(scene_id, im_id)
        for scene_id in dataset.scene_ids
        for im_id in sorted(dataset.scene_ground_truth(scene_id).spans.keys() & on_disk[scene_id])
    ]


def write_detection_images(path: Path, images: Iterable[ImageKey]) -> None:
    """Write a list for detection, an image a line. Raises InputError if it cannot be written."""
    lines = [f"  {orjson.dumps(key._asdict()).decode()}" for key in images]
    write_atomically(path, ("[\n" + ",\n".join(lines) + "\n]\n").encode())
