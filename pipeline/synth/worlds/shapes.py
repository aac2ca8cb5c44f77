"""Meshes to furnish with: bevelled boxes, turned bodies, tubes, sheets; with normals, metric texture coordinates, hulls.

All stand on z = 0 about the z axis unless said otherwise. Metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.transform import Rotation

from pipeline.geometry import transform
from pipeline.synth.materials import Material
from pipeline.synth.worlds.world import Piece


@dataclass(frozen=True, eq=False)
class Shape:
    """Geometry without a material."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "v 3"] | None = None
    uv: Float[np.ndarray, "v 2"] | None = None
    hulls: tuple[Float[np.ndarray, "_ 3"], ...] = ()

    def moved(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, turn_deg: float = 0.0) -> Shape:
        """Turned about the z axis, then shifted."""
        return self.placed(transform(Rotation.from_euler("z", turn_deg, degrees=True).as_matrix(), np.array([x, y, z])))

    def tilted(self, axes: str, *angles_deg: float) -> Shape:
        """Turned about the fixed axes, one after the other."""
        rotation = Rotation.from_euler(axes, angles_deg if len(axes) > 1 else angles_deg[0], degrees=True)
        return self.placed(transform(np.reshape(rotation.as_matrix(), (3, 3)), np.zeros(3)))

    def placed(self, b_from_a: Float[np.ndarray, "4 4"]) -> Shape:
        """Moved by a rigid transform."""
        linear, shift = b_from_a[:3, :3].T, b_from_a[:3, 3]
        normals = None if self.normals is None else self.normals @ linear
        hulls = tuple(hull @ linear + shift for hull in self.hulls)
        return replace(self, vertices=self.vertices @ linear + shift, normals=normals, hulls=hulls)

    def piece(self, name: str, material: Material) -> Piece:
        """With a material."""
        return Piece(name, self.vertices, self.faces, material, self.normals, self.uv, self.hulls)


def joined(shapes: Sequence[Shape]) -> Shape:
    """Several shapes as one; each keeps its hulls."""
    starts = np.cumsum([0, *(len(shape.vertices) for shape in shapes)])
    faces = np.concatenate([shape.faces + start for shape, start in zip(shapes, starts[:-1], strict=True)])
    normals = [_normals(shape) for shape in shapes]
    uv = [np.zeros((len(shape.vertices), 2)) if shape.uv is None else shape.uv for shape in shapes]
    hulls = tuple(hull for shape in shapes for hull in shape.hulls)
    vertices = np.concatenate([shape.vertices for shape in shapes])
    return Shape(vertices, faces, np.concatenate(normals), np.concatenate(uv), hulls)


def box(width: float, depth: float, height: float, bevel: float = 0.003, rounds: int = 1) -> Shape:
    """A box with edges rounded in `rounds` steps per face; textures run along the longer side of each face."""
    half = np.array([width, depth, height]) / 2.0
    bevel = min(bevel, 0.45 * 2 * half.min())
    sides = [_box_side(half, bevel, axis, sign, rounds) for axis in range(3) for sign in (-1, 1)]
    shape = joined(sides)
    corners = half * np.array(list(np.ndindex(2, 2, 2))) * 2 - half
    lift = np.array([0, 0, half[2]])
    return replace(shape, vertices=shape.vertices + lift, hulls=(corners + lift,))


def _box_side(half: np.ndarray, bevel: float, axis: int, sign: int, rounds: int) -> Shape:
    """One face and its share of the bevels: grid points of the cube pulled onto the rounded one."""
    u, v = [k for k in range(3) if k != axis]
    if half[v] > half[u]:
        u, v = v, u
    count = 2 * rounds + 2
    grid = np.zeros((count, count, 3))
    grid[..., u] = _stops(half[u], bevel, rounds)[:, None]
    grid[..., v] = _stops(half[v], bevel, rounds)[None, :]
    grid[..., axis] = sign * half[axis]
    points = grid.reshape(-1, 3)
    core = np.clip(points, -(half - bevel), half - bevel)
    normals = points - core
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    faces = _grid_faces(count, count)
    tangent_u, tangent_v = np.eye(3)[u], np.eye(3)[v]
    if np.cross(tangent_u, tangent_v)[axis] * sign < 0:
        faces = faces[:, ::-1]
    return Shape(core + bevel * normals, faces, normals, points[:, [u, v]] + half[[u, v]])


def _stops(half: float, bevel: float, rounds: int) -> Float[np.ndarray, " n"]:
    """Places of grid lines across a face: its flat part, then equal angles of the rounded edges."""
    outside = half - bevel + bevel * np.tan(np.linspace(0, np.pi / 4, rounds + 1))
    return np.concatenate([-outside[::-1], outside])


def _grid_faces(rows: int, columns: int) -> Int[np.ndarray, "f 3"]:
    """Triangles of a grid of points in row order; seen with rows to the right and columns up they turn left."""
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[1:, 1:].ravel(), index[:-1, 1:].ravel()
    return np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def sheet(width: float, depth: float) -> Shape:
    """A rectangle without thickness in the plane z = 0 that faces up; texture upright along +y."""
    x, y = width / 2.0, depth / 2.0
    vertices = np.array([[-x, -y, 0], [x, -y, 0], [x, y, 0], [-x, y, 0.0]])
    uv = vertices[:, :2] + (x, y)
    hull = np.concatenate([vertices, vertices - (0, 0, 0.002)])
    return Shape(vertices, np.array([[0, 1, 2], [0, 2, 3]]), np.tile([0, 0, 1.0], (4, 1)), uv, (hull,))


def upright(shape: Shape) -> Shape:
    """Stand a flat shape up: its +y becomes +z, its upper side looks towards -y."""
    return shape.tilted("x", 90.0)


def turned(profile: Sequence[tuple[float, float]], segments: int = 40, crease_deg: float = 35.0) -> Shape:
    """Turn a profile of points (radius, z) about the z axis, from the bottom up along the outside.

    Edges of the profile sharper than `crease_deg` stay sharp. A hollow body (cup, bowl) collides as a filled one.
    """
    points = np.array(profile, float)
    steps = np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    points_of, normals_of, along = [], [], np.concatenate([[0], np.cumsum(lengths)])
    outward = np.stack([steps[:, 1], -steps[:, 0]], axis=1) / np.maximum(lengths, 1e-12)[:, None]
    smooth = np.einsum("ij,ij->i", outward[:-1], outward[1:]) > np.cos(np.radians(crease_deg))
    for k in range(len(steps)):
        first = outward[k] + (outward[k - 1] if k and smooth[k - 1] else 0)
        last = outward[k] + (outward[k + 1] if k < len(steps) - 1 and smooth[k] else 0)
        points_of.append((points[k], points[k + 1], along[k], along[k + 1]))
        normals_of.append((first / np.linalg.norm(first), last / np.linalg.norm(last)))
    bands = [_band(p, n, segments, points[:, 0].max()) for p, n in zip(points_of, normals_of, strict=True)]
    shape = joined(bands)
    return replace(shape, hulls=(_ring_points(points),))


def _band(
    ends: tuple[np.ndarray, np.ndarray, float, float],
    normals: tuple[np.ndarray, np.ndarray],
    segments: int,
    radius: float,
) -> Shape:
    low, high, start, stop = ends
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    circle = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rows, shading = [], []
    for point, normal in zip((low, high), normals, strict=True):
        rows.append(np.concatenate([circle * point[0], np.full((segments + 1, 1), point[1])], axis=1))
        shading.append(np.concatenate([circle * normal[0], np.full((segments + 1, 1), normal[1])], axis=1))
    vertices = np.stack(rows, axis=1).reshape(-1, 3)
    around = np.repeat(angle * radius, 2)
    uv = np.stack([around, np.tile([start, stop], segments + 1)], axis=1)
    return Shape(vertices, _grid_faces(segments + 1, 2), np.stack(shading, axis=1).reshape(-1, 3), uv)


def _ring_points(points: np.ndarray, segments: int = 16) -> Float[np.ndarray, "n 3"]:
    """A polygonal hull about a turned body: corners so far out that the sides touch the circle."""
    angle = 2 * np.pi * (np.arange(segments) + 0.5) / segments
    rings = points[points[:, 0] > 1e-9]
    grown = rings[:, :1] / np.cos(np.pi / segments)
    corners = np.stack(
        [grown * np.cos(angle), grown * np.sin(angle), np.broadcast_to(rings[:, 1:], (len(rings), segments))], axis=-1
    )
    return corners.reshape(-1, 3)


def cylinder(radius: float, height: float, bevel: float = 0.002, segments: int = 40) -> Shape:
    """A disc or a rod with a small chamfer."""
    bevel = min(bevel, 0.4 * radius, 0.4 * height)
    r, h = radius, height
    profile = [(0, 0), (r - bevel, 0), (r, bevel), (r, h - bevel), (r - bevel, h), (0, h)]
    return turned(profile, segments, crease_deg=50.0)


def ball(radius: float, squash: float = 1.0) -> Shape:
    """A sphere, flattened or drawn out along z by `squash`, that rests on z = 0."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 20)
    profile = [(max(radius * np.cos(a), 0.0), squash * radius * (1 + np.sin(a))) for a in angle]
    return turned(profile, 32, crease_deg=60.0)


def tube(path: Float[np.ndarray, "n 3"], radius: float, segments: int = 12) -> Shape:
    """A round tube along a path of points, with closed ends; one hull per straight part."""
    path = np.asarray(path, float)
    ahead = np.gradient(path, axis=0)
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    side = np.cross(ahead[0], (0.0, 0.0, 1.0) if abs(ahead[0, 2]) < 0.9 else (1.0, 0.0, 0.0))
    angle = np.linspace(0, 2 * np.pi, segments + 1)
    rings, normals = [], []
    for point, direction in zip(path, ahead, strict=True):
        side = side - direction * (side @ direction)
        side /= np.linalg.norm(side)
        around = np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * np.cross(direction, side)
        rings.append(point + radius * around)
        normals.append(around)
    along = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    uv = np.stack(np.broadcast_arrays(along[:, None], radius * angle[None, :]), axis=-1).reshape(-1, 2)
    skin = Shape(np.concatenate(rings), _grid_faces(len(path), segments + 1)[:, ::-1], np.concatenate(normals), uv)
    ends = [_disc(rings[0][:-1], -ahead[0]), _disc(rings[-1][:-1], ahead[-1])]
    hulls = tuple(np.concatenate([a, b]) for a, b in pairwise(rings))
    return replace(joined([skin, *ends]), hulls=hulls)


def _disc(ring: np.ndarray, normal: np.ndarray) -> Shape:
    count = len(ring)
    fan = np.stack([np.zeros(count - 2, int), np.arange(1, count - 1), np.arange(2, count)], axis=1)
    facing = np.cross(ring[1] - ring[0], ring[2] - ring[0]) @ normal
    return Shape(ring, fan if facing > 0 else fan[:, ::-1], np.tile(normal, (count, 1)))


def surface(points: Float[np.ndarray, "r c 3"]) -> Shape:
    """A smooth curved sheet through a grid of points, seen from both sides; nothing collides with it."""
    rows, columns = points.shape[:2]
    faces = _grid_faces(rows, columns)
    du, dv = np.gradient(points, axis=0), np.gradient(points, axis=1)
    normals = np.cross(du, dv).reshape(-1, 3)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True) + 1e-12
    length_u = np.cumsum(np.linalg.norm(np.diff(points[:, 0], axis=0, prepend=points[:1, 0]), axis=1))
    length_v = np.cumsum(np.linalg.norm(np.diff(points[0], axis=0, prepend=points[0, :1]), axis=1))
    uv = np.stack(np.broadcast_arrays(length_u[:, None], length_v[None, :]), axis=-1).reshape(-1, 2)
    return Shape(points.reshape(-1, 3), faces, normals, uv)


def _normals(shape: Shape) -> Float[np.ndarray, "v 3"]:
    if shape.normals is None:
        raise ValueError("shapes that are joined need normals")
    return shape.normals
