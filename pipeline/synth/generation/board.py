"""Images of kind `board`: objects on a turntable with a marker board (thesis sec. tless_acquisition_setup)."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.synth.arranging import arrange
from pipeline.synth.boards import BoardScene as Turntable
from pipeline.synth.boards import MarkerBoard, board_scene, framed_board, turntable_views
from pipeline.synth.generation.config import BoardLayout, BoardScene
from pipeline.synth.generation.images import SyntheticImage
from pipeline.synth.generation.recipe import Recipe
from pipeline.synth.generation.studio import Studio

LOOK_AT = (0.0, 0.0, 0.03)
"""Where cameras look, board frame: the middle of the objects, more or less."""


@dataclass(frozen=True, eq=False)
class Placed:
    """Where the objects are on the board."""

    obj_ids: tuple[int, ...]
    world_from_models: Float[np.ndarray, "n 4 4"]
    """Board frame, metres."""

    @staticmethod
    def from_json(content: dict[str, Any]) -> Placed:
        """What was written as JSON."""
        return Placed(tuple(content["obj_ids"]), np.array(content["world_from_models"], float).reshape(-1, 4, 4))


def board_of(layout: BoardLayout) -> MarkerBoard:
    """The board of a layout. Raises InputError for a layout that makes no board."""
    return framed_board(**asdict(layout))


def placed(recipe: Recipe[BoardScene]) -> Placed:
    """Arrange the objects in the free middle of the board, the same at all turns. Raises InputError."""
    rng = recipe.rng(0, 0)
    table = _turntable(recipe)
    models = recipe.chosen_models(recipe.scene.count, rng)
    result = arrange(table.world(), table.stage, models, recipe.scene.arranging, rng)
    return Placed(tuple(model.obj_id for model in result.models), np.stack(result.world_from_models))


class BoardSet:
    """The turntable at one of its turns."""

    def __init__(self, recipe: Recipe[BoardScene], index: int, plan: Placed) -> None:
        """Turn it to the azimuth of that position."""
        scene = recipe.scene
        views = turntable_views(scene.azimuths_deg[index : index + 1], scene.elevations_deg, scene.distance, LOOK_AT)
        world = _turntable(recipe).world(views[0].turn_deg)
        models = [recipe.model(obj_id) for obj_id in plan.obj_ids]
        self._studio = Studio(recipe, world, models, plan.world_from_models, index, material_number=0)
        self._views = views

    def image(self, index: int) -> SyntheticImage:
        """The view from the elevation of that position; its world is the board."""
        return self._studio.photograph(self._views[index].board_from_camera, index)


def _turntable(recipe: Recipe[BoardScene]) -> Turntable:
    seed = recipe.scene.seed
    return _scene(recipe.scene.board, recipe.seed + recipe.scene_id if seed is None else seed)


@lru_cache(maxsize=1)
def _scene(layout: BoardLayout, seed: int) -> Turntable:
    return board_scene(board_of(layout), seed)
