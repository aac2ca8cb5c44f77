"""A contact sheet of the eight parts."""

import cv2
import numpy as np
from jaxtyping import UInt8

from pipeline.geometry import transform
from pipeline.scene import Camera
from pipeline.synth import scenes, sensor
from pipeline.synth.parts import PARTS, Part
from pipeline.synth.ray_shading import AreaLight, Lighting, ShadingConfig, shade
from pipeline.synth.ray_world import Surface, World, posed
from pipeline.synth.things import part_thing

TILE = 240
COLUMNS = 4
LIGHTS = (AreaLight((-0.95, -0.35, 0.70), (0.35, -0.35, 0.0), (0.15, 0.15, 0.3), (34.0, 33.0, 31.5)),)


def contact_sheet(pixel_grid: int = 3) -> UInt8[np.ndarray, "h w 3"]:
    """All parts, each on a light ground with its number and name."""
    tiles = [_tile(part, pixel_grid) for part in PARTS]
    return np.concatenate([np.concatenate(tiles[i : i + COLUMNS], axis=1) for i in range(0, len(tiles), COLUMNS)])


def _tile(part: Part, pixel_grid: int) -> UInt8[np.ndarray, "h w 3"]:
    turn = np.radians(part.preview_turn_deg)
    R = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
    surface = part_thing(part.obj_id).surface
    height = -surface.vertices[:, 2].min()
    surface = posed(surface, transform(R, np.array([0, 0, height])))
    corners = np.array([[-2, -2, 0], [2, -2, 0], [2, 2, 0], [-2, 2, 0.0]])
    ground = Surface(corners, np.array([[0, 1, 2], [0, 2, 3]]), colors=np.full(3, 0.6, np.float32), roughness=0.7)
    lighting = Lighting(LIGHTS, zenith=(0.60, 0.63, 0.68), horizon=(0.38, 0.37, 0.36))
    camera, config = _camera(surface, height), ShadingConfig(pixel_grid)
    radiance = shade(World([ground, surface]), lighting, camera, config, seed=part.obj_id)
    image = sensor.photograph(radiance, np.random.default_rng(part.obj_id), exposure=0.95, noise=0.0)
    label = f"{part.obj_id} {part.name}"
    cv2.putText(image, label, (8, TILE - 10), cv2.FONT_HERSHEY_SIMPLEX, 0.42, (70, 70, 70), 1, cv2.LINE_AA)
    return image


def _camera(surface: Surface, height: float) -> Camera:
    size = np.linalg.norm(np.ptp(surface.vertices, axis=0))
    K = np.array([[2.6 * TILE, 0, (TILE - 1) / 2], [0, 2.6 * TILE, (TILE - 1) / 2 - 6], [0, 0, 1.0]])
    elevation = np.radians(36)
    eye = size * 2.95 * np.array([0.2, -np.cos(elevation), np.sin(elevation)])
    centre: np.ndarray = np.array([0, 0, height])
    return Camera(K, TILE, TILE, scenes.looking(centre + eye, centre))
