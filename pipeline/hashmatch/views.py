"""Views of a model from which templates are learned: what one is, and how it is rendered."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, UInt8

from pipeline.hashmatch import channels
from pipeline.hashmatch.config import TEMPLATE_SIZE
from pipeline.rendering import render_depths
from pipeline.scene import Camera, Model

CENTER = (TEMPLATE_SIZE - 1) / 2
"""Pixels; the principal point of a template and the centre of a window relative to its first pixel."""

_MARGIN_PX = 2.0


@dataclass(frozen=True, eq=False)
class View:
    """An object at the distance of its templates, TEMPLATE_SIZE pixels square; outside the object all is 0."""

    rotation: Float[np.ndarray, "3 3"]
    """Camera from model; the centroid is on the optical axis."""
    mask: Bool[np.ndarray, "w w"]
    """Silhouette; it may have pixels without depth."""
    depth: Float[np.ndarray, "w w"]
    distance: Float[np.ndarray, "w w"]
    normals: Float[np.ndarray, "w w 3"]
    rgb: UInt8[np.ndarray, "w w 3"]


def template_camera(focal_px: float) -> Camera:
    """The camera of the templates: square, its principal point in the middle."""
    K = np.array([[focal_px, 0, CENTER], [0, focal_px, CENTER], [0, 0, 1]])
    return Camera(K, TEMPLATE_SIZE, TEMPLATE_SIZE)


def centroid_of(model: Model) -> Float[np.ndarray, "3"]:
    """Centre of the model's bounding box (thesis: the object centroid)."""
    return (model.vertices.min(axis=0) + model.vertices.max(axis=0)) / 2


def fitting_distance(model: Model, focal_px: float) -> float:
    """Distance of the centroid at which a sphere about it that holds the model just fits the template."""
    radius = float(np.linalg.norm(model.vertices - centroid_of(model), axis=1).max())
    return radius * float(np.hypot(1, focal_px / (TEMPLATE_SIZE / 2 - _MARGIN_PX)))


def render_views(model: Model, rotations: Float[np.ndarray, "n 3 3"], distance: float, focal_px: float) -> list[View]:
    """Render views of a model at a distance of its centroid."""
    from pipeline.shading import shade

    camera, centroid = template_camera(focal_px), centroid_of(model)
    poses = np.tile(np.eye(4), (len(rotations), 1, 1))
    poses[:, :3, :3] = rotations
    poses[:, :3, 3] = np.array([0, 0, distance]) - rotations @ centroid
    views = []
    for pose, rendering in zip(poses, render_depths(model, camera, poses, pixel_center=0.0), strict=True):
        depth = rendering.depth
        rgb = shade(model, camera, pose, 0.0).rgb
        distances, normals = channels.distances(depth, camera.K), channels.normals(depth, camera.K)
        views.append(View(pose[:3, :3], rendering.mask, depth, distances, normals, rgb))
    return views
