"""Whether results can be scored on a dataset at all: what would leave out a target, or score results of something else."""

from collections.abc import Sequence

from pipeline.bop.dataset import Dataset
from pipeline.bop.results import Results
from pipeline.exceptions import FormatError, InputError
from pipeline.scene import Target


def check(dataset: Dataset, results: Results, targets: Sequence[Target]) -> None:
    """Refuse what cannot be scored: damaged ground truth, no targets, results for something else.

    Results without a row are scored: they find nothing.
    """
    where = f"{dataset.name}/{dataset.split}"
    check_ground_truth(dataset)
    if not targets:
        raise InputError(f"{where}: no targets and no ground truth to make them from; evaluate an annotated split")
    if len(results) and not any(len(results.rows(target.image, target.obj_id)) for target in targets):
        raise InputError(
            f"results of {results.method or 'the method'}: none of the {len(results)} estimates is for a target of "
            f"{where}; give the dataset and split that they are for"
        )


def check_ground_truth(dataset: Dataset) -> None:
    """Raise FormatError for a damaged entry of the ground truth: targets made from it would lack it."""
    for scene_id in dataset.scene_ids:
        for damage in dataset.scene_ground_truth(scene_id).damage.values():
            raise FormatError(damage)


def why_no_depth(dataset: Dataset, targets: Sequence[Target]) -> str:
    """Name an image with targets and without depth; empty if there is none."""
    images = dict.fromkeys(target.image for target in targets)
    without = [key for key in images if dataset.depth_path(key) is None]
    if not without:
        return ""
    first = f"scene {without[0].scene_id}, image {without[0].im_id}"
    return f"no depth image for {len(without)} of {len(images)} images with targets (first: {first})"
