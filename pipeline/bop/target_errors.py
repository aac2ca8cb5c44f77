"""Pose errors of the estimates that count for a target against the instances that count, as BOP's scripts take them.

Of a target the `inst_count` estimates of highest score are held against the `inst_count` most visible annotated
instances (thesis sec. bop_6d_object_localization).
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from operator import attrgetter
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.bop import errors
from pipeline.bop.dataset import Dataset
from pipeline.bop.results import Results
from pipeline.bop.scores import most_visible
from pipeline.bop.vsd import TAUS, vsd
from pipeline.exceptions import FormatError
from pipeline.geometry import transform
from pipeline.rendering import render_depths
from pipeline.scene import Camera, GroundTruth, Model, Target

MSPD_WIDTH_PX = 640
"""Image width that MSPD is scaled to."""


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


class _View(NamedTuple):
    """What the targets of one image share."""

    camera: Camera
    annotations: tuple[GroundTruth, ...]
    depth: Float[np.ndarray, "h w"] | None
    """None where VSD is not to be computed."""
    vsd_delta: float


def errors_of_targets(
    dataset: Dataset, results: Results, targets: Sequence[Target], with_vsd: bool
) -> Iterator[TargetErrors]:
    """Errors target by target, in the order given; the files of an image are read once if its targets are in a row.

    Raises FormatError if a target has no annotation, or visibility is unknown where it decides which instances count.
    """
    for key, of_image in groupby(targets, attrgetter("image")):
        depth = dataset.depth(key) if with_vsd else None
        view = _View(dataset.camera(key), dataset.ground_truth(key), depth, dataset.facts.vsd_delta)
        for target in of_image:
            instances = _instances(f"{dataset.name}/{dataset.split}", target, view.annotations)
            rows = results.rows(key, target.obj_id)[: target.inst_count].tolist()
            estimates = [transform(results.rotation[row], results.translation_mm[row] / 1000.0) for row in rows]
            yield _errors(target, dataset.model(target.obj_id), view, estimates, instances)


def _instances(split: str, target: Target, annotations: Sequence[GroundTruth]) -> tuple[GroundTruth, ...]:
    of_object = tuple(gt for gt in annotations if gt.obj_id == target.obj_id)
    where = f"{split}: scene {target.scene_id}, image {target.im_id}"
    if not of_object:
        raise FormatError(
            f"{where}: no annotation of object {target.obj_id}, which is a target there; "
            "evaluate a split with public ground truth, or take it off the list of targets"
        )
    if len(of_object) <= target.inst_count:
        return of_object
    fractions = [gt.visible_fraction for gt in of_object if gt.visible_fraction is not None]
    if len(fractions) < len(of_object):
        raise FormatError(
            f"{where}: object {target.obj_id} is annotated {len(of_object)} times and the {target.inst_count} most "
            "visible ones count, but visibility is unknown; add the scene's scene_gt_info.json"
        )
    return tuple(of_object[i] for i in most_visible(fractions, target.inst_count))


def _errors(
    target: Target, model: Model, view: _View, estimates: list[np.ndarray], instances: tuple[GroundTruth, ...]
) -> TargetErrors:
    truths = [gt.camera_from_model for gt in instances]
    K, scale = view.camera.K, MSPD_WIDTH_PX / view.camera.width
    return TargetErrors(
        target,
        instances,
        mssd=_table(estimates, truths, lambda estimate, truth: _mssd(model, estimate, truth)),
        mspd=_table(estimates, truths, lambda estimate, truth: errors.mspd(model, K, estimate, truth).value * scale),
        vsd=None if view.depth is None else _vsd(model, view, view.depth, estimates, truths),
    )


def _table(
    estimates: list[np.ndarray], truths: list[np.ndarray], error: Callable[[np.ndarray, np.ndarray], float]
) -> Float[np.ndarray, "e g"]:
    """Error of every estimate against every ground-truth pose."""
    values = [error(estimate, truth) for estimate in estimates for truth in truths]
    return np.array(values, dtype=float).reshape(len(estimates), len(truths))


def _mssd(model: Model, estimate: Float[np.ndarray, "4 4"], truth: Float[np.ndarray, "4 4"]) -> float:
    if not errors.spheres_overlap(estimate, truth, model.diameter):
        return np.inf
    return errors.mssd(model, estimate, truth).value / model.diameter


def _vsd(
    model: Model, view: _View, depth: Float[np.ndarray, "h w"], estimates: list[np.ndarray], truths: list[np.ndarray]
) -> Float[np.ndarray, "tau e g"]:
    """VSD of all pairs, from one call of the ray caster."""
    values = np.ones((len(TAUS), len(estimates), len(truths)))
    near = _table(estimates, truths, lambda e, g: errors.sphere_projections_overlap(e, g, model.diameter))
    if not near.any():
        return values
    drawn = render_depths(model, view.camera, np.stack([*estimates, *truths]))
    for e, g in np.argwhere(near).tolist():
        at_estimate, at_truth = drawn[e], drawn[len(estimates) + g]
        pair = vsd(at_estimate, at_truth, depth, view.camera.K, model.diameter, delta=view.vsd_delta)
        values[:, e, g] = pair.values
    return values
