"""Surfaces in a world, and what rays meet there (Open3D's Embree)."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pipeline.geometry import inverse
from pipeline.synth.textures import Texture


@dataclass(frozen=True, eq=False)
class Surface:
    """A mesh in the world (metres, z up) and what it is made of."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "v 3"] | None = None
    """Vertex normals; None for flat shading."""
    colors: Float[np.ndarray, "v 3"] | Float[np.ndarray, "3"] | None = None
    """Linear RGB per vertex, or one for all."""
    texture: Texture | None = None
    """Colour by position, in place of `colors`."""
    roughness: float = 0.35
    """Width of reflections: 0 is a mirror, 1 is matt."""
    specular: float = 0.04
    """Reflectance at normal incidence; 0 switches reflections off."""


class Hits(NamedTuple):
    """Where rays met the world."""

    ray: Int[np.ndarray, " n"]
    """Index of the ray that hit."""
    points: Float[np.ndarray, "n 3"]
    normals: Float[np.ndarray, "n 3"]
    """Unit shading normals, towards the ray's origin."""
    albedo: Float[np.ndarray, "n 3"]
    roughness: Float[np.ndarray, "n 1"]
    specular: Float[np.ndarray, "n 1"]
    surface: Int[np.ndarray, " n"]
    """Index of the surface."""


@dataclass(frozen=True, eq=False)
class World:
    """Surfaces, ready for ray casting."""

    surfaces: Sequence[Surface]
    _tables: dict = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        import open3d as o3d

        scene: Any = o3d.t.geometry.RaycastingScene()
        corner_normals, corner_colors, first_face = [], [], [0]
        for surface in self.surfaces:
            scene.add_triangles(_tensor(surface.vertices, np.float32), _tensor(surface.faces, np.uint32))
            corner_normals.append(_corner_normals(surface))
            colors = np.broadcast_to(_plain_colors(surface), surface.vertices.shape)
            corner_colors.append(np.asarray(colors, np.float32)[surface.faces])
            first_face.append(first_face[-1] + len(surface.faces))
        self._tables.update(
            scene=scene,
            normals=np.concatenate(corner_normals),
            colors=np.concatenate(corner_colors),
            first_face=np.array(first_face),
            roughness=np.array([s.roughness for s in self.surfaces], np.float32),
            specular=np.array([s.specular for s in self.surfaces], np.float32),
        )

    def first_hits(
        self, origins: Float[np.ndarray, "n 3"], directions: Float[np.ndarray, "n 3"], textured: bool = True
    ) -> Hits:
        """The first surface along each ray; rays that meet none are left out.

        With `textured=False` a texture's mean colour stands for it, which is enough for indirect light.
        """
        rays = np.concatenate([origins, directions], axis=1, dtype=np.float32)
        answer = self._tables["scene"].cast_rays(_tensor(rays, np.float32))
        distance = answer["t_hit"].numpy()
        ray = np.flatnonzero(np.isfinite(distance))
        surface = answer["geometry_ids"].numpy()[ray].astype(np.int64)
        face = self._tables["first_face"][surface] + answer["primitive_ids"].numpy()[ray]
        uv = answer["primitive_uvs"].numpy()[ray]
        weights = np.concatenate([1.0 - uv.sum(axis=1, keepdims=True), uv], axis=1)[:, None, :]
        points = rays[ray, :3] + rays[ray, 3:] * distance[ray, None]
        normals = (weights @ self._tables["normals"][face])[:, 0]
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        normals *= np.where(np.einsum("ij,ij->i", normals, rays[ray, 3:]) > 0, -1.0, 1.0)[:, None].astype(np.float32)
        albedo = (weights @ self._tables["colors"][face])[:, 0]
        for index, described in enumerate(self.surfaces):
            if textured and described.texture is not None and (here := surface == index).any():
                albedo[here] = described.texture(points[here].astype(np.float64))
        roughness, specular = self._tables["roughness"][surface, None], self._tables["specular"][surface, None]
        return Hits(ray, points, normals, albedo, roughness, specular, surface)

    def is_lit(self, points: Float[np.ndarray, "n 3"], to_light: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """1 where nothing stands between a point and the light at `points + to_light`, else 0."""
        rays = np.concatenate([points, to_light], axis=1, dtype=np.float32)
        blocked = self._tables["scene"].test_occlusions(_tensor(rays, np.float32), 0.0, 1.0)
        return (~blocked.numpy()).astype(np.float32)


def posed(surface: Surface, world_from_model: Float[np.ndarray, "4 4"]) -> Surface:
    """The surface moved from its model frame into the world."""
    rotation = inverse(world_from_model)[:3, :3].T
    normals = None if surface.normals is None else surface.normals @ rotation.T
    vertices = surface.vertices @ world_from_model[:3, :3].T + world_from_model[:3, 3]
    return replace(surface, vertices=vertices, normals=normals)


def _tensor(values: np.ndarray, kind: type) -> Any:
    import open3d as o3d

    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(values, kind))


def _plain_colors(surface: Surface) -> Float[np.ndarray, "*v 3"]:
    """The colours of a surface without a texture, or the mean colour of its texture."""
    if surface.texture is None:
        return np.ones(3, np.float32) if surface.colors is None else np.asarray(surface.colors, np.float32)
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    points = np.random.default_rng(0).uniform(low, high, (4000, 3))
    return surface.texture(points).mean(axis=0).astype(np.float32)


def _corner_normals(surface: Surface) -> Float[np.ndarray, "f 3 3"]:
    if surface.normals is not None:
        return np.asarray(surface.normals, np.float32)[surface.faces]
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    flat = np.cross(b - a, c - a)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True) + 1e-30
    return np.repeat(flat[:, None, :], 3, axis=1).astype(np.float32)
