"""Pose errors of the estimates that count for a target against the instances that count, as BOP's scripts take them.

Of a target the `inst_count` estimates of highest score are held against the `inst_count` most visible annotated
instances (thesis sec. bop_6d_object_localization).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import attrgetter

import numpy as np
from jaxtyping import Float

from pipeline.bop.dataset import Dataset
from pipeline.bop.evaluation.average_distance import is_symmetric
from pipeline.bop.evaluation.pair_errors import ad_of_pairs, mspd_of_pairs, mssd_of_pairs, vsd_of_pairs
from pipeline.bop.evaluation.scores import most_visible
from pipeline.bop.results import Results
from pipeline.exceptions import FormatError
from pipeline.geometry import transform
from pipeline.scene import Camera, GroundTruth, Target


@dataclass(frozen=True, eq=False)
class TargetErrors:
    """Errors of all pairs of an estimate (by falling score) and an instance of a target."""

    target: Target
    instances: tuple[GroundTruth, ...]
    mssd: Float[np.ndarray, "e g"]
    """As fractions of the diameter; infinite where the bounding spheres are apart."""
    mspd: Float[np.ndarray, "e g"]
    """Pixels in an image 640 wide."""
    vsd: Float[np.ndarray, "tau e g"] | None
    """At each of `vsd.TAUS`; 1 where the images of the bounding spheres are apart. None where not computed."""
    ad: Float[np.ndarray, "e g"] | None = None
    """ADD, or ADI of an object with ambiguous views, as fractions of the diameter. None where not computed."""


@dataclass(frozen=True, eq=False)
class _View:
    """What the targets of one image share."""

    camera: Camera
    annotations: tuple[GroundTruth, ...]
    depth: Float[np.ndarray, "h w"] | None
    """None where VSD is not to be computed."""


def errors_of_targets(
    dataset: Dataset, results: Results, targets: Sequence[Target], with_vsd: bool, with_ad: bool = False
) -> Iterator[TargetErrors]:
    """Errors target by target, in the order given; the files of an image are read once if its targets are in a row.

    Raises FormatError if a target has no annotation, or visibility is unknown where it decides which instances count.
    """
    for key, of_image in groupby(targets, attrgetter("image")):
        depth = dataset.depth(key) if with_vsd else None
        view = _View(dataset.camera(key), dataset.ground_truth(key), depth)
        for target in of_image:
            yield _errors(dataset, results, target, view, with_ad)


def annotations_of_target(dataset: Dataset, target: Target, annotations: Sequence[GroundTruth]) -> list[GroundTruth]:
    """Annotations of a target's object in its image. Raises FormatError if there is none."""
    of_object = [gt for gt in annotations if gt.obj_id == target.obj_id]
    if not of_object:
        raise FormatError(
            f"{_where(dataset, target)}: no annotation of object {target.obj_id}, which is a target there; "
            "evaluate a split with public ground truth, or take it off the list of targets"
        )
    return of_object


def best_poses(results: Results, target: Target, count: int | None = None) -> list[np.ndarray]:
    """Poses of the `inst_count` (or `count`) estimates of highest score for a target, by falling score."""
    rows = results.rows(target.image, target.obj_id)[: target.inst_count if count is None else count]
    return poses_of_rows(results, rows.tolist())


def poses_of_rows(results: Results, rows: Sequence[int]) -> list[np.ndarray]:
    """Poses `camera_from_model` of rows of a results file, 4x4, metres."""
    return [transform(results.rotation[row], results.translation_mm[row] / 1000.0) for row in rows]


def _errors(dataset: Dataset, results: Results, target: Target, view: _View, with_ad: bool) -> TargetErrors:
    instances = _instances(dataset, target, view.annotations)
    model, truths = dataset.model(target.obj_id), [gt.camera_from_model for gt in instances]
    estimates = best_poses(results, target)
    vsd = ad = None
    if view.depth is not None:
        vsd = vsd_of_pairs(model, view.camera, view.depth, estimates, truths, delta=dataset.facts.vsd_delta)
    if with_ad:
        ad = ad_of_pairs(model, is_symmetric(dataset, target.obj_id), estimates, truths) / model.diameter
    return TargetErrors(
        target,
        instances,
        mssd=mssd_of_pairs(model, estimates, truths) / model.diameter,
        mspd=mspd_of_pairs(model, view.camera, estimates, truths),
        vsd=vsd,
        ad=ad,
    )


def _instances(dataset: Dataset, target: Target, annotations: Sequence[GroundTruth]) -> tuple[GroundTruth, ...]:
    """The `inst_count` most visible annotations of a target, in the order of the file."""
    of_object = annotations_of_target(dataset, target, annotations)
    if len(of_object) <= target.inst_count:
        return tuple(of_object)
    fractions = [gt.visible_fraction for gt in of_object if gt.visible_fraction is not None]
    if len(fractions) < len(of_object):
        raise FormatError(
            f"{_where(dataset, target)}: object {target.obj_id} is annotated {len(of_object)} times and the "
            f"{target.inst_count} most visible ones count, but visibility is unknown; "
            "add the scene's scene_gt_info.json: inspector gt-info --only info"
        )
    return tuple(of_object[i] for i in most_visible(fractions, target.inst_count))


def _where(dataset: Dataset, target: Target) -> str:
    return f"{dataset.name}/{dataset.split}: scene {target.scene_id}, image {target.im_id}"
