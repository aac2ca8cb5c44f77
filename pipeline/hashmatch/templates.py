"""Templates of an object: what matching needs of its views, in compact arrays (thesis sec. Object Detection).

Only the views without in-plane rotation are rendered. A rotation about the optical axis turns a picture whose centre is
the principal point without changing depth, so the other templates are made by turning points and orientations.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from jaxtyping import Float, Integer, UInt8

from pipeline.exceptions import FormatError, InputError
from pipeline.hashmatch import channels
from pipeline.hashmatch.config import TEMPLATE_SIZE, HashMatchConfig
from pipeline.hashmatch.objectness import edgels
from pipeline.hashmatch.view_points import gradient_points, normal_points
from pipeline.hashmatch.viewpoints import about_axis, in_plane_angles, view_rotations, without_symmetric
from pipeline.hashmatch.views import CENTER, View, centroid_of, fitting_distance, render_views
from pipeline.scene import Model

DISTANCE_UNIT = 1e-4
"""Metres; distances are stored as 16-bit multiples of it, relative to the distance of the centroid."""

NO_DISTANCE = np.int16(-32768)
"""Stored where there is no surface."""


@dataclass(frozen=True, eq=False)
class Templates:
    """t templates of an object, and what they have in common."""

    obj_id: int
    diameter: float
    """Metres."""
    distance: float
    """Metres; |t_t|, from the camera centre to the object's centroid, the same for all templates."""
    focal_px: float
    """Focal length with which they were rendered."""
    centroid: Float[np.ndarray, "3"]
    """Centre of the bounding box, model frame, metres."""
    edgels: int
    """Least number of depth edgels in a template, with the edgel threshold of this object."""
    colored: bool
    """Whether the model has colour; without, test T5 says nothing."""
    rotations: Float[np.ndarray, "t 3 3"]
    """R_t, camera from model, float32."""
    areas: Integer[np.ndarray, "t"]
    """a: pixels of the silhouette."""
    boxes: UInt8[np.ndarray, "t 4"]
    """x0, y0, x1, y1 of the silhouette in the window, pixels, x1 and y1 included."""
    nearest: Float[np.ndarray, "t"]
    """Metres, float32; middle of the distances of the surface at the five reference points of T1, else of all of it."""
    grid_distances: Integer[np.ndarray, "t g"]
    """Stored distances at the reference points, row by row."""
    grid_normals: UInt8[np.ndarray, "t g"]
    """Normal bins at the reference points."""
    normal_points: UInt8[np.ndarray, "t p 2"]
    """Pixels (x, y) of the tests T2, T4 and T5; the first `normal_counts` of each row."""
    normal_bits: UInt8[np.ndarray, "t p"]
    point_distances: Integer[np.ndarray, "t p"]
    """Stored distances."""
    point_hues: UInt8[np.ndarray, "t p"]
    normal_counts: UInt8[np.ndarray, "t"]
    gradient_points: UInt8[np.ndarray, "t p 2"]
    """Pixels (x, y) of test T3."""
    gradient_bits: UInt8[np.ndarray, "t p"]
    gradient_counts: UInt8[np.ndarray, "t"]

    def __len__(self) -> int:
        return len(self.rotations)

    def nbytes(self) -> int:
        """Memory of the arrays."""
        return sum(value.nbytes for value in vars(self).values() if isinstance(value, np.ndarray))

    def pose(self, template: int) -> Float[np.ndarray, "4 4"]:
        """P_t: camera_from_model with the centroid on the optical axis."""
        pose = np.eye(4)
        pose[:3, :3] = self.rotations[template]
        pose[:3, 3] = np.array([0, 0, self.distance]) - pose[:3, :3] @ self.centroid
        return pose


PER_TEMPLATE = tuple(field.name for field in fields(Templates) if field.name not in {
    "obj_id", "diameter", "distance", "focal_px", "centroid", "edgels", "colored"
})  # fmt: skip
"""Names of the arrays with a row per template."""


def learn_views(
    model: Model, rotations: Float[np.ndarray, "n 3 3"], config: HashMatchConfig, focal_px: float
) -> Templates:
    """Templates of some views of an object, with all their in-plane rotations."""
    distance = fitting_distance(model, focal_px)
    views = render_views(model, rotations, distance, focal_px)
    angles = in_plane_angles(config)
    rows = [
        _templates_of_view(view, rotation, angles, distance, config)
        for view, rotation in zip(views, rotations, strict=True)
    ]
    counts = [
        edgels(_on_far_background(view.depth, distance, model), config.edgel_threshold * model.diameter).sum()
        for view in views
    ]
    return Templates(
        obj_id=model.obj_id,
        diameter=model.diameter,
        distance=distance,
        focal_px=focal_px,
        centroid=centroid_of(model),
        edgels=int(min(counts)),
        colored=model.colors is not None or (model.texture is not None and model.texture_uv is not None),
        **{name: np.concatenate([row[name] for row in rows]) for name in PER_TEMPLATE},
    )


def learn(
    model: Model, config: HashMatchConfig, focal_px: float, progress: Callable[[float], None] = lambda _: None
) -> Templates:
    """All templates of an object. What `progress` (share done, 0..1) raises ends it. Raises InputError for bad models."""
    check_model(model)
    chunks = []
    parts = view_chunks(model, config)
    for done, rotations in enumerate(parts):
        progress(done / len(parts))
        chunks.append(learn_views(model, rotations, config, focal_px))
    progress(1.0)
    return joined(chunks)


def view_chunks(model: Model, config: HashMatchConfig, size: int = 36) -> list[Float[np.ndarray, "n 3 3"]]:
    """The views of an object in parts of a second's work."""
    rotations = view_rotations(config)
    if config.skip_symmetric_views:
        rotations = without_symmetric(rotations, model, config.angle_step_deg)
    return [rotations[i : i + size] for i in range(0, len(rotations), size)]


def joined(chunks: list[Templates]) -> Templates:
    """Templates of one object from those of its parts."""
    arrays = {name: np.concatenate([getattr(chunk, name) for chunk in chunks]) for name in PER_TEMPLATE}
    return replace(chunks[0], edgels=min(chunk.edgels for chunk in chunks), **arrays)


def check_model(model: Model) -> None:
    """Refuse models that cannot be rendered, with an InputError."""
    if not len(model.faces):
        raise FormatError(f"object {model.obj_id}: its mesh has no faces; HashMatch renders it, export a triangle mesh")
    if not np.isfinite(model.vertices).all():
        raise FormatError(f"object {model.obj_id}: its mesh has vertices that are not finite; export it again")
    if not model.diameter > 0:
        raise InputError(f"object {model.obj_id}: its diameter is {model.diameter} m; correct models_info.json")


def _templates_of_view(
    view: View, rotation: np.ndarray, angles: np.ndarray, distance: float, config: HashMatchConfig
) -> dict[str, np.ndarray]:
    """Arrays (one row per angle) of the templates that show a view turned."""
    margin = np.deg2rad(config.orientation_margin_deg)
    at_normals = normal_points(view.normals, config.points)
    magnitude, orientation = channels.gradient_orientations(view.rgb, config.template_gradient_threshold)
    at_gradients = gradient_points(magnitude, config.points)
    stored, hues = stored_distances(view.distance, distance), channels.hues(view.rgb)
    silhouette = np.argwhere(view.depth > 0)[:, ::-1]
    rows: dict[str, list[Any]] = {name: [] for name in PER_TEMPLATE}
    for angle in angles:
        turn = about_axis(angle)
        own_normals = view.normals @ turn.T.astype(np.float32)
        grid_x, grid_y = turned(reference_points(config.grid), turn.T)
        rows["rotations"].append((turn @ rotation).astype(np.float32))
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


def reference_points(grid: int) -> Integer[np.ndarray, "g 2"]:
    """Pixels (x, y) in the window of the grid of r x r reference points, row by row."""
    along = ((np.arange(grid) + 0.5) * (TEMPLATE_SIZE / grid)).astype(int)
    x, y = np.meshgrid(along, along)
    return np.stack([x.ravel(), y.ravel()], axis=-1)


def size_points() -> Integer[np.ndarray, "5 2"]:
    """Pixels (x, y) of test T1: the centres of the window and of its quadrants."""
    middle, low, high = TEMPLATE_SIZE // 2, TEMPLATE_SIZE // 4, TEMPLATE_SIZE * 3 // 4
    return np.array([(middle, middle), (low, low), (high, low), (low, high), (high, high)])


def turned(points: Integer[np.ndarray, "n 2"], rotation: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pixels (x, y) turned about the centre of the window, rounded and kept inside."""
    moved = np.rint((points - CENTER) @ rotation[:2, :2].T + CENTER).astype(int)
    return tuple(np.clip(moved, 0, TEMPLATE_SIZE - 1).T)


def stored_distances(distances: np.ndarray, centroid: float) -> Integer[np.ndarray, "*n"]:
    """Distances in metres as they are stored; 0 becomes NO_DISTANCE."""
    relative = np.rint((distances - centroid) / DISTANCE_UNIT)
    return np.where(distances > 0, np.clip(relative, -32767, 32767), NO_DISTANCE).astype(np.int16)


def _expected(distance: np.ndarray, turn: np.ndarray) -> float:
    x, y = turned(size_points(), turn.T)
    there = distance[y, x]
    if not there.any():
        there = distance[distance > 0]
    return float(np.median(there[there > 0])) if there.any() else 0.0


def _on_far_background(depth: np.ndarray, distance: float, model: Model) -> np.ndarray:
    return np.where(depth > 0, depth, np.float32(distance + 4 * model.diameter))


def _padded(values: np.ndarray, length: int) -> np.ndarray:
    result = np.zeros((length, *values.shape[1:]), values.dtype if values.dtype != int else np.uint8)
    result[: len(values)] = values
    return result
