"""What became of the detections of a ground-truth instance: suppressed, refined, chosen or not."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Integer

from pipeline.bop.errors import mssd
from pipeline.geometry import project
from pipeline.hashmatch.detector import Detector, Matching
from pipeline.hashmatch.proposals import Instance, rows_to_refine
from pipeline.scene import GroundTruth, Model

FOUND = 0.3
"""Share of the diameter (MSSD) within which a rough or refined pose is of the instance."""

_BESIDE_PX = 60
"""Detections farther from the projected centroid are not looked at."""


@dataclass(frozen=True)
class Suppressor:
    """A detection that suppressed another one."""

    detection: int
    """Its row."""
    u: float
    """Centre of its window, pixels."""
    v: float
    score: float
    """r."""


@dataclass(frozen=True)
class DetectionsOf:
    """Detections whose rough poses are of the instance."""

    count: int = 0
    nearest_error: float | None = None
    """MSSD of the nearest of all detections beside it, as a share of the diameter."""
    best: int | None = None
    """Row of the best-ranked one."""
    rank: int | None = None
    """Of that one, among the detections of the object, from 1."""
    suppressed_by: Suppressor | None = None
    """What suppressed it; None where it was kept."""
    followed_up: bool = False
    """Whether some of them are among those that are compared with the depth image."""


@dataclass(frozen=True)
class RefinementOf:
    """What refinement made of the instance; errors are MSSD as a share of the diameter."""

    proposed: int = 0
    """Poses of the object that were refined."""
    rough_error: float | None = None
    """Of the refined pose that began nearest."""
    moved_error: float | None = None
    """Where refinement moved that one."""
    refined_error: float | None = None
    """Of the refined pose that is nearest in the end."""
    rough_score: float | None = None
    """Of that one, before and after its swarm."""
    refined_score: float | None = None
    chosen_error: float | None = None
    """Of the nearest estimate."""


def detections_of(detector: Detector, matching: Matching, gt: GroundTruth, model: Model, position: int) -> DetectionsOf:
    """Detections of an object (its position among the detector's) that are of this instance."""
    found = matching.detections
    rows = np.flatnonzero(found.objects == position)
    near = rows[_beside(detector, matching, gt, position, found.centers[rows])]
    errors = {int(row): error_of(model, detector.pose(matching, int(row), measured=True), gt) for row in near}
    good = [row for row in rows.tolist() if errors.get(row, np.inf) < FOUND]
    nearest = min(errors.values(), default=None)
    if not good:
        return DetectionsOf(nearest_error=nearest)
    by, (u, v) = int(found.suppressed_by[good[0]]), found.centers[found.suppressed_by[good[0]]].tolist()
    return DetectionsOf(
        count=len(good),
        nearest_error=nearest,
        best=good[0],
        rank=int(np.flatnonzero(rows == good[0])[0]) + 1,
        suppressed_by=None if by == good[0] else Suppressor(by, u, v, float(found.ranking[by])),
        followed_up=bool(np.isin(good, rows_to_refine(detector, matching, position)).any()),
    )


def refinement_of(
    proposed: Sequence[Instance], chosen: Sequence[Instance], gt: GroundTruth, model: Model, position: int
) -> RefinementOf:
    """What became of the poses that were refined, and of the estimates."""
    own = [one for one in proposed if one.position == position]
    estimates = [error_of(model, one.pose, gt) for one in chosen if one.position == position]
    if not own:
        return RefinementOf(chosen_error=min(estimates, default=None))
    begun = min(own, key=lambda one: error_of(model, one.rough, gt))
    ended = min(own, key=lambda one: error_of(model, one.pose, gt))
    return RefinementOf(
        proposed=len(own),
        rough_error=error_of(model, begun.rough, gt),
        moved_error=error_of(model, begun.pose, gt),
        refined_error=error_of(model, ended.pose, gt),
        rough_score=None if ended.swarm is None else float(ended.swarm.start_score),
        refined_score=float(ended.score),
        chosen_error=min(estimates, default=None),
    )


def error_of(model: Model, pose: Float[np.ndarray, "4 4"], gt: GroundTruth) -> float:
    """MSSD between a pose and the ground truth, as a share of the diameter."""
    return mssd(model, pose, gt.camera_from_model).value / model.diameter


def _beside(
    detector: Detector, matching: Matching, gt: GroundTruth, position: int, centers: Float[np.ndarray, "n 2"]
) -> Integer[np.ndarray, "k"]:
    """Rows of the window centres that are beside the projected centroid."""
    centroid = gt.camera_from_model[:3, :3] @ detector.objects[position].centroid + gt.camera_from_model[:3, 3]
    return np.flatnonzero(
        np.linalg.norm(centers - project(matching.base.image.camera.K, centroid), axis=1) < _BESIDE_PX
    )
