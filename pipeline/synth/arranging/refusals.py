"""What cannot be arranged, told in one line before anything is tried."""

from __future__ import annotations

import logging
from collections.abc import Sequence

import numpy as np

from pipeline.model_cache import per_model
from pipeline.scene import Model
from pipeline.synth.arranging.arrangement import EmptyStageError, NothingToArrangeError
from pipeline.synth.arranging.watertight import is_watertight
from pipeline.synth.worlds.world import Stage

log = logging.getLogger(__name__)

LEAST_DIAMETER, MOST_DIAMETER = 0.001, 3.0
"""Metres: what is outside is in the wrong unit."""
LEAST_AREA = 1e-4
"""Square metres of a stage."""


def refuse_bad_models(models: Sequence[Model]) -> None:
    """Raise `NothingToArrangeError` for no models and for those that are no body; warn of open meshes, once each."""
    if not models:
        raise NothingToArrangeError("no models to arrange; give at least one")
    for model in models:
        if not len(model.faces):
            raise NothingToArrangeError(f"object {model.obj_id}: no faces; give a mesh, not a cloud of points")
        if not np.isfinite(model.vertices).all():
            raise NothingToArrangeError(f"object {model.obj_id}: vertices that are not finite; mend its model file")
        if not LEAST_DIAMETER <= model.diameter <= MOST_DIAMETER:
            raise NothingToArrangeError(
                f"object {model.obj_id}: diameter {1000 * model.diameter:.3g} mm; model files are in millimetres: scale it"
            )
        _warn_of_open_mesh(model)


@per_model
def _warn_of_open_mesh(model: Model) -> bool:
    """Warn once per model."""
    closed = is_watertight(model)
    if not closed:
        log.warning("object %d: not watertight; its inside is where most of seven rays say so", model.obj_id)
    return True


def refuse_bad_stage(stage: Stage) -> None:
    """Raise `EmptyStageError` where the stage has no room at all."""
    polygon = stage.polygon
    if len(polygon) < 3 or not np.isfinite(polygon).all() or not stage.area >= LEAST_AREA or not stage.free_height > 0:
        area = stage.area if len(polygon) >= 3 else 0.0
        raise EmptyStageError(
            f"stage {stage.name}: {len(polygon)} corners, {1e6 * area:.0f} mm2 of area, {1000 * stage.free_height:.0f} mm "
            f"of free height; give a convex polygon of at least {1e6 * LEAST_AREA:.0f} mm2 with room above it"
        )
