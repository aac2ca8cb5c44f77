"""A picture of the eight parts, side by side on a light ground."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from pipeline.geometry import inverse, transform
from pipeline.scene import Camera, Model
from pipeline.synth.cameras import Viewpoint, world_from_camera
from pipeline.synth.demo.part_files import part_display_model
from pipeline.synth.demo.parts import PARTS
from pipeline.synth.materials import fixed_material, paint
from pipeline.synth.tracing.path_tracer import PathTracer
from pipeline.synth.worlds.shapes import sheet
from pipeline.synth.worlds.world import AreaLight, Sky, World

TILE = 240
"""Pixels."""
COLUMNS = 4
PITCH = 0.13
"""Metres between the parts of a row."""


def contact_sheet(quality: str = "high") -> UInt8[np.ndarray, "h w 3"]:
    """All parts, row by row, each with its number and name."""
    rows = [_row(first, quality) for first in range(0, len(PARTS), COLUMNS)]
    return np.concatenate(rows)


def _row(first: int, quality: str) -> UInt8[np.ndarray, "h w 3"]:
    parts = PARTS[first : first + COLUMNS]
    models = [part_display_model(part.obj_id) for part in parts]
    poses = [
        _standing(model, k, part.preview_turn_deg) for k, (model, part) in enumerate(zip(models, parts, strict=True))
    ]
    tracer = PathTracer(_studio(), [(m, fixed_material(), pose) for m, pose in zip(models, poses, strict=True)])
    camera = _camera()
    assert camera.world_from_camera is not None
    image = tracer.render(camera, inverse(camera.world_from_camera), quality, seed=first)
    for k, part in enumerate(parts):
        at = (k * TILE + 8, TILE - 10)
        label = f"{part.obj_id} {part.name}"
        cv2.putText(image, label, at, cv2.FONT_HERSHEY_SIMPLEX, 0.42, (60, 60, 60), 1, cv2.LINE_AA)
    return image


def _standing(model: Model, column: int, turn_deg: float) -> Float[np.ndarray, "4 4"]:
    turn = np.radians(turn_deg)
    R = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
    x = (column - (COLUMNS - 1) / 2) * PITCH
    return transform(R, np.array([x, 0, -model.vertices[:, 2].min()]))


def _studio() -> World:
    """A white ground under a large lamp."""
    ground = sheet(6.0, 6.0).piece("ground", paint(190, roughness=0.9, specular=0.1))
    lamp = AreaLight((-0.7, -0.5, 1.3), (0.4, -0.4, 0.0), (0.25, 0.25, 0.3), (12.0, 11.6, 11.0))
    room = np.array([[-3.0, -3.0, 0.0], [3.0, 3.0, 3.0]])
    return World("studio", 0, (ground,), (lamp, Sky((0.34, 0.35, 0.37))), (), room)


def _camera() -> Camera:
    """Far away, so that all parts are seen from nearly the same side."""
    focal = 12.0 * TILE
    height = TILE
    K = np.array([[focal, 0, (COLUMNS * TILE - 1) / 2], [0, focal, (height - 1) / 2], [0, 0, 1.0]])
    distance = focal * PITCH / TILE
    pose = world_from_camera(Viewpoint(-90.0, 34.0, distance, 0.0), np.array([0.0, 0.0, 0.03]))
    return replace(Camera(K, COLUMNS * TILE, height), world_from_camera=pose)
