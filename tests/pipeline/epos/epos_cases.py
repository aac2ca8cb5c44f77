"""Small objects and images that tests of EPOS share."""

import numpy as np
import torch
import trimesh
from scipy.spatial.transform import Rotation

from pipeline.epos.targets import LabelledImage
from pipeline.geometry import transform, transform_points
from pipeline.rendering import render_scene
from pipeline.scene import Camera, Model

torch.set_num_threads(1)  # networks this small gain nothing by more, and tests run side by side

CAMERA = Camera(np.array([[200.0, 0, 63.0], [0, 201.0, 47.5], [0, 0, 1]]), width=128, height=96)


def meshed(obj_id: int, mesh: trimesh.Trimesh, symmetries: np.ndarray | None = None) -> Model:
    vertices = np.asarray(mesh.vertices, np.float64)
    diameter = float(np.linalg.norm(np.ptp(vertices, axis=0)))
    return Model(
        obj_id, vertices, np.asarray(mesh.faces, np.int32), diameter, *([symmetries] if symmetries is not None else [])
    )


def wedge(obj_id: int = 1) -> Model:
    """A part without symmetry: a box with a smaller one on a corner."""
    base = trimesh.creation.box((0.06, 0.04, 0.02)).subdivide().subdivide().subdivide()
    top = trimesh.creation.box((0.02, 0.015, 0.03)).subdivide().subdivide().subdivide()
    top.apply_translation((0.018, 0.01, 0.02))
    return meshed(obj_id, trimesh.util.concatenate([base, top]))


def bar(obj_id: int = 2) -> Model:
    """A box with two different ends up and down, the same turned by 180 degrees about z."""
    base = trimesh.creation.box((0.06, 0.03, 0.02)).subdivide().subdivide().subdivide()
    top = trimesh.creation.box((0.02, 0.012, 0.02)).subdivide().subdivide().subdivide()
    top.apply_translation((0.0, 0.0, 0.02))
    twins = []
    for sign in (1, -1):
        nose = trimesh.creation.box((0.01, 0.01, 0.01)).subdivide().subdivide()
        nose.apply_translation((sign * 0.03, sign * 0.015, 0.0))
        twins.append(nose)
    symmetries = np.stack([np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0])])
    return meshed(obj_id, trimesh.util.concatenate([base, top, *twins]), symmetries)


def cone(obj_id: int = 3) -> Model:
    """A body of revolution about z."""
    body = trimesh.creation.revolve(
        np.array([[0, 0], [0.025, 0], [0.025, 0.01], [0.012, 0.02], [0.008, 0.05], [0, 0.05]]), sections=90
    )
    body = body.subdivide_to_size(0.005)
    turns = [
        transform(Rotation.from_euler("z", angle).as_matrix(), np.zeros(3)) for angle in np.arange(180) * np.pi / 90
    ]
    return meshed(obj_id, body, np.stack(turns))


def pose(x: float, y: float, z: float, angles: tuple[float, float, float] = (0.6, -0.5, 0.4)) -> np.ndarray:
    return transform(Rotation.from_euler("xyz", angles).as_matrix(), np.array([x, y, z]))


def labelled(posed: list[tuple[Model, np.ndarray]], camera: Camera = CAMERA) -> LabelledImage:
    """An image of models, each pixel coloured by the model coordinates that it shows."""
    scene = render_scene(posed, camera, pixel_center=0.0)
    rgb = np.full((camera.height, camera.width, 3), 30, np.uint8)
    v, u = np.nonzero(scene.depth)
    rays = np.stack([u, v, np.ones_like(u)], axis=1) @ np.linalg.inv(camera.K).T
    seen = rays * scene.depth[v, u, None]
    for i, (model, camera_from_model) in enumerate(posed):
        own = scene.instance_ids[v, u] == i
        points = transform_points(np.linalg.inv(camera_from_model), seen[own])
        low, high = model.vertices.min(axis=0), model.vertices.max(axis=0)
        rgb[v[own], u[own]] = np.clip((points - low) / (high - low) * 200 + 50, 0, 255).astype(np.uint8)
    poses = np.array([p for _, p in posed]).reshape(-1, 4, 4)
    return LabelledImage(rgb, camera, tuple(m.obj_id for m, _ in posed), poses, scene.instance_ids)
