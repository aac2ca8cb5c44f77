"""Objects that fall onto a stage until they are at rest (thesis sec. synth_composition)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.geometry import inverse, transform, transform_points
from pipeline.scene import Model
from pipeline.synth.arranging.arrangement import MAX_OVERLAP, REST_SPEED, Falling
from pipeline.synth.arranging.convex_pieces import extremes, pieces_of
from pipeline.synth.arranging.simulation import Simulation, Wall
from pipeline.synth.worlds.world import Stage, World

WAVES = 10
"""Objects that find no room above the others wait until those have come down, so many times at most."""
PLACES = 25
"""Places that are tried for an object in a wave."""
CHUNK = 0.1
"""Seconds between two looks at the bodies."""
CALM = 0.25
"""Metres per second: slower than this, a wave makes way for the next."""
LONGEST = 7.0
"""Seconds of simulated time in which bodies must come to rest."""
STILL = 4
"""Chunks in a row in which nothing moves: rest."""


class Fallen(NamedTuple):
    """Where objects lie after their fall."""

    poses: Float[np.ndarray, "n 4 4"]
    """Stage from model."""
    resting: list[int]
    """Positions, in the list of models, of those that rest on the stage."""
    at_rest: bool
    """False where something still moved at the end of the time."""


def fall(world: World, stage: Stage, models: Sequence[Model], how: Falling, rng: np.random.Generator) -> Fallen:
    """Let objects fall; those that leave the stage are taken away, and what leant on them falls on."""
    area = _area(stage, how.spread, rng)
    walls = _walls(area) if how.kept_in and _inner_radius(area) > max(map(_radius, models)) / 2 else []
    simulation = Simulation([pieces_of(model) for model in models], world.hulls_near(stage), walls)
    _rain(simulation, area, models, how, rng)
    at_rest = True
    if walls:
        at_rest = _settle(simulation, models, CALM / 10, 1)
        simulation.drop_walls()
    at_rest = at_rest and _come_to_rest(simulation, stage, models)
    return Fallen(simulation.poses(), [int(k) for k in np.flatnonzero(simulation.placed)], at_rest)


def _rain(simulation: Simulation, area: Stage, models: Sequence[Model], how: Falling, rng: np.random.Generator) -> None:
    """Let all objects go, in waves if there is no room for all at once."""
    waiting = [int(index) for index in rng.permutation(len(models))]
    for _ in range(WAVES):
        waiting = _start(simulation, area, models, waiting, how, rng)
        if not waiting or not simulation.placed.any():  # above an empty stage waiting does not help
            return
        _settle(simulation, models, CALM, 1)


def _come_to_rest(simulation: Simulation, stage: Stage, models: Sequence[Model]) -> bool:
    """Until all that is there is at rest on the stage; False if it takes too long."""
    while _settle(simulation, models, 0.6 * REST_SPEED, STILL):
        poses = simulation.poses()
        on = [int(k) for k in np.flatnonzero(simulation.placed)]
        off = [k for k in on if not rests_on(stage, models[k], poses[k])]
        if not off:
            return True
        for index in off:
            simulation.park(index)
    return False


def drift(world: World, stage: Stage, models: Sequence[Model], poses: Float[np.ndarray, "n 4 4"]) -> float:
    """Metres that the fastest point of objects goes within a second from poses in which they are at rest."""
    simulation = Simulation([pieces_of(model) for model in models], world.hulls_near(stage))
    for index, pose in enumerate(poses):
        simulation.place(index, pose)
    before = simulation.poses()
    simulation.run(1.0)
    return float(simulation.displacements(before, simulation.poses()).max(initial=0.0))


def rests_on(stage: Stage, model: Model, stage_from_model: Float[np.ndarray, "4 4"]) -> bool:
    """Whether an object at rest lies on the stage: its middle above the polygon, all of it up to the free height above."""
    points = transform_points(stage_from_model, extremes(model))
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    low, high = float(points[:, 2].min()), float(points[:, 2].max())
    return bool(stage.contains(middle[:2])) and low > -MAX_OVERLAP / 2 and high < stage.free_height + 0.002


def _settle(simulation: Simulation, models: Sequence[Model], speed: float, still: int) -> bool:
    """Simulate until nothing has been faster than `speed` for some chunks; False if it takes too long.

    What falls off the stage is taken away at once: it would roll on for long.
    """
    gone = np.array([0.02 + float(np.abs(model.vertices).max()) for model in models])
    calm, before = 0, simulation.poses()
    for _ in range(round(LONGEST / CHUNK)):
        simulation.run(CHUNK)
        after = simulation.poses()
        for index in np.flatnonzero(simulation.placed & (after[:, 2, 3] < -gone)):
            simulation.park(int(index))
        calm = calm + 1 if simulation.displacements(before, after).max(initial=0.0) < speed * CHUNK else 0
        if calm >= still:
            return True
        before = simulation.poses()
    return False


def _start(
    simulation: Simulation,
    stage: Stage,
    models: Sequence[Model],
    waiting: Sequence[int],
    how: Falling,
    rng: np.random.Generator,
) -> list[int]:
    """Put objects above the stage, free of each other; those that found no room are given back."""
    left = []
    for index in waiting:
        for _ in range(PLACES):
            simulation.place(index, _start_pose(stage, models[index], how, rng))
            if not simulation.touched(index):
                break
        else:
            simulation.park(index)
            left.append(index)
    return left


def _start_pose(stage: Stage, model: Model, how: Falling, rng: np.random.Generator) -> Float[np.ndarray, "4 4"]:
    """Above the stage, within its border if the object is small enough."""
    upright = how.orientation == "canonical"
    turn = Rotation.from_euler("z", rng.uniform(0, 2 * np.pi)) if upright else Rotation.random(rng=rng)
    points = turn.apply(extremes(model))
    low, high = points.min(axis=0), points.max(axis=0)
    margin = min(float((high - low)[:2].max()) / 2, 0.95 * _inner_radius(stage))
    at = stage.sample(rng, 1, margin)[0] - (low + high)[:2] / 2
    return transform(turn.as_matrix(), np.array([*at, rng.uniform(*how.heights) - low[2]]))


def _area(stage: Stage, spread: float | None, rng: np.random.Generator) -> Stage:
    """A smaller copy of the stage somewhere on it, `spread` metres across."""
    if spread is None or spread >= np.ptp(stage.polygon, axis=0).max():
        return stage
    fixed = stage.sample(rng, 1)[0]  # scaled about a point of its own, a convex polygon stays within itself
    return replace(stage, polygon=fixed + spread / np.ptp(stage.polygon, axis=0).max() * (stage.polygon - fixed))


def _radius(model: Model) -> float:
    return float(np.linalg.norm(np.ptp(model.vertices, axis=0))) / 2


def _inner_radius(stage: Stage) -> float:
    """Distance from the polygon's centre to its nearest side."""
    return min(float((stage.polygon.mean(axis=0) - point) @ normal) for point, normal in _walls(stage))


def _walls(stage: Stage) -> list[Wall]:
    """The sides of the polygon with their inward normals."""
    ahead = np.roll(stage.polygon, -1, axis=0) - stage.polygon
    inward = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1) / np.linalg.norm(ahead, axis=1, keepdims=True)
    return list(zip(stage.polygon, inward, strict=True))


def stage_poses(stage: Stage, world_from_models: Sequence[Float[np.ndarray, "4 4"]]) -> Float[np.ndarray, "n 4 4"]:
    """Stage from model, of poses in the world."""
    return inverse(stage.world_from_stage) @ np.array(world_from_models).reshape(-1, 4, 4)
