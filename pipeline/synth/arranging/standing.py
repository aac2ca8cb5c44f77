"""Objects that stand upright side by side, densely, by collision checks (thesis sec. synth_bop20, as for LM)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.geometry import transform, transform_points
from pipeline.scene import Model
from pipeline.synth.arranging.arrangement import Standing
from pipeline.synth.arranging.convex_pieces import extremes, pieces_of
from pipeline.synth.arranging.simulation import Simulation
from pipeline.synth.worlds.world import Stage, World

PLACES = 60
"""Places and turns that are tried for an object."""
ENOUGH = 6
"""Free places among them that are compared."""
HALVINGS = 6
"""Of the way on which an object is pushed towards the others."""
LIFT = 0.0001
"""Metres that statics may stand out of the stage: what is higher is in the way."""


def stand(
    world: World, stage: Stage, models: Sequence[Model], how: Standing, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "n 4 4"], list[int]]:
    """Stage from model of each object, and the positions in the list of those that found room."""
    statics = [hull for hull in world.hulls_near(stage) if hull[:, 2].max() > LIFT]
    simulation = Simulation([pieces_of(model) for model in models], statics, margin=max(how.gap) + 1e-5)
    poses, found = np.tile(np.eye(4), (len(models), 1, 1)), []
    middle = (stage.polygon.mean(axis=0) + stage.sample(rng, 1)[0]) / 2
    for index in (int(k) for k in rng.permutation(len(models))):
        place = _Place(simulation, stage, models[index], index, float(rng.uniform(*how.gap)))
        pose = place.nearest_to(middle, rng)
        if pose is None:
            simulation.park(index)
            continue
        simulation.place(index, pose)
        poses[index] = pose
        found.append(index)
    return poses, sorted(found)


@dataclass(frozen=True, eq=False)
class _Place:
    """The search for a place of one object."""

    simulation: Simulation
    stage: Stage
    model: Model
    index: int
    gap: float
    """Metres."""

    def nearest_to(self, middle: Float[np.ndarray, " 2"], rng: np.random.Generator) -> Float[np.ndarray, "4 4"] | None:
        """Of some free places, pushed towards the middle of all objects, the nearest to it; None where none is free."""
        best, nearest, seen = None, np.inf, 0
        for at in self.stage.sample(rng, PLACES):
            turn = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi)).as_matrix()
            if seen < ENOUGH and self._is_free(turn, at):
                seen += 1
                at = self._pushed(turn, at, middle)
                if np.linalg.norm(at - middle) < nearest:
                    best, nearest = self._pose(turn, at), float(np.linalg.norm(at - middle))
        return best

    def _pushed(
        self, turn: Float[np.ndarray, "3 3"], at: Float[np.ndarray, " 2"], middle: Float[np.ndarray, " 2"]
    ) -> Float[np.ndarray, " 2"]:
        """As far towards the middle as the object stays free."""
        share, step = 0.0, 1.0
        for _ in range(HALVINGS):
            if self._is_free(turn, at + (share + step) * (middle - at)):
                share += step
            if share >= 1.0:
                break
            step /= 2
        return at + share * (middle - at)

    def _is_free(self, turn: Float[np.ndarray, "3 3"], at: Float[np.ndarray, " 2"]) -> bool:
        """Whether the object stands wholly on the stage, with its gap about it."""
        pose = self._pose(turn, at)
        points = transform_points(pose, extremes(self.model))
        if not self.stage.contains(points[:, :2]).all() or points[:, 2].max() > self.stage.free_height:
            return False
        self.simulation.place(self.index, pose)
        return not self.simulation.touched(self.index, self.gap)

    def _pose(self, turn: Float[np.ndarray, "3 3"], at: Float[np.ndarray, " 2"]) -> Float[np.ndarray, "4 4"]:
        """Upright, the lowest point on the stage, the middle of the box about it above a point."""
        points = extremes(self.model) @ turn.T
        low, high = points.min(axis=0), points.max(axis=0)
        return transform(turn, np.array([*(at - (low + high)[:2] / 2), -low[2]]))
