"""What the recorder is handed of an image: candidates per pixel at each stage, tables, particles.

Called only when something is recorded; paths are those of `pipeline.recording.entities`.
"""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Integer

from pipeline.hashmatch.config import TEMPLATE_SIZE
from pipeline.hashmatch.detector import Detector, LevelMatches, Matching
from pipeline.hashmatch.points_of_tests import points_of_tests
from pipeline.hashmatch.proposals import Instance
from pipeline.recording import StageRecorder
from pipeline.scene import PoseEstimate

STAGES = ("windows", "objectness", "hashing", "verification", "nms")

VOTES_SHOWN = 8
"""Templates of a window whose votes are recorded, the best ones."""

MOST_TESTED = 60
"""Detections whose points of the tests are recorded, besides those that became estimates; the best kept ones."""


def show_matching(detector: Detector, matching: Matching, recorder: StageRecorder) -> None:
    """Record heatmaps of the stages, summed and by level, the number of candidates, and the detections."""
    shape = matching.base.depth.shape
    sums: dict[str, np.ndarray] = {stage: np.zeros(shape, np.float32) for stage in STAGES}
    totals: dict[str, int] = dict.fromkeys(STAGES, 0)
    for matched in matching.levels:
        for stage, weights in _weights(detector, matching, matched).items():
            heat = window_heat(matched, weights, shape)
            sums[stage] += heat
            totals[stage] += int(weights.sum())
            recorder.heatmap(f"hashmatch/scales/{stage}/{matched.level.index}", heat, unit="candidates")
    for stage, heat in sums.items():
        recorder.heatmap(f"hashmatch/{stage}", heat, unit="candidates")
    recorder.text("log", "candidates: " + ", ".join(f"{stage} {count}" for stage, count in totals.items()))
    for stage, rows in (("verification", np.arange(len(matching.detections))), ("nms", matching.detections.kept)):
        recorder.table(f"hashmatch/candidates/{stage}", detection_columns(detector, matching, rows))
    recorder.table("hashmatch/candidates/hashing", _hashed_columns(detector, matching))
    used = np.unique(
        [(o, t) for o, t in zip(matching.detections.objects, matching.detections.templates, strict=True)], axis=0
    )
    recorder.table("hashmatch/templates", _template_columns(detector, used.reshape(-1, 2)))
    uncolored = [own.obj_id for own in detector.objects if not own.colored]
    if uncolored:
        recorder.text("log", f"objects without colour, for which test T5 is off: {', '.join(map(str, uncolored))}")


def show_tests(detector: Detector, matching: Matching, chosen: Sequence[Instance], recorder: StageRecorder) -> None:
    """Record the points of the tests T1 to T5 at some detections, named by their row among the verified candidates."""
    rows = {*matching.detections.kept[:MOST_TESTED].tolist(), *(one.row for one in chosen if one.rescan == 0)}
    for row in sorted(rows):
        recorder.table(f"hashmatch/tests/{row}", points_of_tests(detector, matching, row)._asdict())


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
    return {
        "pixels": found.centers[rows].astype(np.float32),
        "scale": found.scales[rows],
        "level": found.levels[rows],
        "object": np.array([detector.objects[i].obj_id for i in found.objects[rows]], int),
        "template": found.templates[rows],
        "votes": found.votes[rows],
        "fractions": found.fractions[rows],
        "score": found.ranking[rows],
        "suppressed_by": found.suppressed_by[rows],
    }


def window_heat(
    matched: LevelMatches, weights: Integer[np.ndarray, "n"], shape: tuple[int, ...]
) -> Float[np.ndarray, "h w"]:
    """Sum of the weights of the windows of a level that overlap each pixel of the image, by corner differences."""
    height, width = shape
    half = TEMPLATE_SIZE / 2 / matched.level.scale
    used = np.flatnonzero(weights)
    centers = matched.level.centers(matched.windows[used])
    size = np.array([width, height])
    x0, y0 = np.clip(np.rint(centers - half + 0.5), 0, size).astype(int).T
    x1, y1 = np.clip(np.rint(centers + half + 0.5), 0, size).astype(int).T
    corners = np.zeros((height + 1, width + 1))
    for y, x, sign in ((y0, x0, 1), (y0, x1, -1), (y1, x0, -1), (y1, x1, 1)):
        np.add.at(corners, (y, x), sign * weights[used])
    return corners.cumsum(axis=0).cumsum(axis=1)[:-1, :-1].astype(np.float32)


def _weights(detector: Detector, matching: Matching, matched: LevelMatches) -> dict[str, np.ndarray]:
    """Candidates (templates) of each window of a level after each stage."""
    count = len(matched.windows)
    everything = len(detector.tables.objects)
    foreground = np.zeros(count, np.int64)
    foreground[matched.foreground] = everything
    passed = matched.candidates.windows[matched.verified.failed == 0]
    found = matching.detections
    kept = found.kept[found.levels[found.kept] == matched.level.index]
    centers = matched.level.centers(matched.windows)
    nms = np.zeros(count, np.int64)
    for row in kept:
        nms[np.abs(centers - found.centers[row]).sum(axis=1).argmin()] += 1
    return {
        "windows": np.full(count, everything, np.int64),
        "objectness": foreground,
        "hashing": np.bincount(matched.candidates.windows, minlength=count),
        "verification": np.bincount(passed, minlength=count),
        "nms": nms,
    }


def _hashed_columns(detector: Detector, matching: Matching) -> dict[str, np.ndarray]:
    """A row per window that got candidates: how many, and the template with the most votes."""
    parts = []
    for matched in matching.levels:
        windows, first, counts = np.unique(matched.candidates.windows, return_index=True, return_counts=True)
        template = matched.candidates.templates[first]
        position = detector.tables.objects[template]
        ids = np.array([own.obj_id for own in detector.objects])
        parts.append({
            "pixels": matched.level.centers(matched.windows[windows]).astype(np.float32),
            "scale": np.full(len(windows), matched.level.scale),
            "level": np.full(len(windows), matched.level.index),
            "object": ids[position],
            "template": template - detector.tables.firsts[position],
            "votes": matched.candidates.votes[first],
            "count": counts,
            **_best_voted(detector, matched, first, counts, ids),
        })  # fmt: skip
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def _best_voted(
    detector: Detector, matched: LevelMatches, first: np.ndarray, counts: np.ndarray, ids: np.ndarray
) -> dict[str, np.ndarray]:
    """The templates with the most votes of each window, best first, padded with template -1."""
    at = first[:, None] + np.arange(VOTES_SHOWN)
    there = np.arange(VOTES_SHOWN) < counts[:, None]
    at = np.where(there, at, 0)
    templates = matched.candidates.templates[at] if len(at) else np.zeros((0, VOTES_SHOWN), int)
    position = detector.tables.objects[templates]
    votes = matched.candidates.votes[at] if len(at) else np.zeros((0, VOTES_SHOWN), int)
    return {
        "best_objects": np.where(there, ids[position], -1).astype(np.int32),
        "best_templates": np.where(there, templates - detector.tables.firsts[position], -1).astype(np.int32),
        "best_votes": np.where(there, votes, 0).astype(np.int16),
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


def _template_columns(detector: Detector, used: Integer[np.ndarray, "n 2"]) -> dict[str, np.ndarray]:
    """The templates that were detected; their pictures are rendered from the pose when they are looked at."""
    return {
        "object": np.array([detector.objects[o].obj_id for o, _ in used], int),
        "template": used[:, 1],
        "camera_from_model": np.array([detector.objects[o].pose(int(t)) for o, t in used]).reshape(-1, 4, 4),
    }
