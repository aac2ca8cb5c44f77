"""Arrange objects on a stage, and check that what comes of it can be."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from pipeline.geometry import transform_points
from pipeline.scene import Model
from pipeline.synth.arranging.arrangement import Arrangement, EmptyStageError, Falling, NoRestError, Soundness, Standing
from pipeline.synth.arranging.convex_pieces import extremes
from pipeline.synth.arranging.falling import drift, fall, stage_poses
from pipeline.synth.arranging.interpenetration import deepest_overlap
from pipeline.synth.arranging.refusals import refuse_bad_models, refuse_bad_stage
from pipeline.synth.arranging.standing import stand
from pipeline.synth.worlds.world import Stage, World


def arrange(
    world: World, stage: Stage, models: Sequence[Model], how: Falling | Standing, rng: np.random.Generator
) -> Arrangement:
    """Objects of the models on the stage, sound as `check` has it; the same generator state gives the same.

    Raises `NothingToArrangeError` for an empty list or a model without a body, `EmptyStageError` where the stage is
    no polygon or nothing came to rest on it, `NoRestError` where every try moved on or left objects overlapping.
    """
    refuse_bad_models(models)
    refuse_bad_stage(stage)
    wanted = [model for model in models for _ in range(int(rng.integers(how.instances[0], how.instances[1] + 1)))]
    if not wanted:
        raise EmptyStageError(f"stage {stage.name}: instances {how.instances} give no object; ask for at least one")
    faults: Counter[str] = Counter()
    for _ in range(how.tries):
        arrangement, fault = _attempt(world, stage, wanted, how, rng)
        if fault is None:
            return arrangement
        faults[fault] += 1
    raise _failure(stage, wanted, faults)


def _attempt(
    world: World, stage: Stage, models: Sequence[Model], how: Falling | Standing, rng: np.random.Generator
) -> tuple[Arrangement, str | None]:
    """One try, and what is wrong with it."""
    if isinstance(how, Falling):
        poses, on, at_rest = fall(world, stage, models, how, rng)
    else:
        poses, on = stand(world, stage, models, how, rng)
        at_rest = True
    world_from_models = stage.world_from_stage @ poses
    left_off = tuple(model.obj_id for k, model in enumerate(models) if k not in on)
    chosen = tuple(models[k] for k in on), tuple(world_from_models[k] for k in on)
    arrangement = Arrangement(stage, *chosen, left_off, isinstance(how, Falling))
    if not on:
        return arrangement, NOTHING
    if not at_rest:
        return arrangement, "objects still moved at the end of the time"
    faults = check(world, arrangement).faults
    return arrangement, faults[0] if faults else None


NOTHING = "nothing rested on the stage"


def check(world: World, arrangement: Arrangement) -> Soundness:
    """Measure what must not be: interpenetration of the true meshes, points below the stage, motion."""
    objects = list(zip(arrangement.models, arrangement.world_from_models, strict=True))
    overlap = deepest_overlap(world, objects)
    poses = stage_poses(arrangement.stage, arrangement.world_from_models)
    lowest = min((_lowest(*item) for item in zip(arrangement.models, poses, strict=True)), default=0.0)
    speed = drift(world, arrangement.stage, arrangement.models, poses) if arrangement.fallen else None
    return Soundness(overlap.depth, overlap.between, lowest, speed)


def _lowest(model: Model, stage_from_model: Float[np.ndarray, "4 4"]) -> float:
    return float(transform_points(stage_from_model, extremes(model))[:, 2].min())


def _failure(stage: Stage, models: Sequence[Model], faults: Counter[str]) -> Exception:
    """The error that tells what went wrong most."""
    tried = f"{len(models)} objects, {faults.total()} tries"
    fault, times = faults.most_common(1)[0]
    size = " x ".join(f"{1000 * side:.0f}" for side in np.ptp(stage.polygon, axis=0))
    if fault == NOTHING:
        largest = max(models, key=lambda model: model.diameter)
        return EmptyStageError(
            f"stage {stage.name} ({size} mm): nothing came to rest on it ({tried}; the largest, object "
            f"{largest.obj_id}, measures {1000 * largest.diameter:.0f} mm); choose a larger stage or smaller objects"
        )
    return NoRestError(
        f"stage {stage.name} ({size} mm): no arrangement is sound ({tried}; {times} times: {fault}); "
        "ask for fewer objects or a larger stage"
    )
