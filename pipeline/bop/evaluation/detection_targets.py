"""What has to be detected in the images of a list: the instances visible by at least 10 % (BOP Challenge 2024)."""

from collections.abc import Iterable, Sequence

import numpy as np
from jaxtyping import Bool

from pipeline.bop.dataset import Dataset
from pipeline.bop.target_lists import target_list
from pipeline.bop.targets import MIN_VISIBLE_FRACTION
from pipeline.exceptions import FormatError
from pipeline.scene import GroundTruth, ImageKey, Target


def detection_targets(dataset: Dataset, images: Iterable[ImageKey]) -> tuple[tuple[Target, ...], str]:
    """Every annotated object of every image, with the number of its instances that have to be detected, and a note.

    Where visibility is unknown, the list of 2019 tells it if it asks for all or for none of an object's instances;
    the note says for how many of them it did. Raises FormatError where neither tells.
    """
    found: list[Target] = []
    listed: dict[tuple[int, int, int], int] | None = None
    from_list = 0
    for key in images:
        truth = dataset.scene_ground_truth(key.scene_id)
        span = truth.spans.get(key.im_id, slice(0, 0))
        obj_ids, fractions = truth.obj_ids[span], truth.visible_fraction[span]
        for obj_id in np.unique(obj_ids).tolist():
            of_object = fractions[obj_ids == obj_id]
            target = Target(*key, obj_id, int(np.count_nonzero(of_object >= MIN_VISIBLE_FRACTION)))
            if np.isnan(of_object).any():
                listed = _listed(dataset) if listed is None else listed
                target = target._replace(inst_count=listed.get(target[:3], 0))
                _check(dataset, target, len(of_object), bool(listed))
                from_list += len(of_object)
            found.append(target)
    return tuple(found), _note(from_list)


def demanded_instances(target: Target, instances: Sequence[GroundTruth]) -> Bool[np.ndarray, "g"]:
    """Which instances of a target made by `detection_targets` have to be detected."""
    fractions = [gt.visible_fraction for gt in instances]
    if None in fractions:  # all or none
        return np.full(len(instances), target.inst_count > 0)
    return np.array(fractions, dtype=float) >= MIN_VISIBLE_FRACTION


def _listed(dataset: Dataset) -> dict[tuple[int, int, int], int]:
    """Instances asked for in 2019, by scene, image and object; empty without that list."""
    found = target_list(dataset, ("bop19",))
    return {target[:3]: target.inst_count for target in found.targets} if found.path else {}


def _check(dataset: Dataset, target: Target, annotated: int, has_list: bool) -> None:
    """Refuse to guess which of some instances are visible."""
    if not has_list or 0 < target.inst_count < annotated:
        told = f", of which the list of 2019 asks for {target.inst_count}" if has_list else ""
        raise FormatError(
            f"{dataset.name}/{dataset.split}: scene {target.scene_id}, image {target.im_id}: it is unknown which of the "
            f"{annotated} instances of object {target.obj_id} are visible by 10 %{told}; "
            "add the scene's scene_gt_info.json: inspector gt-info --only info"
        )


def _note(from_list: int) -> str:
    if not from_list:
        return ""
    return (
        f"which of {from_list} annotated instances are visible by 10 % was taken from the list of targets of 2019, since "
        "there is no scene_gt_info.json; the benchmark may have taken a few for the other"
    )
