"""A furnished scene: pieces of geometry with materials, lights, and stages on which objects are arranged.

Metres, z up, the floor at z = 0. What does not move is here; objects are added when an image is rendered.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8

from pipeline.geometry import inverse, transform_points
from pipeline.scene import Model
from pipeline.synth.materials import RGB, Material

if TYPE_CHECKING:
    import trimesh

Point = tuple[float, float, float]

STATIC = 0
"""Object id of the model that holds all static geometry of a world."""


@dataclass(frozen=True, eq=False)
class Piece:
    """A mesh of one material, in the world frame."""

    name: str
    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    material: Material
    normals: Float[np.ndarray, "v 3"] | None = None
    """Unit vertex normals; None for flat faces."""
    uv: Float[np.ndarray, "v 2"] | None = None
    """Texture coordinates in metres."""
    hulls: tuple[Float[np.ndarray, "_ 3"], ...] = ()
    """Vertices of convex bodies that together contain the piece: what falling objects collide with."""


@dataclass(frozen=True)
class AreaLight:
    """A rectangle that shines to one side, that of the cross product of its half sides."""

    centre: Point
    half_u: Point
    half_v: Point
    radiance: RGB
    """Linear RGB."""
    picture: Float32[np.ndarray, "h w 3"] | None = field(default=None, compare=False)
    """Factors of the radiance over the rectangle, first row at +half_v: the view from a window."""


@dataclass(frozen=True)
class PointLight:
    """A small bulb."""

    position: Point
    intensity: RGB


@dataclass(frozen=True)
class Beam:
    """Light from a point through a mask: the patch of sun that a window throws into a room."""

    position: Point
    target: Point
    angle_deg: float
    """Full opening angle."""
    irradiance: RGB
    """Of a surface at the target that faces the light."""
    pattern: UInt8[np.ndarray, "h w 3"] = field(compare=False)


@dataclass(frozen=True)
class Sky:
    """The same radiance from everywhere beyond the walls."""

    radiance: RGB


Light = AreaLight | PointLight | Beam | Sky


@dataclass(frozen=True, eq=False)
class Stage:
    """A flat place on which objects are arranged (thesis sec. synth_composition), with nothing on it."""

    name: str
    polygon: Float[np.ndarray, "n 2"]
    """Corners of a convex polygon, counter-clockwise, in the plane z = 0 of the stage frame."""
    world_from_stage: Float[np.ndarray, "4 4"]
    """Rigid; the z axis points up."""
    free_height: float
    """Metres of free space above the polygon."""

    @property
    def area(self) -> float:
        """Square metres."""
        x, y = self.polygon.T
        return float(0.5 * np.abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)))

    def contains(self, points: Float[np.ndarray, "*n 2"], margin: float = 0.0) -> Bool[np.ndarray, "*n"]:
        """Whether points of the stage plane lie inside the polygon, at least `margin` metres from its border."""
        ahead = np.roll(self.polygon, -1, axis=0) - self.polygon
        inward = np.stack([-ahead[:, 1], ahead[:, 0]], axis=1) / np.linalg.norm(ahead, axis=1, keepdims=True)
        distance = points @ inward.T - np.einsum("ij,ij->i", self.polygon, inward)
        return np.asarray((distance >= margin).all(axis=-1))

    def sample(self, rng: np.random.Generator, count: int, margin: float = 0.0) -> Float[np.ndarray, "n 2"]:
        """Points of the stage plane, uniform over the polygon less its margin.

        Raises `ValueError` where the margin leaves nothing of the polygon.
        """
        low, high = self.polygon.min(axis=0), self.polygon.max(axis=0)
        for _ in range(200):
            points = rng.uniform(low, high, (50 * count + 100, 2))
            inside = points[self.contains(points, margin)]
            if len(inside) >= count:
                return inside[:count]
        raise ValueError(
            f"stage {self.name}: a margin of {margin} m leaves no room in {np.ptp(self.polygon, axis=0)} m"
        )


@dataclass(frozen=True, eq=False)
class World:
    """A scene without objects."""

    name: str
    seed: int
    pieces: tuple[Piece, ...]
    lights: tuple[Light, ...]
    stages: tuple[Stage, ...]
    room: Float[np.ndarray, "2 3"]
    """Lower and upper corner of the inside of the room, in which cameras may stand."""
    white: RGB = (1.0, 1.0, 1.0)
    """Colour of the light at large, to which a camera's white balance adapts."""

    def stage(self, name: str) -> Stage:
        """The stage of that name; `KeyError` names those that there are."""
        found = {stage.name: stage for stage in self.stages}
        if name not in found:
            raise KeyError(f"world {self.name} has no stage {name!r}; it has: {', '.join(found)}")
        return found[name]

    @cached_property
    def model(self) -> Model:
        """All static geometry, lamps and window panes too, as one model (object id 0, world frame), for ray casting."""
        parts = [(piece.vertices, piece.faces) for piece in self.pieces]
        parts += [quad(light) for light in self.lights if isinstance(light, AreaLight)]
        starts = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
        vertices = np.concatenate([vertices for vertices, _ in parts]).astype(np.float64)
        faces = np.concatenate([faces + start for (_, faces), start in zip(parts, starts[:-1], strict=True)])
        return Model(STATIC, vertices, faces.astype(np.int32), float(np.linalg.norm(np.ptp(vertices, axis=0))))

    @property
    def trimesh(self) -> trimesh.Trimesh:
        """All static geometry as a mesh, a new one each time."""
        import trimesh

        return trimesh.Trimesh(self.model.vertices, self.model.faces, process=False)

    def hulls_near(self, stage: Stage, reach: float = 0.5) -> list[Float[np.ndarray, "_ 3"]]:
        """Convex bodies (vertices in the stage frame) that objects above the stage, or fallen off it, can touch.

        Those whose boxes come within `reach` metres of the polygon, from the floor to the stage's free height.
        """
        stage_from_world = inverse(stage.world_from_stage)
        low, high = stage.polygon.min(axis=0) - reach, stage.polygon.max(axis=0) + reach
        near = []
        for piece in self.pieces:
            for hull in piece.hulls:
                points = transform_points(stage_from_world, hull)
                touches = (points.min(axis=0)[:2] <= high).all() and (points.max(axis=0)[:2] >= low).all()
                if touches and points[:, 2].min() <= stage.free_height:
                    near.append(points)
        return near

    def clearance(self, points: Float[np.ndarray, "n 3"]) -> Float32[np.ndarray, " n"]:
        """Distance in metres of each point to the nearest static surface: to see whether a camera has room there."""
        import open3d as o3d

        from pipeline.ray_casting import _raycaster  # one acceleration structure serves both

        return _raycaster(self.model).compute_distance(o3d.core.Tensor.from_numpy(points.astype(np.float32))).numpy()


def quad(light: AreaLight) -> tuple[Float[np.ndarray, "4 3"], Int[np.ndarray, "2 3"]]:
    """The rectangle of an area light as two triangles that face its bright side."""
    centre, u, v = (np.array(vector, float) for vector in (light.centre, light.half_u, light.half_v))
    corners = np.stack([centre - u - v, centre + u - v, centre + u + v, centre - u + v])
    return corners, np.array([[0, 1, 2], [0, 2, 3]], np.int32)
