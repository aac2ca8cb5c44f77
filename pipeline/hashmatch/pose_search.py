"""The search for poses of an object in a depth image from rough ones: alignment, then particle swarms."""

import numpy as np
from jaxtyping import Bool, Float, Integer

from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.fit import DepthFit, depth_fit, step_for
from pipeline.hashmatch.polish import polished
from pipeline.hashmatch.pso import Spread, Swarm, swarms
from pipeline.hashmatch.pyramid import Base
from pipeline.ray_casting import Box
from pipeline.scene import Model

_NARROW = Spread(rotation=0.06, sideways=0.0025, along=0.003)
"""Of the swarms that go on from where the short ones came to."""

DENSE = 2
"""Every how many-th pixel the last steps of refinement use."""

_TWINS = 0.15
"""Share of the diameter within which two poses count as one."""

_PER_PLACE = 2
"""Poses at one place that are followed, at most: an object that is found well must not hide the others of its kind."""


class PoseSearch:
    """The stages of the search for the poses of one object."""

    def __init__(
        self, config: HashMatchConfig, model: Model, base: Base, taken: Bool[np.ndarray, "h w"] | None,
        starts: Float[np.ndarray, "n 4 4"], count: int, rescan: int,
    ) -> None:  # fmt: skip
        self.config, self.model, self.base, self.taken, self.count = config, model, base, taken, count
        nearest = max(float(np.median(starts[:, 2, 3])), model.diameter)
        pixels = (1.1 * model.diameter * base.focal_px / nearest) ** 2
        self.seed = (config.seed, *base.image.key, model.obj_id, rescan)
        self.apart = _TWINS * model.diameter
        self.coarse = self.fit(step_for(pixels, config.rays // 2), 2.0)
        self.fine = self.fit(step_for(pixels, config.rays), 1.0)

    def fit(self, step: int, tolerance: float) -> DepthFit:
        """The objective at every `step`-th pixel, with so many times the tolerance of the config."""
        return depth_fit(self.model, self.base, step, tolerance * self.config.depth_tolerance_m, self.taken)

    def by_alignment(self, poses: Float[np.ndarray, "n 4 4"]) -> tuple[Integer[np.ndarray, "k"], np.ndarray]:
        """Score all poses, draw the best to the measured surface: rows of the best of these, and where they came to."""
        scores = self.coarse.scores(poses, boxes_of(self.coarse, poses))
        drawn = distinct(poses, scores, self.config.drawn_per_instance * self.count, self.apart / 2, 4 * _PER_PLACE)
        moved, scores = polished(self.coarse, poses[drawn], boxes_of(self.coarse, poses[drawn]), steps=4)
        kept = distinct(moved, scores, self.config.redrawn_per_instance * self.count, self.apart / 2, 2 * _PER_PLACE)
        return drawn[kept], moved[kept]

    def by_fine_alignment(self, poses: Float[np.ndarray, "n 4 4"]) -> tuple[Integer[np.ndarray, "k"], np.ndarray]:
        """Rows of the poses that fit best when drawn to the surface more finely, and where they came to."""
        moved, scores = polished(self.fine, poses, boxes_of(self.fine, poses), steps=5)
        kept = distinct(moved, scores, self.config.swarms_per_instance * self.count, self.apart, _PER_PLACE)
        return kept, moved[kept]

    def by_swarms(self, poses: Float[np.ndarray, "n 4 4"], keep_particles: bool) -> tuple[list[Swarm], np.ndarray]:
        """Whole swarms, and where they came to after the last steps, at nearly all pixels."""
        config = self.config
        found = swarms(self.fine, poses, config.particles, config.iterations, (*self.seed, 2), _NARROW, keep_particles)
        moved = np.array([swarm.pose for swarm in found])
        moved, _ = polished(self.fine, moved, boxes_of(self.fine, moved))
        for tolerance in (0.5, 0.25):
            dense = self.fit(DENSE, tolerance)
            moved, _ = polished(dense, moved, boxes_of(dense, moved), endless=0.0)
        return found, moved


def boxes_of(fit: DepthFit, poses: Float[np.ndarray, "n 4 4"]) -> list[Box]:
    """The pixels that see each pose's object."""
    centroid = (fit.model.vertices.min(axis=0) + fit.model.vertices.max(axis=0)) / 2
    return [fit.box(pose[:3, :3] @ centroid + pose[:3, 3], 0.55 * fit.model.diameter) for pose in poses]


def distinct(
    poses: Float[np.ndarray, "n 4 4"], scores: Float[np.ndarray, "n"], count: int, apart: float, per_place: int
) -> Integer[np.ndarray, "k"]:
    """The poses with the best scores, at different places.

    Of those that are nearer than `apart` (metres) only the best one counts, and of those whose origins are nearer than
    twice that only the best `per_place`.
    """
    points = np.vstack([np.zeros(3), 0.05 * np.eye(3)])  # the origin, and 5 cm along the axes
    placed = np.einsum("nij,kj->nki", poses[:, :3, :3], points) + poses[:, None, :3, 3]
    kept: list[int] = []
    for i in np.argsort(-scores, kind="stable"):
        if len(kept) == count:
            break
        distances = np.linalg.norm(placed[kept] - placed[i], axis=2)
        if not kept or (distances.max(axis=1).min() > apart and (distances[:, 0] < 2 * apart).sum() < per_place):
            kept.append(int(i))
    return np.array(kept, int)
