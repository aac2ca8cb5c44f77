"""The lists of targets that come with a dataset, one for each year's challenge: which images and objects they name.

`Dataset.targets` takes the list of 2019. The tasks of other years have lists of their own.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from pipeline.bop import layout
from pipeline.bop.dataset import Dataset
from pipeline.bop.json_files import read_json
from pipeline.bop.targets import read_targets
from pipeline.scene import ImageKey, Target


@dataclass(frozen=True)
class TargetList:
    """What one list names of the images on disk."""

    path: Path | None
    """The file; None where the dataset has none of those wanted and the ground truth stands in for it."""
    targets: tuple[Target, ...]
    """In the order of the list; objects with no instance are left out. Empty where the list names images only."""
    images: tuple[ImageKey, ...]
    """Each once, in the order of the list."""
    images_named: int
    """Number of images in the list, on disk or not."""

    @property
    def incomplete(self) -> str:
        """Tell how many images of the list are missing; empty if none is."""
        here, named = len(self.images), self.images_named
        return f"{here} of the {named} images of {self.path.name} are here" if self.path and here < named else ""


def target_list(dataset: Dataset, years: Sequence[str]) -> TargetList:
    """The first list that there is of `years` (such as "bop19"), else what is annotated.

    Raises FormatError that names the entry if the list is damaged.
    """
    kind = dataset.split.partition("_")[0]
    by_name = {path.name: path for path in layout.target_files(dataset.root, dataset.split)}
    path = next((by_name[name] for year in years if (name := f"{kind}_targets_{year}.json") in by_name), None)
    if path is None:
        targets = dataset.annotated_targets()
        images = dict.fromkeys(key for key in dataset.images() if dataset.has_ground_truth(key.scene_id))
        return TargetList(None, targets, tuple(images), len(images))
    on_disk = {scene_id: frozenset(dataset.image_ids(scene_id)) for scene_id in dataset.scene_ids}
    found = read_targets(path, on_disk, lambda key: (Target(*key, 0, 0),))
    targets = tuple(target for target in found if target.inst_count > 0)
    named = {(entry["scene_id"], entry["im_id"]) for entry in read_json(path)}
    return TargetList(path, targets, tuple(dict.fromkeys(target.image for target in found)), len(named))


def by_scene(images: Iterable[ImageKey]) -> tuple[ImageKey, ...]:
    """Images with those of a scene together: scenes, and images of each, in the order of their first mention."""
    scenes: dict[int, list[ImageKey]] = {}
    for key in images:
        scenes.setdefault(key.scene_id, []).append(key)
    return tuple(key for of_scene in scenes.values() for key in of_scene)
