"""A results file scored as the BOP Challenge 2024 does for 6D detection: mean average precision.

The rules are those of BOP's scripts (`eval_bop24_pose.py` and what it calls), to the last digit:

* The 100 estimates of highest score in an image count (200 in XYZ-IBD), whatever object they are of.
* Estimates of an object are matched greedily by score to all its instances in the image. Those of an object that is
  not annotated in the image at all are left out: they are neither right nor wrong.
* Instances visible by at least 10 % have to be detected. An estimate matched to another one is neither right nor wrong.
* Precision and recall are those of all estimates of an object in all images, by falling score. The average precision
  (see `average_precision`) is averaged over ten thresholds, for MSSD (0.05 to 0.5 diameters, and in 2025 also 2 to
  20 mm) and for MSPD (5 to 50 px in an image 640 wide), and then over the objects that have to be detected.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float

from pipeline.bop.dataset import Dataset
from pipeline.bop.evaluation.average_precision import average_precision
from pipeline.bop.evaluation.columns import HERE, Execution, Progress
from pipeline.bop.evaluation.detection_outcomes import (
    LEFT_OUT,
    RIGHT,
    THRESHOLDS,
    Outcomes,
    detection_columns,
    most_estimates,
)
from pipeline.bop.evaluation.detection_targets import detection_targets
from pipeline.bop.evaluation.scorable import check, check_ground_truth
from pipeline.bop.evaluation.summary import Named, Summary, counts, time_per_image
from pipeline.bop.results import Results
from pipeline.bop.target_lists import by_scene, target_list
from pipeline.exceptions import InputError
from pipeline.scene import ImageKey

Precisions = Mapping[str, Float[np.ndarray, "t"]]
"""Average precision at each threshold, by error."""


@dataclass(frozen=True, eq=False)
class PoseDetectionEvaluation:
    """How well a method did on a dataset at 6D detection."""

    outcomes: Outcomes
    summary: Summary

    @cached_property
    def precisions(self) -> dict[int, Precisions]:
        """Average precisions by id of the objects that have to be detected."""
        return precisions_of_objects(self.outcomes)


def evaluate_pose_detection(
    dataset: Dataset,
    results: Results,
    progress: Progress = lambda _: None,
    *,
    execution: Execution = HERE,
) -> PoseDetectionEvaluation:
    """Score results on the images of the list of 2024 (`test_targets_bop24.json`), else of 2019, else all annotated.

    Where `scene_gt_info.json` is missing, the list of 2019 tells which instances are visible by 10 %, if it can.

    Raises:
        InputError: nothing has to be detected, or no estimate is for anything annotated; a file is damaged or missing.

    """
    begun = time.perf_counter()
    check_ground_truth(dataset)
    listed = target_list(dataset, ("bop24", "bop19"))
    targets, note = detection_targets(dataset, by_scene(listed.images))
    check(dataset, results, targets)
    outcomes = Outcomes(**execution.columns(detection_columns, dataset, results, targets, progress))
    if not outcomes.demanded.any():
        raise InputError(
            f"{dataset.name}/{dataset.split}: no instance is visible by 10 %, so none has to be detected; "
            "evaluate another split, or correct its scene_gt_info.json"
        )
    notes = (note, _of_absent_objects(dataset, results, listed.images, outcomes))
    precisions = precisions_of_objects(outcomes)
    scenes = {i: precisions_of_objects(outcomes.of(outcomes.scene_id == i)) for i in counts(outcomes.scene_id)}
    summary = Summary(
        dataset=dataset.name,
        split=dataset.split,
        task="detection",
        method=results.method,
        scores=mean_scores(precisions),
        per_object={i: mean_scores({i: of_object}) for i, of_object in precisions.items()},
        per_scene={i: mean_scores(of_scene) for i, of_scene in scenes.items() if of_scene},
        targets=int(outcomes.demanded.sum()),
        targets_per_object=counts(outcomes.obj_id[outcomes.demanded]),
        seconds=time.perf_counter() - begun,
        time_per_image=time_per_image(results),
        incomplete=listed.incomplete,
        notes=tuple(filter(None, notes)),
    )
    return PoseDetectionEvaluation(outcomes, summary)


def _of_absent_objects(dataset: Dataset, results: Results, images: Sequence[ImageKey], outcomes: Outcomes) -> str:
    """Tell how many estimates are left out because of their object; empty if none is."""
    most = most_estimates(dataset)
    given = sum(min(len(results.rows(key)), most) for key in images)
    count = given - int(np.count_nonzero(outcomes.row >= 0))
    rule = "estimates of objects that are not annotated in their image do not count (BOP's rule)"
    return f"{rule}: {count}" if count else ""


def precisions_of_objects(outcomes: Outcomes) -> dict[int, Precisions]:
    """Average precisions by id of the objects that have to be detected, in the order of ids."""
    return {i: _precisions(outcomes.of(outcomes.obj_id == i)) for i in counts(outcomes.obj_id[outcomes.demanded])}


def mean_scores(precisions: Mapping[int, Precisions]) -> Named:
    """Means over objects under the names of BOP's scripts; `bop25_mAP_mm` takes MSSD as a length."""
    mean = {
        error: float(np.mean([of_object[error].mean() for of_object in precisions.values()])) for error in THRESHOLDS
    }
    return {
        "bop24_mAP": float(np.mean([mean["mssd"], mean["mspd"]])),
        "bop24_mAP_mssd": mean["mssd"],
        "bop24_mAP_mspd": mean["mspd"],
        "bop24_mAP_mssd_mm": mean["mssd_mm"],
        "bop25_mAP": mean["mssd"],
        "bop25_mAP_mm": mean["mssd_mm"],
    }


def _precisions(of_object: Outcomes) -> Precisions:
    """Average precisions of one object; equal scores stay in the order of the images."""
    estimates = np.flatnonzero(of_object.row >= 0)
    order = estimates[np.argsort(-of_object.score[estimates], kind="stable")]
    demanded = int(of_object.demanded.sum())
    return {error: _at_thresholds(getattr(of_object, error)[order], demanded) for error in THRESHOLDS}


def _at_thresholds(outcomes: np.ndarray, demanded: int) -> Float[np.ndarray, "t"]:
    """Average precision at each threshold (column) of estimates by falling score (rows)."""
    return np.array([average_precision(at[at != LEFT_OUT] == RIGHT, demanded) for at in outcomes.T])
