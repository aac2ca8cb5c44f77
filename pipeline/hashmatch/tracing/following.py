"""The templates nearest to a ground-truth instance, followed through the cascade at the windows around it."""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Integer

from pipeline.geometry import project
from pipeline.hashmatch.detector import Detector, LevelMatches, Matching
from pipeline.hashmatch.poses import rotation_to_ray
from pipeline.hashmatch.templates import size_points
from pipeline.hashmatch.verification import Verified, verify
from pipeline.hashmatch.voting import Candidates, vote
from pipeline.scene import GroundTruth, Model

TEMPLATES = 6
"""Nearest templates that are followed."""

LEVELS = 2
"""Nearest levels of the pyramid at which they are."""


class SizeTest(NamedTuple):
    """Test T1 at a window, metres."""

    nearest: float
    """Measured distances that pass."""
    farthest: float
    measured: float
    """Of the five points, the one that is nearest to what is expected; 0 where nothing is measured."""

    @property
    def passed(self) -> bool:
        """Whether the size fits."""
        return self.measured > 0 and self.nearest <= self.measured <= self.farthest


@dataclass(frozen=True)
class Followed:
    """A template at a window, near the ground truth."""

    template: int
    """Row in the object's templates."""
    quaternion_xyzw: tuple[float, float, float, float]
    """R_t: its orientation, camera from model."""
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
    size: SizeTest


def follow(detector: Detector, matching: Matching, gt: GroundTruth, model: Model, position: int) -> list[Followed]:
    """The nearest templates at the windows and levels around the ground truth, the best window of each."""
    own, K = detector.objects[position], matching.base.image.camera.K
    centroid = gt.camera_from_model[:3, :3] @ own.centroid + gt.camera_from_model[:3, 3]
    center = project(K, centroid)
    nearest, angles = _nearest_templates(
        own.rotations, rotation_to_ray(K, center).T @ gt.camera_from_model[:3, :3], model
    )
    wanted = float(np.linalg.norm(centroid)) / own.distance
    levels = sorted(matching.levels, key=lambda matched: abs(np.log(matched.scale / wanted)))[:LEVELS]
    reach = 1.2 * np.log(detector.config.scale_factor)
    found = []
    for matched in levels:
        if abs(np.log(matched.scale / wanted)) < reach:
            found += _at_level(detector, matched, center, position, nearest, angles)
    return found


def progress(one: Followed) -> tuple[float, ...]:
    """How far a template came at a window."""
    test = 6 if one.failed_test == 0 else one.failed_test
    stage = (one.objectness, one.objectness and one.size_possible, one.kept, one.kept and one.failed_test == 0)
    return (*map(float, stage), float(test) if one.kept else 0.0, float(one.votes), sum(one.fractions))


def _nearest_templates(
    rotations: Float[np.ndarray, "t 3 3"], seen: Float[np.ndarray, "3 3"], model: Model
) -> tuple[Integer[np.ndarray, "n"], Float[np.ndarray, "n"]]:
    """Rows of the templates whose orientations are nearest to one that is seen, and how far they are, degrees."""
    orientations = seen @ model.symmetries[:, :3, :3]
    cosines = (rotations.reshape(-1, 9).astype(float) @ orientations.reshape(-1, 9).T).max(axis=1)
    nearest = np.argsort(-cosines, kind="stable")[:TEMPLATES]
    return nearest, np.rad2deg(np.arccos(np.clip((cosines[nearest] - 1) / 2, -1, 1)))


def _at_level(
    detector: Detector, matched: LevelMatches, center: np.ndarray, position: int, templates: np.ndarray,
    angles: np.ndarray,
) -> list[Followed]:  # fmt: skip
    """Templates at the windows of a level around a point; of each the window at which it comes farthest."""
    config, level, first = detector.config, matched.level, int(detector.tables.firsts[position])
    away = np.abs(level.centers(matched.windows) - center).max(axis=1)
    rows = np.flatnonzero(away <= 1.5 * config.window_step_px / level.scale)
    if not len(rows):
        return []
    windows, count = matched.windows[rows], len(templates)
    everything = replace(config, votes_kept=len(detector.tables.objects), votes_needed=1)
    allowed = np.ones((len(rows), len(detector.objects)), bool)
    votes = vote(detector.tables, level.distance, level.normal_bins, windows, allowed, everything)
    each = Candidates(
        np.repeat(np.arange(len(rows)), count),
        np.tile(first + templates, len(rows)).astype(np.int32),
        np.zeros(count * len(rows), np.int16),
    )
    tested = verify(detector.points, level, windows, each, matched.scale, config, all_tests=True)
    at = _Around(detector, matched, position, rows, votes, tested)
    return [
        max((at.followed(i, k * count + i, k, first, templates, angles) for k in range(len(rows))), key=progress)
        for i in range(count)
    ]


@dataclass(frozen=True, eq=False)
class _Around:
    """What the stages say about the windows around a ground truth at one level."""

    detector: Detector
    matched: LevelMatches
    position: int
    rows: Integer[np.ndarray, "w"]
    """Of the windows."""
    votes: Candidates
    """All that have any."""
    tested: Verified

    def followed(self, i: int, test: int, k: int, first: int, templates: np.ndarray, angles: np.ndarray) -> Followed:
        """The i-th template at the k-th window."""
        matched, number, row = self.matched, first + int(templates[i]), self.rows[k]
        its = slice(*np.searchsorted(self.votes.windows, (k, k + 1)))
        at = np.flatnonzero(self.votes.templates[its] == number)
        passed_on = slice(*np.searchsorted(matched.candidates.windows, (row, row + 1)))
        hashed = np.flatnonzero(matched.hashed == row)
        fractions = self.tested.fractions[test].astype(float).round(4).tolist()
        center = matched.level.centers(matched.windows[[row]])[0]
        return Followed(
            template=int(templates[i]),
            quaternion_xyzw=_quaternion(self.detector.objects[self.position].rotations[templates[i]]),
            angle_deg=float(angles[i]),
            level=matched.level.index,
            scale=matched.level.scale,
            window=(float(center[0]), float(center[1])),
            edgels=int(matched.edgel_counts[row]),
            objectness=bool((matched.foreground == row).any()),
            size_possible=bool(len(hashed) and matched.allowed[hashed[0], self.position]),
            votes=int(self.votes.votes[its][at[0]]) if len(at) else 0,
            rank=int(at[0]) + 1 if len(at) else 0,
            kept=bool((matched.candidates.templates[passed_on] == number).any()),
            failed_test=int(self.tested.failed[test]),
            fractions=(fractions[0], fractions[1], fractions[2], fractions[3]),
            size=self._size(number, matched.windows[row]),
        )

    def _size(self, number: int, corner: Integer[np.ndarray, "2"]) -> SizeTest:
        factor = float(np.sqrt(self.detector.config.scale_factor))
        slope, constant = self.detector.points.expected[number]
        expected = float(self.matched.scale * slope + constant)
        x, y = (size_points() + corner).T
        there = self.matched.level.distance[y, x]
        there = there[there > 0]
        measured = float(there[np.abs(np.log(there / expected)).argmin()]) if len(there) and expected > 0 else 0.0
        return SizeTest(expected / factor, expected * factor, measured)


def _quaternion(rotation: Float[np.ndarray, "3 3"]) -> tuple[float, float, float, float]:
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(rotation).as_quat().tolist()
    return x, y, z, w
