"""A results file scored as in the BOP Challenge 2017: one instance of one object, by VSD (thesis sec. bop17_setup).

A target is a pair of an image and an object that is visible in it. Of the estimates for it the one of highest score
counts, and it may be of any instance that is visible by at least 10 %. It is correct if its VSD, with a misalignment
tolerance of 20 mm and a visibility tolerance of 15 mm, is below 0.3. The score is the share of targets with a correct
estimate, whatever object they are of; where an object is not measured, it counts as not visible ("bop18").
"""

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import groupby
from operator import attrgetter

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.bop.dataset import Dataset
from pipeline.bop.evaluation.columns import HERE, Columns, Execution, Progress
from pipeline.bop.evaluation.pair_errors import vsd_of_pairs
from pipeline.bop.evaluation.scorable import check, why_no_depth
from pipeline.bop.evaluation.summary import Summary, counts, time_per_image
from pipeline.bop.evaluation.target_errors import annotations_of_target, best_poses
from pipeline.bop.results import Results
from pipeline.bop.target_lists import target_list
from pipeline.bop.targets import MIN_VISIBLE_FRACTION
from pipeline.exceptions import InputError
from pipeline.scene import Camera, GroundTruth, Target

TAUS = (0.020, 0.080)
"""Misalignment tolerances in metres: that of the score, and the other one of the thesis's curves."""

THETA = 0.3
"""Threshold of correctness."""

DELTA = 0.015
"""Tolerance of the visibility masks, metres."""

_NAME = "siso_recall"


@dataclass(frozen=True, eq=False)
class SisoTargets:
    """The pairs of an image and an object that a method was asked for, a row each."""

    scene_id: Int[np.ndarray, "n"]
    im_id: Int[np.ndarray, "n"]
    obj_id: Int[np.ndarray, "n"]
    gt_index: Int[np.ndarray, "n"]
    """The instance that the estimate is nearest to, by VSD; -1 where there is no estimate."""
    visible_fraction: Float[np.ndarray, "n"]
    """Of the instance of it that is seen best, as in the thesis's curves; NaN where unknown."""
    vsd: Float[np.ndarray, "n tau"]
    """At each of `TAUS`, against the instance where it is lowest; infinite where there is no estimate."""

    def __len__(self) -> int:
        return len(self.obj_id)

    @cached_property
    def found(self) -> Bool[np.ndarray, "n"]:
        """Whether the estimate is correct."""
        return self.vsd[:, 0] < THETA


@dataclass(frozen=True, eq=False)
class SisoEvaluation:
    """How well a method did on a dataset at the task of 2017."""

    targets: SisoTargets | None
    """None where there is no VSD."""
    summary: Summary


def evaluate_siso(
    dataset: Dataset,
    results: Results,
    progress: Progress = lambda _: None,
    *,
    execution: Execution = HERE,
) -> SisoEvaluation:
    """Score results on the targets of 2017 (`test_targets_bop18.json`), else of 2019, else on what is annotated.

    Without depth in all images with targets the score is None, with the reason.

    Raises:
        InputError: there are no targets, none has an estimate or one has no usable ground truth; a file is damaged.

    """
    begun = time.perf_counter()
    listed = target_list(dataset, ("bop18", "bop19"))
    check(dataset, results, listed.targets)
    reason = why_no_depth(dataset, listed.targets)
    targets = None
    if not reason:
        targets = SisoTargets(**execution.columns(siso_columns, dataset, results, listed.targets, progress))
        if not len(targets):
            raise InputError(
                f"{dataset.name}/{dataset.split}: no instance of a target is visible by 10 %; "
                "evaluate another split, or correct its scene_gt_info.json"
            )
    recall = partial(_recall, targets)
    summary = Summary(
        dataset=dataset.name,
        split=dataset.split,
        task="siso",
        method=results.method,
        scores=recall(),
        per_object={} if targets is None else {i: recall(targets.obj_id == i) for i in counts(targets.obj_id)},
        per_scene={} if targets is None else {i: recall(targets.scene_id == i) for i in counts(targets.scene_id)},
        targets=len(listed.targets) if targets is None else len(targets),
        targets_per_object={} if targets is None else counts(targets.obj_id),
        seconds=time.perf_counter() - begun,
        time_per_image=time_per_image(results),
        reasons={_NAME: reason} if reason else {},
        incomplete=listed.incomplete,
    )
    return SisoEvaluation(targets, summary)


def siso_columns(dataset: Dataset, results: Results, targets: Sequence[Target]) -> Columns:
    """The fields of `SisoTargets` for some targets; one whose every instance is seen by less than 10 % is left out."""
    ids: list[tuple[int, int, int, int]] = []
    fractions: list[float] = []
    errors: list[np.ndarray] = []
    for key, of_image in groupby(targets, attrgetter("image")):
        camera, annotations, depth = dataset.camera(key), dataset.ground_truth(key), dataset.depth(key)
        assert depth is not None  # looked for before
        for target in of_image:
            visible = _visible(annotations_of_target(dataset, target, annotations))
            if visible:
                error, gt_index = _error(dataset, results, target, visible, camera, depth)
                ids.append((*target[:3], gt_index))
                fractions.append(_largest_fraction(visible))
                errors.append(error)
    table = np.array(ids, dtype=np.int64).reshape(-1, 4).T
    columns = dict(zip(("scene_id", "im_id", "obj_id", "gt_index"), table, strict=True))
    return columns | {
        "visible_fraction": np.array(fractions, dtype=float),
        "vsd": np.array(errors, dtype=float).reshape(-1, len(TAUS)),
    }


def _visible(annotations: Sequence[GroundTruth]) -> list[GroundTruth]:
    """Instances that are seen well enough to be asked for; all whose visibility is unknown."""
    return [gt for gt in annotations if gt.visible_fraction is None or gt.visible_fraction >= MIN_VISIBLE_FRACTION]


def _largest_fraction(instances: Sequence[GroundTruth]) -> float:
    """Visible fraction of the instance seen best; NaN if one is unknown."""
    return float(np.max([np.nan if gt.visible_fraction is None else gt.visible_fraction for gt in instances]))


def _error(
    dataset: Dataset,
    results: Results,
    target: Target,
    instances: list[GroundTruth],
    camera: Camera,
    depth: Float[np.ndarray, "h w"],
) -> tuple[Float[np.ndarray, "tau"], int]:
    """VSD of the best scored estimate against the instance where it is lowest, and which instance that is."""
    estimates = best_poses(results, target, count=1)
    if not estimates:
        return np.full(len(TAUS), np.inf), -1
    truths, model = [gt.camera_from_model for gt in instances], dataset.model(target.obj_id)
    lengths = {"taus": TAUS, "delta": DELTA, "relative": False}
    errors = vsd_of_pairs(model, camera, depth, estimates, truths, variant="bop18", **lengths)[:, 0]
    return errors.min(axis=1), instances[int(errors[0].argmin())].index


def _recall(targets: SisoTargets | None, rows: Bool[np.ndarray, "n"] | slice = slice(None)) -> dict[str, float | None]:
    if targets is None:
        return {_NAME: None}
    return {_NAME: float(targets.found[rows].mean())}
