"""Solid modelling for the parts: rounded prisms, lathed bodies, holes and screws as boolean operations (millimetres).

Every solid carries one colour per region, so that unions keep the colours of what they were made of and a cut
face gets the colour of its cutter. Needs `manifold3d` (extra `synth`); users of the exported meshes do not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int, UInt8

if TYPE_CHECKING:
    from manifold3d import CrossSection, Manifold

Color = tuple[int, int, int]
Point2 = tuple[float, float]
Point3 = tuple[float, float, float]

_TURNS = {"+x": (0, 90, 0), "-x": (0, -90, 0), "+y": (-90, 0, 0), "-y": (90, 0, 0), "+z": (0, 0, 0), "-z": (180, 0, 0)}

SHARP_EDGE_DEG = 40.0
"""Edges with a larger angle between their faces keep two normals; rounded edges are shaded smoothly."""


@dataclass(frozen=True, eq=False)
class PartMesh:
    """A triangle mesh as it is exported: vertices on sharp edges and colour borders are repeated per side."""

    vertices_mm: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "v 3"]
    colors: UInt8[np.ndarray, "v 3"]


def painted(solid: Manifold, color: Color) -> Manifold:
    """The same solid with one colour all over (three channels are kept free for the normals)."""
    return solid.set_properties(6, lambda _position, _old: [0.0, 0.0, 0.0, *map(float, color)])


def rectangle(width: float, depth: float, corner_radius: float = 0.0) -> CrossSection:
    """A rectangle about the origin with rounded corners."""
    from manifold3d import CrossSection

    return fillet(CrossSection.square((width, depth), True), corner_radius)


def polygon(points: Sequence[Point2], corner_radius: float = 0.0, segments: int = 16) -> CrossSection:
    """A counter-clockwise outline with all its corners, convex and concave, rounded."""
    from manifold3d import CrossSection

    return fillet(CrossSection([np.array(points, float)]), corner_radius, segments)


def fillet(outline: CrossSection, radius: float, segments: int = 16) -> CrossSection:
    """Round the corners of an outline: shrink, grow, shrink by arcs."""
    from manifold3d import JoinType

    if radius == 0.0:
        return outline
    for step in (-radius, 2 * radius, -radius):
        outline = outline.offset(step, JoinType.Round, 2.0, segments)
    return outline


def prism(outline: CrossSection, height: float, color: Color, edge_radius: float = 0.0) -> Manifold:
    """Raise an outline from z = 0 to `height`; all edges are rounded by rolling a ball over the shrunken prism."""
    from manifold3d import JoinType, Manifold

    if edge_radius == 0.0:
        return painted(Manifold.extrude(outline, height), color)
    core = Manifold.extrude(outline.offset(-edge_radius, JoinType.Miter, 4.0), height - 2 * edge_radius)
    solid = core.minkowski_sum(Manifold.sphere(edge_radius, 8)).translate((0, 0, edge_radius))
    return painted(solid.simplify(1e-3), color)


def lathe(profile: CrossSection, color: Color, segments: int = 64) -> Manifold:
    """Turn a profile of points (radius, z) about the z axis."""
    from manifold3d import Manifold

    return painted(Manifold.revolve(profile, segments), color)


def cylinder(radius: float, bottom: float, top: float, color: Color, top_radius: float | None = None) -> Manifold:
    """A cylinder (or a cone's frustum) about the z axis between two heights."""
    from manifold3d import Manifold

    segments = 4 * max(4, round(1.6 * np.sqrt(radius) + 1))
    solid = Manifold.cylinder(top - bottom, radius, radius if top_radius is None else top_radius, segments)
    return painted(solid.translate((0, 0, bottom)), color)


def hole(radius: float, depth: float, color: Color, chamfer: float = 0.6) -> Manifold:
    """A cutter: a round hole down from z = 0 with a chamfered mouth."""
    mouth = cylinder(radius, -chamfer, 0.01, color, radius + chamfer + 0.01)
    return union(cylinder(radius, -depth, 1.0, color), mouth)


def screw(radius: float, color: Color, slot_deg: float = 0.0) -> Manifold:
    """A slotted screw head whose top face lies at z = 0."""
    head = union(
        cylinder(radius, -0.5, 0.0, color, radius - 0.4),
        cylinder(radius, -3.0, -0.5, color),
    )
    slot = prism(rectangle(3 * radius, 0.3 * radius), 2.0, color).translate((0, 0, -0.9)).rotate((0, 0, slot_deg))
    return head - slot


def facing(solid: Manifold, direction: str, position: Point3) -> Manifold:
    """Turn the solid's +z axis to a signed axis such as "+x" or "-y", then move it."""
    return solid.rotate(_TURNS[direction]).translate(position)


def union(*solids: Manifold) -> Manifold:
    """All solids in one."""
    from manifold3d import Manifold, OpType

    return Manifold.batch_boolean(list(solids), OpType.Add)


def around_z(solid: Manifold, copies: int) -> Manifold:
    """The solid repeated at equal angles about the z axis."""
    return union(*(solid.rotate((0, 0, 360.0 * k / copies)) for k in range(copies)))


def without_voids(solid: Manifold) -> Manifold:
    """The outer hull surface only: drops enclosed cavities and slivers left over by the boolean operations."""
    return max(solid.decompose(), key=lambda shell: shell.volume())


def centred(solid: Manifold) -> Manifold:
    """Move the centre of the bounding box to the origin."""
    box = np.reshape(solid.bounding_box(), (2, 3))
    return solid.translate(tuple(-box.mean(axis=0)))


def mesh_of(solid: Manifold, edge_length_mm: float) -> PartMesh:
    """Triangulate with edges of about the given length at most, and shade rounded edges smoothly."""
    mesh = solid.simplify(2e-3).refine_to_length(edge_length_mm).calculate_normals(0, SHARP_EDGE_DEG).to_mesh()
    table = np.asarray(mesh.vert_properties)
    normals = table[:, 3:6] / np.linalg.norm(table[:, 3:6], axis=1, keepdims=True)
    return PartMesh(
        vertices_mm=table[:, :3].astype(np.float32),
        faces=np.asarray(mesh.tri_verts, np.int32),
        normals=normals.astype(np.float32),
        colors=np.clip(np.rint(table[:, 6:9]), 0, 255).astype(np.uint8),
    )
