"""Photographs of objects in a world: colour by path tracing, depth as measured, exact geometry of both."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Float

from pipeline.scene import Model
from pipeline.synth.cameras import render_view
from pipeline.synth.generation.config import BoardScene, TracedScene
from pipeline.synth.generation.images import SyntheticImage
from pipeline.synth.generation.objects import is_distractor, materials_of
from pipeline.synth.generation.recipe import Recipe
from pipeline.synth.tracing.path_tracer import PathTracer
from pipeline.synth.worlds import World

STAGES: tuple[str, ...] = ("geometry", "colour", "sensor")
"""Of one picture, as its times are told."""


class Studio:
    """A world with objects in it, of which any number of pictures is taken."""

    def __init__(
        self,
        recipe: Recipe[TracedScene] | Recipe[BoardScene],
        world: World,
        models: Sequence[Model],
        world_from_models: Float[np.ndarray, "n 4 4"],
        number: int,
        material_number: int | None = None,
    ) -> None:
        """Set the objects up; those to be annotated come first.

        `number` is that of the set in its scene. Sets that show the same objects have the same `material_number`.
        """
        self._recipe, self._world, self._number = recipe, world, number
        self._models, self._poses = list(models), list(world_from_models)
        self._annotated = sum(not is_distractor(model.obj_id) for model in models)
        rng = recipe.rng(number if material_number is None else material_number, 3)
        materials = materials_of(self._models, recipe.scene.materials, rng)
        self._tracer = PathTracer(world, list(zip(self._models, materials, self._poses, strict=True)))

    def photograph(self, world_from_camera: Float[np.ndarray, "4 4"], index: int) -> SyntheticImage:
        """Take the picture of that number from a camera; the same one whenever it is asked for."""
        recipe, scene = self._recipe, self._recipe.scene
        times = [time.perf_counter()]
        camera = replace(recipe.camera, world_from_camera=world_from_camera)
        view = render_view(self._world, self._models, self._poses, camera, focus=0)
        times.append(time.perf_counter())
        seed = int(recipe.rng(self._number, index, 1).integers(2**31))
        rgb = self._tracer.render(view.camera, view.camera_from_world, scene.quality, seed, scene.photo)
        times.append(time.perf_counter())
        depth = recipe.sensor.measure(view.rendering.depth, view.camera.K, recipe.rng(self._number, index, 2))
        times.append(time.perf_counter())
        seconds = dict(zip(STAGES, np.diff(times).tolist(), strict=True))
        objects = list(zip(self._models, view.camera_from_models, strict=True))[: self._annotated]
        return SyntheticImage(view.camera, rgb, depth, objects, view.rendering, seconds)
