"""The demo's scenes: which things lie on which table, under which light, seen from which cameras (metres, z up)."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.geometry import transform
from pipeline.scene import Camera
from pipeline.synth import clutter, solids, textures
from pipeline.synth.ray_shading import AreaLight, Lighting
from pipeline.synth.ray_world import Surface, World, posed
from pipeline.synth.things import Placed, surface_of

WIDTH, HEIGHT = 640, 480
INTRINSICS = np.array([[571.2, 0.0, 321.4], [0.0, 571.8, 238.7], [0.0, 0.0, 1.0]])


@dataclass(frozen=True)
class Recipe:
    """What a scene is made of."""

    scene_id: int
    parts: tuple[int, ...]
    """Object ids, one per instance."""
    clutter: tuple[str, ...]
    table: textures.Texture
    half_size: tuple[float, float]
    """Region of the table on which things are dropped."""
    lights: tuple[AreaLight, ...]
    tumbled: bool
    """Dropped one over the other in random orientations, or set down apart from each other."""
    gap: float = 0.012
    """Things that are set down apart: least distance between the circles about them."""
    in_bin: bool = False
    images: int = 8
    distance: tuple[float, float] = (0.50, 0.66)
    elevation_deg: tuple[float, float] = (32.0, 62.0)
    exposure: float = 1.0


WINDOW = AreaLight((-1.15, 0.40, 0.85), (0.5, 0.5, 0.0), (0.18, -0.18, 0.42), (24.0, 23.2, 21.8))
CEILING = AreaLight((-0.35, -0.45, 1.5), (0.7, 0.1, 0.0), (-0.05, 0.35, 0.0), (11.0, 10.8, 10.4))

RECIPES: tuple[Recipe, ...] = (
    Recipe(
        scene_id=1,
        parts=(1, 2, 3, 4, 5, 6),
        clutter=(),
        table=textures.laminate,
        half_size=(0.15, 0.11),
        lights=(WINDOW,),
        tumbled=False,
        gap=0.016,
        distance=(0.42, 0.54),
        exposure=0.80,
    ),
    Recipe(
        scene_id=2,
        parts=(1, 2, 2, 4, 5, 6, 7, 7, 8),
        clutter=("mug", "carton", "wooden block", "tape roll", "screwdriver"),
        table=textures.oak_planks,
        half_size=(0.16, 0.12),
        lights=(WINDOW,),
        tumbled=False,
        gap=-0.012,
        distance=(0.48, 0.62),
        exposure=0.80,
    ),
    Recipe(
        scene_id=3,
        parts=(1, 1, 1, 2, 2, 2, 3, 4, 4, 4, 5, 5, 6, 6, 6, 7, 7, 8, 8),
        clutter=(),
        table=textures.workbench,
        half_size=(0.09, 0.06),
        lights=(WINDOW, CEILING),
        tumbled=True,
        in_bin=True,
        elevation_deg=(48.0, 72.0),
        distance=(0.44, 0.54),
        exposure=0.74,
    ),
)


def world_of(recipe: Recipe, placed: Sequence[Placed]) -> tuple[World, Lighting]:
    """Surfaces and light of a scene: table, floor, bin and the placed things."""
    surfaces = [posed(item.thing.surface, item.world_from_model) for item in placed]
    table_height = -clutter.BIN_WALL_MM / 1000.0 if recipe.in_bin else 0.0
    plate = solids.prism(solids.rectangle(1500, 1100, 12), 30, (255, 255, 255), 3.0)
    table = surface_of(solids.mesh_of(plate, 200.0), recipe.table, 0.55)
    surfaces.append(posed(table, transform(np.eye(3), np.array([0.05, 0.02, table_height - 0.03]))))
    if recipe.in_bin:
        tray = surface_of(solids.mesh_of(clutter.open_bin(), 40.0), roughness=0.45)
        surfaces.append(posed(tray, transform(np.eye(3), np.array([0.0, 0.0, table_height]))))
    corners = 25.0 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0.0]]) - (0, 0, 0.74)
    surfaces.append(Surface(corners, np.array([[0, 1, 2], [0, 2, 3]]), texture=textures.floor_tiles, roughness=0.8))
    lighting = Lighting(recipe.lights, zenith=(0.60, 0.64, 0.70), horizon=(0.34, 0.33, 0.31))
    return World(surfaces), lighting


def camera_ring(recipe: Recipe, placed: Sequence[Placed], seed: int) -> list[Camera]:
    """Cameras all round the parts, at changing heights and distances, each turned a little about its axis."""
    rng = np.random.default_rng([seed, recipe.scene_id, 7])
    centre = np.mean([item.world_from_model[:3, 3] for item in placed if item.thing.obj_id], axis=0)
    cameras = []
    for k in range(recipe.images):
        azimuth = 2 * np.pi * (k + rng.uniform(-0.2, 0.2)) / recipe.images - 0.4 * np.pi
        low, high = np.radians(recipe.elevation_deg)
        elevation = low + (high - low) * (0.5 + 0.5 * np.sin(2.4 * k + rng.uniform(-0.3, 0.3)))
        eye = rng.uniform(*recipe.distance) * np.array(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        )
        look_at = centre + rng.uniform(-0.015, 0.015, 3)
        pose = looking(look_at + eye, look_at, np.radians(rng.uniform(-6, 6)))
        cameras.append(Camera(INTRINSICS, WIDTH, HEIGHT, pose))
    return cameras


def looking(eye: np.ndarray, at: np.ndarray, roll: float = 0.0) -> Float[np.ndarray, "4 4"]:
    """World from camera for a camera at `eye` that looks at a point, with z up in the image but for a roll."""
    z = (at - eye) / np.linalg.norm(at - eye)
    x = np.cross(z, (0.0, 0.0, 1.0))
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(z, x), z], axis=1) @ Rotation.from_euler("z", roll).as_matrix()
    return transform(rotation, eye)
