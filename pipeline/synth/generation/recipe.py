"""All that the images of one BOP scene have in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

from pipeline.scene import Camera, Model
from pipeline.synth.generation.config import BoardScene, Count, PastedScene, TracedScene
from pipeline.synth.generation.library import ModelLibrary
from pipeline.synth.generation.objects import Distractors, chosen_ids, is_distractor
from pipeline.synth.sensors import DepthSensor

Scene = TypeVar("Scene", TracedScene, PastedScene, BoardScene)


@dataclass(frozen=True, eq=False)
class Recipe(Generic[Scene]):
    """What one scene is made from."""

    scene: Scene
    scene_id: int
    seed: int
    obj_ids: tuple[int, ...]
    library: ModelLibrary
    distractors: Distractors | None
    camera: Camera
    """Intrinsics."""
    sensor: DepthSensor

    def rng(self, *numbers: int) -> np.random.Generator:
        """A generator for one purpose, such as an image's noise: always the same one."""
        return np.random.default_rng([self.seed, self.scene_id, *numbers])

    def model(self, obj_id: int) -> Model:
        """An object or a distractor by its id."""
        if not is_distractor(obj_id):
            return self.library.model(obj_id)
        assert self.distractors is not None
        return self.distractors.model(obj_id)

    def chosen_models(self, count: Count | None, rng: np.random.Generator) -> list[Model]:
        """Draw models that are arranged together, those to be annotated first."""
        drawn = [self.library.model(obj_id) for obj_id in chosen_ids(self.obj_ids, count, rng)]
        return [*drawn, *(self.distractors.chosen(rng) if self.distractors else ())]
