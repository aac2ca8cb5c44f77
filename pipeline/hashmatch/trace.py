"""Why a ground-truth instance was found or lost: its templates and windows followed through the cascade."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from pipeline.bop.errors import mssd
from pipeline.exceptions import UnknownIdError
from pipeline.geometry import project
from pipeline.hashmatch.detector import Detector, Matching
from pipeline.hashmatch.following import Followed, follow, progress
from pipeline.hashmatch.proposals import Instance, rows_to_refine
from pipeline.hashmatch.verification import TESTS
from pipeline.scene import GroundTruth, Model

FOUND = 0.3
"""Share of the diameter (MSSD) within which a rough or refined pose is of the instance."""

_NUMBERS_OF_TESTS = (1, 2, 3, 4, 5)


@dataclass(frozen=True)
class Trace:
    """What became of a ground-truth instance."""

    obj_id: int
    gt_index: int
    stage: str
    """Where it was lost: "template", "pyramid", "objectness", "hashing", "verification", "suppression", "refinement",
    "selection", or "found"."""
    verdict: str
    """One sentence."""
    best: Followed | None
    """The followed template and window that came farthest."""
    followed: tuple[Followed, ...]
    edgels_needed: float
    """theta."""
    votes_needed: int
    matches_needed: float
    detections: int
    """Detections of the object whose rough pose is of this instance."""
    best_detection_error: float | None
    """MSSD of the best of them, as a share of the diameter."""
    best_rank: int | None
    """Their best rank among the detections of the object, from 1."""
    suppressed_by: int | None
    """Row of the detection that suppressed the best-ranked one; None where it was kept."""
    rough_error: float | None
    """MSSD over diameter of the proposed instance nearest to the ground truth, before refinement."""
    refined_error: float | None
    """The same after refinement."""
    rough_score: float | None
    refined_score: float | None
    chosen: bool
    """Whether it is among the estimates."""

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, strings and lists, for JSON."""
        return asdict(self)


def trace(
    detector: Detector,
    matching: Matching,
    gt: GroundTruth,
    model: Model,
    proposed: Sequence[Instance] = (),
    chosen: Sequence[Instance] = (),
) -> Trace:
    """Follow a ground-truth instance through a matching of its image.

    Args:
        detector: That made the matching.
        matching: Of the image that the ground truth is of.
        gt: The instance.
        model: Of its object, with its symmetries.
        proposed: Refined poses before the choice; without them the trace ends at non-maxima suppression.
        chosen: Those that became estimates.

    Raises:
        UnknownIdError: the detector has no templates of the object.

    """
    ids = [own.obj_id for own in detector.objects]
    if gt.obj_id not in ids:
        raise UnknownIdError("object", gt.obj_id, "the templates of this run", ids)
    position = ids.index(gt.obj_id)
    followed = follow(detector, matching, gt, model, position)
    best = max(followed, key=progress, default=None)
    found = _detections_of(detector, matching, gt, model, position)
    near = min(
        (instance for instance in proposed if instance.position == position),
        key=lambda instance: mssd(model, instance.pose, gt.camera_from_model).value,
        default=None,
    )
    nearest_rough = min(
        (instance for instance in proposed if instance.position == position),
        key=lambda instance: mssd(model, instance.rough, gt.camera_from_model).value,
        default=None,
    )
    is_chosen = any(i.position == position and _error(model, i.pose, gt) < FOUND for i in chosen)
    stage, verdict = _verdict(
        detector, matching, best, found, near, nearest_rough, gt, model, bool(proposed), is_chosen
    )
    return Trace(
        obj_id=gt.obj_id,
        gt_index=gt.index,
        stage=stage,
        verdict=verdict,
        best=best,
        followed=tuple(followed),
        edgels_needed=matching.edgels_needed,
        votes_needed=detector.config.votes_needed,
        matches_needed=detector.config.matches_needed,
        detections=found.count,
        best_detection_error=found.error,
        best_rank=found.rank,
        suppressed_by=found.suppressed_by,
        rough_error=None if near is None else _error(model, near.rough, gt),
        refined_error=None if near is None else _error(model, near.pose, gt),
        rough_score=None if near is None or near.swarm is None else near.swarm.start_score,
        refined_score=None if near is None else near.score,
        chosen=is_chosen,
    )


@dataclass(frozen=True)
class _Found:
    """Detections of an instance."""

    count: int
    error: float | None
    rank: int | None
    suppressed_by: int | None
    followed: bool = False
    """Whether refinement begins with some of them."""


def _error(model: Model, pose: np.ndarray, gt: GroundTruth) -> float:
    return mssd(model, pose, gt.camera_from_model).value / model.diameter


def _detections_of(detector: Detector, matching: Matching, gt: GroundTruth, model: Model, position: int) -> _Found:
    found = matching.detections
    rows = np.flatnonzero(found.objects == position)
    near = np.linalg.norm(found.centers[rows] - project(
        matching.base.image.camera.K, gt.camera_from_model[:3, :3] @ detector.objects[position].centroid
        + gt.camera_from_model[:3, 3]
    ), axis=1) < 60  # fmt: skip
    errors = {int(row): _error(model, detector.pose(matching, int(row), measured=True), gt) for row in rows[near]}
    good = [row for row in rows.tolist() if errors.get(row, np.inf) < FOUND]
    if not good:
        return _Found(0, min(errors.values(), default=None), None, None)
    by = int(found.suppressed_by[good[0]])
    rank = int(np.flatnonzero(rows == good[0])[0]) + 1
    begun = bool(np.isin(good, rows_to_refine(detector, matching, position)).any())
    return _Found(len(good), min(errors[row] for row in good), rank, None if by == good[0] else by, begun)


def _verdict(
    detector: Detector,
    matching: Matching,
    best: Followed | None,
    found: _Found,
    near: Instance | None,
    rough: Instance | None,
    gt: GroundTruth,
    model: Model,
    has_proposals: bool,
    is_chosen: bool,
) -> tuple[str, str]:
    """Where the instance was lost, and a sentence about it."""
    name = f"object {gt.obj_id}"
    if is_chosen:
        error = "" if near is None else f" (MSSD {_error(model, near.pose, gt):.2f} d)"
        return "found", f"{name} was found{error}."
    if found.count:
        return _lost_late(name, found, near, rough, gt, model, has_proposals, detector.config.refine)
    if best is None:
        return "pyramid", f"{name}: no level of the pyramid and window fit its distance and place."
    if best.angle_deg > 1.5 * detector.config.angle_step_deg:
        return "template", f"{name}: the nearest template is {best.angle_deg:.0f} degrees off; use all views."
    if not best.objectness:
        return (
            "objectness",
            f"{name}: its window holds {best.edgels} depth edgels, {matching.edgels_needed:.0f} are needed.",
        )
    if not best.size_possible:
        return "verification", f"{name}: test T1 (size) fails at its window: no measured distance fits the scale."
    if not best.kept:
        why = "no vote" if not best.votes else f"{best.votes} votes, rank {best.rank}"
        return "hashing", f"{name}: its template got {why} at its window; the first {detector.config.votes_kept} pass."
    failed = best.failed_test
    if failed in _NUMBERS_OF_TESTS:
        share = (
            "" if failed == 1 else f" ({best.fractions[failed - 2]:.2f} of {detector.config.matches_needed:.2f} needed)"
        )
        return "verification", f"{name}: its template failed test {TESTS[failed - 1]}{share}."
    return "verification", f"{name}: templates near it passed all tests, but only with poses too far off."


def _lost_late(
    name: str, found: _Found, near: Instance | None, rough: Instance | None, gt: GroundTruth, model: Model,
    has_proposals: bool, refines: bool,
) -> tuple[str, str]:  # fmt: skip
    """The verdict on an instance that was detected, but is not among the estimates."""
    if near is not None and _error(model, near.pose, gt) < FOUND:
        return "selection", f"{name} was found and refined, but other poses explained its pixels with a better score."
    if rough is not None and _error(model, rough.rough, gt) < FOUND:
        error = _error(model, rough.pose, gt)
        return "refinement", f"{name}: refinement moved its rough pose away (MSSD {error:.2f} d afterwards)."
    text = f"{found.count} detections are of it, the best one with rank {found.rank}"
    if has_proposals and refines and found.followed:
        return "selection", f"{name}: {text}; other poses fitted the depth image better before refinement."
    if has_proposals and refines:
        return "selection", f"{name}: {text}; with so many at its place none was refined."
    if found.suppressed_by is not None:
        text = f"its best detection has rank {found.rank} and was suppressed by detection {found.suppressed_by}"
        return "suppression", f"{name}: {text}."
    if has_proposals:
        return "selection", f"{name}: its best detection has rank {found.rank}, too low to be refined."
    return "suppression", f"{name} was detected {found.count} times; nothing was refined."
