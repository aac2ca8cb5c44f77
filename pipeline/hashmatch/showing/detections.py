"""Detections, the points of their tests, refined poses, and the particles that led to them."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Integer

from pipeline.hashmatch.detector import Detector, Matching
from pipeline.hashmatch.points_of_tests import points_of_tests
from pipeline.hashmatch.proposals import Instance
from pipeline.recording import StageRecorder
from pipeline.scene import PoseEstimate

MOST_SHOWN = 50_000
"""Detections that are recorded besides those that are kept; the best ones, among which are all that suppressed them."""

MOST_TESTED = 60
"""Detections whose points of the tests are recorded, besides those that became estimates; the best kept ones."""


def show_detections(detector: Detector, matching: Matching, recorder: StageRecorder) -> None:
    """Record the candidates that passed all tests, best first, and those that non-maxima suppression keeps."""
    kept = matching.detections.kept
    best = np.arange(min(len(matching.detections), MOST_SHOWN))
    recorder.table("hashmatch/candidates/verification", detection_columns(detector, matching, best))
    columns = {**detection_columns(detector, matching, kept), "row": kept.astype(np.int32)}
    recorder.table("hashmatch/candidates/nms", columns)


def show_tests(detector: Detector, matching: Matching, chosen: Sequence[Instance], recorder: StageRecorder) -> None:
    """Record the points of the tests T1 to T5 at some detections, named by their row among the verified candidates."""
    rows = {*matching.detections.kept[:MOST_TESTED].tolist(), *(one.row for one in chosen if one.rescan == 0)}
    for row in sorted(rows):
        points = points_of_tests(detector, matching, row)
        recorder.table(f"hashmatch/tests/{row}", {
            "test": points.test.astype(np.uint8),
            "pixels": points.pixels.astype(np.float32),
            "template_pixels": points.template_pixels.astype(np.uint8),
            "matched": points.matched,
            "masked": points.masked,
        })  # fmt: skip


def show_refinement(
    detector: Detector, proposed: Sequence[Instance], chosen: Sequence[Instance], estimates: Sequence[PoseEstimate],
    recorder: StageRecorder,
) -> None:  # fmt: skip
    """Record all refined poses; rough poses, particles and scores of the instances that became estimates."""
    recorder.table("hashmatch/candidates/refined", _refined_columns(detector, proposed, chosen))
    for number, (instance, estimate) in enumerate(zip(chosen, estimates, strict=True)):
        ids = (estimate.scene_id, estimate.im_id, estimate.obj_id)
        recorder.log(f"hashmatch/rough/{number}", PoseEstimate(*ids, instance.score, instance.rough))
        swarm = instance.swarm
        if swarm is not None:
            path = f"hashmatch/pso/{number}"
            recorder.hypotheses(path, estimate.obj_id, swarm.particles, swarm.scores, steps=swarm.steps)
            recorder.scalars(f"hashmatch/pso_score/{number}", swarm.best_scores)
    recorder.text("log", f"{len(proposed)} poses were refined, {len(chosen)} are estimates")


def detection_columns(detector: Detector, matching: Matching, rows: Integer[np.ndarray, "n"]) -> dict[str, np.ndarray]:
    """A table of detections: window, object, template, votes, score of each, and which one suppressed it."""
    found = matching.detections
    ids = np.array([own.obj_id for own in detector.objects], np.int32)
    return {
        "pixels": found.centers[rows].astype(np.float32),
        "scale": found.scales[rows].astype(np.float32),
        "level": found.levels[rows].astype(np.int8),
        "object": ids[found.objects[rows]],
        "template": found.templates[rows].astype(np.int32),
        "votes": found.votes[rows].astype(np.int16),
        "fractions": found.fractions[rows].astype(np.float32),
        "score": found.ranking[rows].astype(np.float32),
        "shift": found.shifts[rows].astype(np.float32),
        "box": found.boxes[rows].astype(np.float32),
        "suppressed_by": found.suppressed_by[rows].astype(np.int32),
    }


def _refined_columns(
    detector: Detector, proposed: Sequence[Instance], chosen: Sequence[Instance]
) -> dict[str, np.ndarray]:
    """A row per refined pose: the detection that it came from, both poses, and which estimate it became (-1: none)."""
    place = {id(one): number for number, one in enumerate(chosen)}
    return {
        "object": np.array([detector.objects[one.position].obj_id for one in proposed], int),
        "candidate": np.array([one.row for one in proposed], int),
        "rescan": np.array([one.rescan for one in proposed], int),
        "rough": np.array([one.rough for one in proposed]).reshape(-1, 4, 4),
        "camera_from_model": np.array([one.pose for one in proposed]).reshape(-1, 4, 4),
        "score": np.array([one.score for one in proposed], float),
        "pixels_explained": np.array([len(one.pixels) for one in proposed], int),
        "share_explained": np.array([one.evidence.share for one in proposed], float),
        "net": np.array([one.evidence.net for one in proposed], float),
        "instance": np.array([place.get(id(one), -1) for one in proposed], int),
    }
