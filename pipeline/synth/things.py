"""What can be dropped and drawn: parts and clutter with their solids, collision hulls and surfaces."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from pipeline.synth import clutter, parts, physics, solids, textures
from pipeline.synth.ray_world import Surface

if TYPE_CHECKING:
    from manifold3d import Manifold


@dataclass(frozen=True, eq=False)
class Thing:
    """A part (with its object id) or a piece of clutter (without), ready to be dropped and drawn."""

    name: str
    obj_id: int | None
    solid_mm: Manifold
    hulls: list[Float[np.ndarray, "_ 3"]]
    surface: Surface


@dataclass(frozen=True, eq=False)
class Placed:
    """A thing at rest."""

    thing: Thing
    world_from_model: Float[np.ndarray, "4 4"]


@cache
def part_thing(obj_id: int) -> Thing:
    """A part as a thing."""
    part = parts.PARTS[obj_id - 1]
    solid = parts.part_solid(obj_id)
    surface = surface_of(parts.part_mesh(obj_id))
    return Thing(part.name, obj_id, solid, physics.convex_pieces(solid), surface)


@cache
def clutter_thing(name: str) -> Thing:
    """A piece of clutter as a thing."""
    item = clutter.CLUTTER[name]
    solid = solids.centred(item.build())
    surface = surface_of(solids.mesh_of(solid, 30.0), item.texture, item.roughness)
    return Thing(name, None, solid, physics.convex_pieces(solid), surface)


def surface_of(mesh: solids.PartMesh, texture: textures.Texture | None = None, roughness: float = 0.33) -> Surface:
    """A modelled mesh (mm) as a surface to be drawn (metres)."""
    colors = textures.linear_from_srgb(mesh.colors)
    return Surface(mesh.vertices_mm / 1000.0, mesh.faces, mesh.normals, colors, texture, roughness)
