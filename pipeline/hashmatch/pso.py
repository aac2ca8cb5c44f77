"""Refinement of poses by particle swarms (thesis sec. Refinement by Particle Swarm Optimization; Poli et al. 2007).

Many swarms are moved together, so that one batch of rays renders the particles of all of them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Integer

from pipeline.hashmatch.fit import DepthFit

INERTIA = 0.7298
ATTRACTION = 1.4962
"""Towards the best that a particle and its swarm have seen; with the inertia the usual constricted swarm."""


@dataclass(frozen=True)
class Spread:
    """Standard deviations of the first particles about the start."""

    rotation: float = 0.16
    """Radians, about each axis: templates are 10 degrees apart, in three angles."""
    sideways: float = 0.006
    """Metres, across the viewing ray."""
    along: float = 0.008
    """Metres, along the optical axis."""


@dataclass(frozen=True, eq=False)
class Swarm:
    """What the search from one start came to."""

    pose: Float[np.ndarray, "4 4"]
    """camera_from_model, metres."""
    score: float
    start_score: float
    particles: Float[np.ndarray, "n 4 4"]
    """Every pose looked at, step after step; empty unless asked for."""
    scores: Float[np.ndarray, "n"]
    steps: Integer[np.ndarray, "n"]
    best_scores: Float[np.ndarray, "i"]
    """Of the swarm after each step."""


def swarms(
    fit: DepthFit,
    starts: Float[np.ndarray, "s 4 4"],
    particles: int,
    iterations: int,
    seed: Sequence[int] | int,
    spread: Spread | None = None,
    keep_particles: bool = False,
) -> list[Swarm]:
    """Refine poses, each by a swarm of its own. The same seed gives the same swarms.

    Args:
        fit: Scores poses.
        starts: camera_from_model, metres.
        particles: Per swarm; the first one begins at the start itself.
        iterations: Steps.
        seed: Of the random numbers.
        spread: Where the particles begin.
        keep_particles: Hand back all poses looked at.

    """
    spread = spread or Spread()
    count = len(starts)
    if not count:
        return []
    rng = np.random.default_rng(seed)
    sigma = np.array([spread.rotation] * 3 + [spread.sideways] * 2 + [spread.along])
    positions = rng.normal(size=(count, particles, 6)) * sigma
    positions[:, 0] = 0
    velocities = rng.normal(size=positions.shape) * sigma / 2
    centroid = (fit.model.vertices.min(axis=0) + fit.model.vertices.max(axis=0)) / 2
    centers = starts[:, :3, :3] @ centroid + starts[:, :3, 3]
    boxes = [fit.box(center, 0.55 * fit.model.diameter) for center in centers for _ in range(particles)]
    own_best, own_score = positions.copy(), np.full((count, particles), -1.0)
    history, start_scores = [], np.zeros(count)
    seen: list[tuple[np.ndarray, np.ndarray]] = []
    best = positions[:, :1]
    for step in range(iterations + 1):
        poses = _poses(starts, centers, positions)
        scores = fit.scores(poses.reshape(-1, 4, 4), boxes).reshape(count, particles)
        if keep_particles:
            seen.append((poses, scores))
        if step == 0:
            start_scores = scores[:, 0].copy()
        better = scores > own_score
        own_best[better], own_score[better] = positions[better], scores[better]
        leader = own_score.argmax(axis=1)
        history.append(own_score.max(axis=1))
        best = own_best[np.arange(count), leader][:, None]
        pull, follow = rng.random((2, *positions.shape)) * ATTRACTION
        velocities = INERTIA * velocities + pull * (own_best - positions) + follow * (best - positions)
        velocities = np.clip(velocities, -2 * sigma, 2 * sigma)
        positions = positions + velocities
    found = _poses(starts, centers, best)[:, 0]
    return [
        Swarm(found[i], float(history[-1][i]), float(start_scores[i]), *_kept(seen, i), np.array(history)[:, i])
        for i in range(count)
    ]


def _poses(starts: np.ndarray, centers: np.ndarray, positions: np.ndarray) -> Float[np.ndarray, "s p 4 4"]:
    """Turn each start about the object's centroid by a rotation vector, and move it."""
    from scipy.spatial.transform import Rotation

    turns = Rotation.from_rotvec(positions[..., :3].reshape(-1, 3)).as_matrix().reshape(*positions.shape[:2], 3, 3)
    poses = np.tile(np.eye(4), (*positions.shape[:2], 1, 1))
    poses[..., :3, :3] = turns @ starts[:, None, :3, :3]
    offsets = starts[:, :3, 3] - centers
    poses[..., :3, 3] = np.einsum("spij,sj->spi", turns, offsets) + centers[:, None] + positions[..., 3:]
    return poses


def _kept(seen: list[tuple[np.ndarray, np.ndarray]], swarm: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    if not seen:
        return np.zeros((0, 4, 4)), np.zeros(0), np.zeros(0, int)
    poses = np.concatenate([poses[swarm] for poses, _ in seen])
    scores = np.concatenate([scores[swarm] for _, scores in seen])
    return poses, scores, np.repeat(np.arange(len(seen)), len(seen[0][1][swarm]))
