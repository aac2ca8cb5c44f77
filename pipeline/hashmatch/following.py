"""The templates nearest to a ground-truth instance, followed through the cascade at the windows around it."""

from dataclasses import dataclass, replace

import numpy as np

from pipeline.geometry import project
from pipeline.hashmatch.detector import Detector, LevelMatches, Matching
from pipeline.hashmatch.poses import rotation_to_ray
from pipeline.hashmatch.verification import verify
from pipeline.hashmatch.voting import Candidates, vote
from pipeline.scene import GroundTruth, Model

TEMPLATES = 6
"""Nearest templates that are followed."""


@dataclass(frozen=True)
class Followed:
    """A template at a window, near the ground truth."""

    template: int
    """Row in the object's templates."""
    angle_deg: float
    """Between its orientation and that of the ground truth, up to symmetries."""
    level: int
    scale: float
    window: tuple[float, float]
    """(u_w, v_w), pixels."""
    edgels: int
    objectness: bool
    size_possible: bool
    """Whether some template of the object could pass T1 at the window."""
    votes: int
    rank: int
    """Among all templates of all objects at this window, from 1; 0 without votes."""
    kept: bool
    """Whether voting passes it on."""
    failed_test: int
    """First of T1 to T5 that fails, made whatever the voting says; 0 where all are passed."""
    fractions: tuple[float, float, float, float]
    """Matching share of points in T2 to T5."""


def follow(detector: Detector, matching: Matching, gt: GroundTruth, model: Model, position: int) -> list[Followed]:
    """The nearest templates at the windows and levels around the ground truth, the best window of each."""
    own, K = detector.objects[position], matching.base.image.camera.K
    centroid = gt.camera_from_model[:3, :3] @ own.centroid + gt.camera_from_model[:3, 3]
    center = project(K, centroid)
    orientations = rotation_to_ray(K, center).T @ gt.camera_from_model[:3, :3] @ model.symmetries[:, :3, :3]
    cosines = (own.rotations.reshape(-1, 9).astype(float) @ orientations.reshape(-1, 9).T).max(axis=1)
    nearest = np.argsort(-cosines, kind="stable")[:TEMPLATES]
    angles = np.rad2deg(np.arccos(np.clip((cosines[nearest] - 1) / 2, -1, 1)))
    wanted = float(np.linalg.norm(centroid)) / own.distance
    levels = sorted(matching.levels, key=lambda matched: abs(np.log(matched.scale / wanted)))[:2]
    levels = [
        matched
        for matched in levels
        if abs(np.log(matched.scale / wanted)) < 1.2 * np.log(detector.config.scale_factor)
    ]
    return [
        one
        for matched in levels
        for template, angle in zip(nearest, angles, strict=True)
        for one in [_at_level(detector, matched, center, position, int(template), float(angle))]
        if one is not None
    ]


def _at_level(
    detector: Detector, matched: LevelMatches, center: np.ndarray, position: int, template: int, angle: float
) -> Followed | None:
    """A template at the windows of a level around a point; the window at which it comes farthest."""
    config, first = detector.config, int(detector.tables.firsts[position])
    away = np.abs(matched.level.centers(matched.windows) - center).max(axis=1)
    rows = np.flatnonzero(away <= 1.5 * config.window_step_px / matched.level.scale)
    if not len(rows):
        return None
    windows = matched.windows[rows]
    everything = replace(config, votes_kept=len(detector.tables.objects), votes_needed=1)
    allowed = np.ones((len(rows), len(detector.objects)), bool)
    level = matched.level
    votes = vote(detector.tables, level.distance, level.normal_bins, windows, allowed, everything)
    each = Candidates(
        np.arange(len(rows)), np.full(len(rows), first + template, np.int32), np.zeros(len(rows), np.int16)
    )
    tested = verify(detector.points, level, windows, each, matched.scale, config, all_tests=True)
    place = {int(row): i for i, row in enumerate(matched.hashed)}
    found = []
    for i, row in enumerate(rows):
        its = np.flatnonzero(votes.windows == i)
        at = np.flatnonzero(votes.templates[its] == first + template)
        count = int(votes.votes[its[at[0]]]) if len(at) else 0
        passed_on = (matched.candidates.windows == row) & (matched.candidates.templates == first + template)
        found.append(Followed(
            template=template,
            angle_deg=angle,
            level=level.index,
            scale=level.scale,
            window=tuple(level.centers(matched.windows[[row]])[0].tolist()),
            edgels=int(matched.edgel_counts[row]),
            objectness=bool(row in matched.foreground),
            size_possible=bool(int(row) in place and matched.allowed[place[int(row)], position]),
            votes=count,
            rank=int(at[0]) + 1 if len(at) else 0,
            kept=bool(passed_on.any()),
            failed_test=int(tested.failed[i]),
            fractions=tuple(tested.fractions[i].astype(float).round(4).tolist()),
        ))  # fmt: skip
    return max(found, key=progress)


def progress(one: Followed) -> tuple[float, ...]:
    """How far a template came at a window."""
    test = 6 if one.failed_test == 0 else one.failed_test
    stage = (one.objectness, one.objectness and one.size_possible, one.kept, one.kept and one.failed_test == 0)
    return (*map(float, stage), float(test) if one.kept else 0.0, float(one.votes), sum(one.fractions))
