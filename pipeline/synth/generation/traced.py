"""Images of kind `traced`: objects arranged in a world, seen by sampled cameras, path traced (thesis ch. synthesis)."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.exceptions import InputError
from pipeline.synth.arranging import Arrangement, EmptyStageError, NoRestError, arrange
from pipeline.synth.cameras import CameraRanges, NoViewError, ViewChooser, ViewRules, ranges_of_dataset
from pipeline.synth.generation.config import TracedScene
from pipeline.synth.generation.images import SyntheticImage
from pipeline.synth.generation.objects import is_distractor
from pipeline.synth.generation.recipe import Recipe
from pipeline.synth.generation.studio import Studio
from pipeline.synth.worlds import World, build_world

TRIES = 6
"""Arrangements that are tried before giving up."""


@dataclass(frozen=True, eq=False)
class Arranged:
    """Where everything is in an arrangement, and the cameras that look at it; as JSON it is small."""

    world: str
    world_seed: int
    stage: str
    obj_ids: tuple[int, ...]
    """One per instance, those to be annotated first."""
    world_from_models: Float[np.ndarray, "n 4 4"]
    world_from_cameras: Float[np.ndarray, "m 4 4"]
    focus: tuple[int, ...]
    """Position of the instance that each camera points at."""

    @staticmethod
    def from_json(content: dict[str, Any]) -> Arranged:
        """What was written as JSON."""
        content["obj_ids"], content["focus"] = tuple(content["obj_ids"]), tuple(content["focus"])
        for name in ("world_from_models", "world_from_cameras"):
            content[name] = np.array(content[name], float).reshape(-1, 4, 4)
        return Arranged(**content)


def arranged(recipe: Recipe[TracedScene], index: int) -> Arranged:
    """Arrange objects and cameras; where an arrangement cannot be had or admits no cameras, another one is tried.

    Raises InputError after a bounded number of tries; the text names what failed in the last one.
    """
    failure: InputError | None = None
    for attempt in range(TRIES):
        try:
            return _attempt(recipe, index, attempt)
        except (EmptyStageError, NoRestError, NoViewError) as error:
            failure = error
    raise InputError(f"scene {recipe.scene_id}, arrangement {index}: tried {TRIES}; the last failed: {failure}")


def _attempt(recipe: Recipe[TracedScene], index: int, attempt: int) -> Arranged:
    scene, rng = recipe.scene, recipe.rng(index, attempt)
    name = str(rng.choice(scene.worlds))
    drawn_seed = int(rng.integers(2**31))
    world = _world(name, drawn_seed if scene.world_seed is None else scene.world_seed)
    stages = [world.stage(stage) for stage in scene.stages] or list(world.stages)
    stage = stages[int(rng.integers(len(stages)))]
    result = arrange(world, stage, recipe.chosen_models(scene.count, rng), scene.arranging, rng)
    annotated = sum(not is_distractor(model.obj_id) for model in result.models)  # they come first
    if not annotated:
        raise EmptyStageError(f"world {name}, stage {stage.name}: only distractors came to rest on it; arrange more")
    cameras, focus = _cameras(recipe, world, result, annotated, rng)
    obj_ids = tuple(model.obj_id for model in result.models)
    return Arranged(name, world.seed, stage.name, obj_ids, np.stack(result.world_from_models), cameras, focus)


def _cameras(
    recipe: Recipe[TracedScene],
    world: World,
    arrangement: Arrangement,
    focusable: int,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "m 4 4"], tuple[int, ...]]:
    """Poses of all cameras of the arrangement, and the object that each looks at."""
    rules = ViewRules(min_visible=recipe.scene.min_visible)
    chooser = ViewChooser(world, arrangement.models, arrangement.world_from_models, rules, focusable)
    views = [chooser.choose(recipe.camera, ranges, rng) for ranges in _ranges(recipe)]
    return np.stack([view.world_from_camera for view in views]), tuple(view.focus for view in views)


def _ranges(recipe: Recipe[TracedScene]) -> list[CameraRanges]:
    """Ranges of each image's camera."""
    scene, count = recipe.scene, recipe.scene.images
    ranges = scene.cameras
    if scene.cameras_of is not None:
        ranges = ranges_of_dataset(scene.cameras_of, roll_deg=scene.cameras.roll_deg)
    if not scene.around:
        return [ranges] * count
    low, high = ranges.azimuth_deg
    edges = np.linspace(low, high, count + 1).tolist()
    return [replace(ranges, azimuth_deg=(edges[k], edges[k + 1])) for k in range(count)]


class TracedSet:
    """An arrangement, ready to be photographed."""

    def __init__(self, recipe: Recipe[TracedScene], index: int, plan: Arranged) -> None:
        """Build the world again with the objects in it, as the plan has them."""
        self._plan = plan
        models = [recipe.model(obj_id) for obj_id in plan.obj_ids]
        world = _world(plan.world, plan.world_seed)
        self._studio = Studio(recipe, world, models, plan.world_from_models, index)
        self._has_world = recipe.scene.arrangements == 1

    def image(self, index: int) -> SyntheticImage:
        """Take one of the pictures; cameras have world poses where the whole scene shows one world."""
        image = self._studio.photograph(self._plan.world_from_cameras[index], index)
        return image if self._has_world else replace(image, camera=replace(image.camera, world_from_camera=None))


_world = lru_cache(maxsize=2)(build_world)
