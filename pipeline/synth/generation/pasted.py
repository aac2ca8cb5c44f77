"""Images of kind `pasted`: render & paste, the baseline (thesis sec. synth_experiments)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from pipeline.bop.dataset import open_dataset
from pipeline.scene import Camera
from pipeline.synth.generation.config import PastedScene
from pipeline.synth.generation.images import SyntheticImage
from pipeline.synth.generation.recipe import Recipe
from pipeline.synth.render_and_paste import RenderAndPaste

Poses = list[tuple[int, Float[np.ndarray, "4 4"]]]
"""Object ids and `camera_from_model`."""


class PastedSet:
    """Models ready to be drawn over pictures."""

    def __init__(self, recipe: Recipe[PastedScene]) -> None:
        """Load the models and the list of backgrounds. Raises InputError where there are none."""
        models = [recipe.library.model(obj_id) for obj_id in recipe.obj_ids]
        self._recipe = recipe
        self._models = {model.obj_id: model for model in models}
        self._painter = RenderAndPaste(models, recipe.camera, recipe.scene.settings)
        root = recipe.scene.poses_of
        self._imitated = None if root is None else open_dataset(root, recipe.scene.poses_split)

    def image(self, index: int) -> SyntheticImage:
        """Draw the image of that number."""
        made = self._painter.image(self._recipe.rng(index), *self._given(index))
        depth = self._recipe.sensor.measure(made.depth, made.camera.K, self._recipe.rng(index, 2))
        objects = [(self._models[truth.obj_id], truth.camera_from_model) for truth in made.ground_truth]
        return SyntheticImage(made.camera, made.rgb, depth, objects, made.rendering, made.seconds)

    def _given(self, index: int) -> tuple[Poses | None, Camera | None]:
        """Poses and camera of the image that is imitated, those of objects that have a model here."""
        if self._imitated is None:
            return None, None
        keys = list(self._imitated.images())
        key = keys[index % len(keys)]
        truths = self._imitated.ground_truth(key)
        poses = [(truth.obj_id, truth.camera_from_model) for truth in truths if truth.obj_id in self._models]
        return poses, replace(self._imitated.camera(key), world_from_camera=None)
