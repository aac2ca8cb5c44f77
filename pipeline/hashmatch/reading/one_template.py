"""One template made again from the model, where the others are not at hand: for what a viewer asks about it."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float

from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.template_making import templates_of_views
from pipeline.hashmatch.templates import Templates
from pipeline.hashmatch.viewpoints import about_axis, in_plane_angles, view_rotations
from pipeline.hashmatch.views import fitting_distance, render_views
from pipeline.scene import Model

_SAME = 1e-3
"""Difference between entries of rotation matrices up to which they are the same."""


def one_template(
    model: Model, rotation: Float[np.ndarray, "3 3"], config: HashMatchConfig, focal_px: float, colored: bool
) -> tuple[Templates, int]:
    """Templates of the view that a template turns, and its row among them; of rendered templates exactly the learned ones.

    Templates taken from images are not rendered: for these it is what the model looks like at the same orientation.

    Args:
        model: Of the object, with its colours.
        rotation: R_t.
        config: With which templates were learned.
        focal_px: Of the templates.
        colored: Whether T5 is made.

    """
    view, row = _view_and_angle(rotation, config)
    if row is None:
        config, row = replace(config, in_plane="limited", in_plane_limit_deg=0), 0
    views = render_views(model, view[None], fitting_distance(model, focal_px), focal_px)
    return templates_of_views(model, views, config, focal_px, colored), row


def _view_and_angle(
    rotation: Float[np.ndarray, "3 3"], config: HashMatchConfig
) -> tuple[Float[np.ndarray, "3 3"], int | None]:
    """The view without in-plane rotation, and the number of the angle by which it was turned; None for no such view."""
    if config.templates is None:
        turned_back = np.array([about_axis(-angle) @ rotation for angle in in_plane_angles(config)])
        views = view_rotations(config)
        away = np.abs(views[:, None] - turned_back).max(axis=(2, 3))
        view, angle = np.unravel_index(away.argmin(), away.shape)
        if away[view, angle] < _SAME:
            return views[view], int(angle)
    return rotation, None
