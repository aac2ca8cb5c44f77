"""How rerun's own viewer draws each kind of record."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pyarrow as pa
import rerun as rr
from jaxtyping import Float, Num, UInt8

from pipeline.recording import records
from pipeline.scene import GroundTruth, Model, PoseEstimate

PIXELS = "tf#/image"
"""The viewer's name for pixel coordinates of the camera logged at `image`; 2D entities elsewhere are put there."""

ENLARGED = "in_pixels"
"""Path below an entity for its drawing at the size of the image."""

MODEL_TINTS = {"estimates": (255, 130, 50, 150), "ground_truth": (70, 220, 120, 150)}
"""Colours of the models drawn at poses, by the path that the poses are logged below."""

DEFAULTS = (rr.ViewCoordinates.RDF, rr.AnnotationContext([(0, "none", (0, 0, 0, 0))]))
"""For the root: axes of the OpenCV camera frame, and class 0 of any segmentation is transparent."""

HIDDEN = rr.InstancePoses3D(translations=np.zeros((1, 3)), mat3x3=np.zeros((1, 3, 3)))
"""A mesh that is drawn nowhere."""

_GRADIENT = np.array([(68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)], np.float64)
_POINT_RADIUS_UI = 2.0
_POINT_RADIUS_M = 0.001
_AXIS_LENGTH_M = 0.05


@dataclass(frozen=True)
class Display:
    """What to log for one record so that the viewer shows it."""

    archetypes: tuple[Any, ...] = ()
    drawn: Mapping[str, str] = field(default_factory=dict)
    """Fields of the record whose exact bytes a component of these archetypes holds."""
    children: Mapping[str, tuple[Any, ...]] = field(default_factory=dict)
    """Archetypes for paths below the entity, which a reader of the record need not decode."""


@dataclass(frozen=True)
class Columns:
    """Arrow arrays as components of one archetype of ours."""

    archetype: str
    arrays: Mapping[str, pa.Array]

    def as_component_batches(self) -> list[rr.DescribedComponentBatch]:
        """What rerun asks of a thing that can be logged."""
        return [
            rr.DescribedComponentBatch(_Batch(array), rr.ComponentDescriptor(name, archetype=self.archetype))
            for name, array in self.arrays.items()
        ]


@dataclass(frozen=True)
class _Batch:
    array: pa.Array

    def as_arrow_array(self) -> pa.Array:
        return self.array


def display(record: records.Record) -> Display:
    """The drawing of a record."""
    return _DISPLAYS[type(record)](record)


def model_mesh(model: Model, tint: tuple[int, int, int, int]) -> rr.Mesh3D:
    """A model as the viewer draws it, in its own frame, metres."""
    normals = _vertex_normals(model) if model.normals is None else model.normals
    return rr.Mesh3D(
        vertex_positions=model.vertices,
        triangle_indices=model.faces,
        vertex_normals=normals,
        albedo_factor=tint,
    )


def model_instances(poses: Iterable[PoseEstimate | GroundTruth]) -> rr.InstancePoses3D:
    """Where one object's model is drawn."""
    transforms = np.stack([pose.camera_from_model for pose in poses])
    return rr.InstancePoses3D(translations=transforms[:, :3, 3], mat3x3=transforms[:, :3, :3])


def _vertex_normals(model: Model) -> Float[np.ndarray, "v 3"]:
    """Normals of the faces, averaged by area at each vertex."""
    a, b, c = (model.vertices[model.faces[:, corner]] for corner in range(3))
    normals = np.zeros_like(model.vertices)
    for corner in range(3):
        np.add.at(normals, model.faces[:, corner], np.cross(b - a, c - a))
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)


def _view(view: records.View) -> Display:
    if view.camera is None:
        return Display()
    pinhole = rr.Pinhole(image_from_camera=view.K, width=view.width, height=view.height, image_plane_distance=0.2)
    return Display((pinhole,))


def _image(image: records.ColorImage) -> Display:
    return Display((rr.Image(image.rgb),), {"rgb": "Image:buffer"}) if image.rgb.size else Display()


def _depth(depth: records.DepthMap) -> Display:
    if not depth.depth.size:
        return Display()
    return Display((rr.DepthImage(depth.depth, meter=1.0),), {"depth": "DepthImage:buffer"})


def _heatmap(heatmap: records.Heatmap) -> Display:
    if not heatmap.values.size:
        return Display()
    finite = heatmap.values[np.isfinite(heatmap.values)]
    span = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    image = rr.DepthImage(_enlarge(heatmap.values, heatmap.cell_px), colormap="inferno", depth_range=span)
    if heatmap.cell_px > 1:
        return Display(children={ENLARGED: (image, rr.CoordinateFrame(PIXELS))})
    return Display((image, rr.CoordinateFrame(PIXELS)), {"values": "DepthImage:buffer"})


def _mask(mask: records.Mask) -> Display:
    if not mask.mask.size:
        return Display()
    image = rr.SegmentationImage(np.ascontiguousarray(mask.mask).view(np.uint8), opacity=0.5)
    return Display((image, rr.CoordinateFrame(PIXELS)), {"mask": "SegmentationImage:buffer"})


def _probabilities(probabilities: records.Probabilities) -> Display:
    """The most probable class of each cell, counted from 1; 0 where nothing was computed."""
    if not probabilities.values.size:
        return Display()
    classes = np.zeros(probabilities.grid, np.uint16)
    columns, rows = probabilities.cells.T
    classes[rows, columns] = probabilities.values.argmax(axis=1) + 1
    image = rr.SegmentationImage(_enlarge(classes, probabilities.cell_px), opacity=0.6)
    return Display(children={ENLARGED: (image, rr.CoordinateFrame(PIXELS))})


def _correspondences(matches: records.Correspondences) -> Display:
    colors = _gradient(matches.confidence)
    points = rr.Points3D(matches.points_in_model, colors=colors, radii=_POINT_RADIUS_M)
    return Display((_points_2d(matches.pixels, colors), rr.CoordinateFrame(PIXELS)), children={"in_model": (points,)})


def _pose(pose: PoseEstimate | GroundTruth) -> Display:
    matrix = pose.camera_from_model
    axes = rr.Arrows3D(vectors=np.eye(3) * _AXIS_LENGTH_M, colors=np.eye(3, dtype=np.uint8) * 255)
    return Display((rr.Transform3D(translation=matrix[:3, 3], mat3x3=matrix[:3, :3]), axes))


def _hypotheses(hypotheses: records.Hypotheses) -> Display:
    origins = hypotheses.camera_from_model[:, :3, 3]
    return Display((rr.Points3D(origins, colors=_gradient(hypotheses.quality), radii=_POINT_RADIUS_M),))


def _series(series: records.Series) -> Display:
    return Display((rr.BarChart(series.values, abscissa=series.steps),)) if len(series.values) else Display()


def _text(text: records.Text) -> Display:
    return Display((rr.TextLog(text.text, level=text.level),))


def _table(table: records.Table) -> Display:
    columns = table.columns
    drawings: list[Any] = []
    if "pixels" in columns:
        drawings += [_points_2d(columns["pixels"], None), rr.CoordinateFrame(PIXELS)]
    if "points_in_camera" in columns:
        drawings.append(rr.Points3D(columns["points_in_camera"], radii=_POINT_RADIUS_M))
    return Display(tuple(drawings))


def _points_2d(pixels: Float[np.ndarray, "n 2"], colors: UInt8[np.ndarray, "n 3"] | None) -> rr.Points2D:
    return rr.Points2D(pixels, colors=colors, radii=rr.Radius.ui_points(_POINT_RADIUS_UI))


def _enlarge(values: Num[np.ndarray, "h w"], cell_px: int) -> Num[np.ndarray, "..."]:
    """Every cell as a square of equal pixels."""
    return values if cell_px == 1 else values.repeat(cell_px, axis=0).repeat(cell_px, axis=1)


def _gradient(values: Float[np.ndarray, "n"]) -> UInt8[np.ndarray, "n 3"]:
    """Colours from dark (least) to bright (largest); what is not finite is dark."""
    finite = np.where(np.isfinite(values), values, np.nan).astype(np.float64)
    low, high = (np.nanmin(finite), np.nanmax(finite)) if np.isfinite(finite).any() else (0.0, 1.0)
    position = np.nan_to_num((finite - low) / max(high - low, 1e-12)) * (len(_GRADIENT) - 1)
    channels = [np.interp(position, np.arange(len(_GRADIENT)), channel) for channel in _GRADIENT.T]
    return np.stack(channels, axis=-1).astype(np.uint8)


_DISPLAYS: dict[type, Callable[[Any], Display]] = {
    records.View: _view,
    records.ColorImage: _image,
    records.DepthMap: _depth,
    records.Heatmap: _heatmap,
    records.Mask: _mask,
    records.Probabilities: _probabilities,
    records.Correspondences: _correspondences,
    PoseEstimate: _pose,
    GroundTruth: _pose,
    records.Hypotheses: _hypotheses,
    records.Series: _series,
    records.Text: _text,
    records.Table: _table,
}
