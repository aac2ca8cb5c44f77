"""From views of an object to its templates.

Views come without in-plane rotation. A rotation about the optical axis turns a picture whose centre is the principal
point without changing depth, so the other templates are made by turning points and orientations.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float, Integer

from pipeline.exceptions import FormatError, InputError
from pipeline.hashmatch import channels
from pipeline.hashmatch.config import TEMPLATE_SIZE, HashMatchConfig
from pipeline.hashmatch.objectness import edgels
from pipeline.hashmatch.templates import PER_TEMPLATE, Templates, reference_points, size_points, stored_distances
from pipeline.hashmatch.view_points import gradient_points, normal_points
from pipeline.hashmatch.viewpoints import about_axis, in_plane_angles
from pipeline.hashmatch.views import CENTER, View, centroid_of, fitting_distance
from pipeline.scene import Model

_BEHIND = 4
"""Diameters from the object to the background before which the edgels of a template are counted."""


def templates_of_views(
    model: Model, views: Sequence[View], config: HashMatchConfig, focal_px: float, colored: bool
) -> Templates:
    """Templates of an object that show these views with all in-plane rotations, view after view."""
    distance = fitting_distance(model, focal_px)
    rows = [_templates_of_view(view, in_plane_angles(config), distance, config) for view in views]
    threshold = config.edgel_threshold * model.diameter
    background = np.float32(distance + _BEHIND * model.diameter)
    counts = [edgels(np.where(view.mask, view.depth, background), threshold).sum() for view in views]
    return Templates(
        obj_id=model.obj_id,
        diameter=model.diameter,
        distance=distance,
        focal_px=focal_px,
        centroid=centroid_of(model),
        edgels=int(min(counts)),
        colored=colored,
        **{name: np.concatenate([row[name] for row in rows]) for name in PER_TEMPLATE},
    )


def check_model(model: Model) -> None:
    """Refuse models that cannot be rendered, with an InputError."""
    if not len(model.faces):
        raise FormatError(f"object {model.obj_id}: its mesh has no faces; HashMatch renders it, export a triangle mesh")
    if not np.isfinite(model.vertices).all():
        raise FormatError(f"object {model.obj_id}: its mesh has vertices that are not finite; export it again")
    if not model.diameter > 0:
        raise InputError(f"object {model.obj_id}: its diameter is {model.diameter} m; correct models_info.json")


def turned(points: Integer[np.ndarray, "n 2"], rotation: Float[np.ndarray, "3 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (x, y) turned about the centre of the window, rounded and kept inside."""
    moved = np.rint((points - CENTER) @ rotation[:2, :2].T + CENTER).astype(int)
    return tuple(np.clip(moved, 0, TEMPLATE_SIZE - 1).T)


def _templates_of_view(
    view: View, angles: np.ndarray, distance: float, config: HashMatchConfig
) -> dict[str, np.ndarray]:
    """Arrays (one row per angle) of the templates that show a view turned."""
    margin = np.deg2rad(config.orientation_margin_deg)
    at_normals = normal_points(view.normals, config.points)
    magnitude, orientation = channels.gradient_orientations(view.rgb, config.template_gradient_threshold)
    at_gradients = gradient_points(magnitude, config.points)
    stored, hues = stored_distances(view.distance, distance), channels.hues(view.rgb)
    silhouette = np.argwhere(view.mask)[:, ::-1]
    rows: dict[str, list[Any]] = {name: [] for name in PER_TEMPLATE}
    for angle in angles:
        turn = about_axis(angle)
        own_normals = view.normals @ turn.T.astype(np.float32)
        grid_x, grid_y = turned(reference_points(config.grid), turn.T)
        rows["rotations"].append((turn @ view.rotation).astype(np.float32))
        rows["areas"].append(np.int32(len(silhouette)))
        outline = np.stack(turned(silhouette, turn), axis=-1) if len(silhouette) else np.zeros((1, 2), int)
        rows["boxes"].append(np.concatenate([outline.min(axis=0), outline.max(axis=0)]).astype(np.uint8))
        rows["nearest"].append(np.float32(_expected(view.distance, turn)))
        rows["grid_distances"].append(stored[grid_y, grid_x])
        rows["grid_normals"].append(channels.normal_bins(own_normals[grid_y, grid_x]))
        x, y = at_normals.T
        rows["normal_points"].append(_padded(np.stack(turned(at_normals, turn), axis=-1), config.points))
        rows["normal_bits"].append(_padded(channels.normal_bits(own_normals[y, x], margin), config.points))
        rows["point_distances"].append(_padded(stored[y, x], config.points))
        rows["point_hues"].append(_padded(hues[y, x], config.points))
        rows["normal_counts"].append(np.uint8(len(at_normals)))
        x, y = at_gradients.T
        bits = channels.gradient_bits(magnitude[y, x], (orientation[y, x] + np.float32(angle)) % np.pi, margin)
        rows["gradient_points"].append(_padded(np.stack(turned(at_gradients, turn), axis=-1), config.points))
        rows["gradient_bits"].append(_padded(bits, config.points))
        rows["gradient_counts"].append(np.uint8(len(at_gradients)))
    return {name: np.stack(values) for name, values in rows.items()}


def _expected(distance: np.ndarray, turn: np.ndarray) -> float:
    x, y = turned(size_points(), turn.T)
    there = distance[y, x]
    if not there.any():
        there = distance[distance > 0]
    return float(np.median(there[there > 0])) if there.any() else 0.0


def _padded(values: np.ndarray, length: int) -> np.ndarray:
    result = np.zeros((length, *values.shape[1:]), values.dtype if values.dtype != int else np.uint8)
    result[: len(values)] = values
    return result
