"""Some of a dataset's targets, as they are chosen on a command line."""

from collections import defaultdict
from collections.abc import Collection
from pathlib import Path

from pipeline.bop.dataset import Dataset
from pipeline.bop.targets import read_targets
from pipeline.exceptions import InputError, UnknownIdError
from pipeline.scene import ImageKey, Target


def chosen_targets(
    dataset: Dataset, listed: Path | None = None, scenes: Collection[int] = (), images: Collection[int] = ()
) -> list[Target]:
    """Targets of a list (by default the dataset's own), or of these scenes and images of it only.

    Raises InputError if none is left, UnknownIdError for a scene or image that is not there.
    """
    for scene_id in scenes:
        if scene_id not in dataset.scene_ids:
            raise UnknownIdError("scene", scene_id, f"{dataset.name}/{dataset.split}", dataset.scene_ids)
    targets = [target for target in _all(dataset, listed) if not scenes or target.scene_id in scenes]
    here = {target.im_id for target in targets}
    for im_id in images:
        if im_id not in here:
            raise UnknownIdError("image", im_id, "the targets of these scenes", here)
    chosen = [target for target in targets if not images or target.im_id in images]
    if not chosen:
        where = listed or f"{dataset.name}/{dataset.split}"
        raise InputError(f"{where}: has no targets for the images here; give a list of them with --targets")
    return chosen


def _all(dataset: Dataset, listed: Path | None) -> Collection[Target]:
    if listed is None:
        return dataset.targets()
    annotated: dict[ImageKey, list[Target]] = defaultdict(list)

    def of_image(key: ImageKey) -> tuple[Target, ...]:
        """What is annotated: lists of 2024 name images only."""
        if not annotated:
            for target in dataset.annotated_targets():
                annotated[target.image].append(target)
        return tuple(annotated[key])

    on_disk = {scene_id: frozenset(dataset.image_ids(scene_id)) for scene_id in dataset.scene_ids}
    return read_targets(listed, on_disk, of_image)
