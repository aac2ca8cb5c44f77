"""What becomes of every estimate and every annotated instance in 6D detection (see `pose_detection` for the rules)."""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import groupby
from operator import attrgetter

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from pipeline.bop.dataset import Dataset
from pipeline.bop.evaluation.columns import Columns
from pipeline.bop.evaluation.detection_targets import demanded_instances
from pipeline.bop.evaluation.matching import match_at
from pipeline.bop.evaluation.pair_errors import mspd_of_pairs, mssd_of_pairs
from pipeline.bop.evaluation.scores import MSPD_THETAS_PX, THETAS
from pipeline.bop.evaluation.target_errors import annotations_of_target, poses_of_rows
from pipeline.bop.results import Results
from pipeline.scene import Camera, GroundTruth, Target

THETAS_MM = np.arange(2.0, 21.0, 2.0)
"""Thresholds of correctness for MSSD as a length, millimetres (BOP Challenge 2025)."""

THRESHOLDS = {"mssd": THETAS, "mspd": MSPD_THETAS_PX, "mssd_mm": THETAS_MM}
"""By error: fractions of the diameter, pixels in an image 640 wide, millimetres."""

WRONG, RIGHT, LEFT_OUT = 0, 1, 2
"""Of an estimate; of an instance: missed, found, and one that does not have to be detected."""


@dataclass(frozen=True, eq=False)
class Outcomes:
    """Every estimate that counts and every annotated instance, a row each."""

    scene_id: Int[np.ndarray, "n"]
    im_id: Int[np.ndarray, "n"]
    obj_id: Int[np.ndarray, "n"]
    gt_index: Int[np.ndarray, "n"]
    """Index of the instance among the image's annotations; -1 in the row of an estimate."""
    row: Int[np.ndarray, "n"]
    """Row of the estimate in the results file; -1 in the row of an instance."""
    score: Float[np.ndarray, "n"]
    """Of the estimate; NaN in the row of an instance."""
    visible_fraction: Float[np.ndarray, "n"]
    """Of the instance; NaN where unknown and in the row of an estimate."""
    demanded: Bool[np.ndarray, "n"]
    """Whether it is an instance that has to be detected."""
    mssd: UInt8[np.ndarray, "n t"]
    """WRONG, RIGHT or LEFT_OUT at each of THRESHOLDS["mssd"]."""
    mspd: UInt8[np.ndarray, "n t"]
    mssd_mm: UInt8[np.ndarray, "n t"]

    def __len__(self) -> int:
        return len(self.obj_id)

    def of(self, rows: Bool[np.ndarray, "n"]) -> "Outcomes":
        """Some of the rows."""
        return Outcomes(**{field.name: getattr(self, field.name)[rows] for field in fields(self)})


def most_estimates(dataset: Dataset) -> int:
    """How many estimates of an image count at most, those of highest score."""
    return 200 if dataset.facts.name == "xyzibd" else 100


def detection_columns(dataset: Dataset, results: Results, targets: Sequence[Target]) -> Columns:
    """The fields of `Outcomes` for targets made by `detection_targets`, all of an image one after the other."""
    parts: list[Columns] = []
    for key, of_image in groupby(targets, attrgetter("image")):
        camera, annotations = dataset.camera(key), dataset.ground_truth(key)
        best = results.rows(key)[: most_estimates(dataset)]
        for target in of_image:
            instances = annotations_of_target(dataset, target, annotations)
            parts.append(_of_target(dataset, results, target, camera, best, instances))
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _of_target(
    dataset: Dataset,
    results: Results,
    target: Target,
    camera: Camera,
    best: Int[np.ndarray, "b"],
    instances: Sequence[GroundTruth],
) -> Columns:
    """Rows of the estimates for an object in an image, by falling score, and then of its instances."""
    rows = best[results.obj_id[best] == target.obj_id]
    demanded = demanded_instances(target, instances)
    e, g = len(rows), len(instances)
    fractions = [np.nan if gt.visible_fraction is None else gt.visible_fraction for gt in instances]
    ids = {name: np.full(e + g, getattr(target, name)) for name in ("scene_id", "im_id", "obj_id")}
    return ids | {
        "gt_index": np.append(np.full(e, -1), [gt.index for gt in instances]),
        "row": np.append(rows, np.full(g, -1)),
        "score": np.append(results.score[rows], np.full(g, np.nan)),
        "visible_fraction": np.append(np.full(e, np.nan), fractions),
        "demanded": np.append(np.zeros(e, bool), demanded),
        **_outcomes(dataset, target, camera, poses_of_rows(results, rows.tolist()), instances, demanded),
    }


def _outcomes(
    dataset: Dataset,
    target: Target,
    camera: Camera,
    estimates: Sequence[Float[np.ndarray, "4 4"]],
    instances: Sequence[GroundTruth],
    demanded: Bool[np.ndarray, "g"],
) -> Columns:
    """Outcomes by error, those of the estimates before those of the instances."""
    model, truths = dataset.model(target.obj_id), [gt.camera_from_model for gt in instances]
    distances = mssd_of_pairs(model, estimates, truths)
    errors = {
        "mssd": distances / model.diameter,
        "mspd": mspd_of_pairs(model, camera, estimates, truths),
        "mssd_mm": distances * 1000.0,
    }
    return {name: _at_thresholds(errors[name], thresholds, demanded) for name, thresholds in THRESHOLDS.items()}


def _at_thresholds(
    errors: Float[np.ndarray, "e g"], thresholds: Float[np.ndarray, "t"], demanded: Bool[np.ndarray, "g"]
) -> UInt8[np.ndarray, "n t"]:
    """Match, and say what becomes of each estimate and each instance at each threshold."""
    matched = match_at(errors, thresholds)
    of_estimates = np.where(matched < 0, WRONG, np.where(demanded[matched], RIGHT, LEFT_OUT))
    found = (matched == np.arange(len(demanded))[:, None, None]).any(axis=1)
    of_instances = np.where(demanded[:, None], np.where(found, RIGHT, WRONG), LEFT_OUT)
    return np.concatenate([of_estimates, of_instances]).astype(np.uint8)
