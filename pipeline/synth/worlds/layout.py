"""Putting furniture and clutter in place: frames along walls, scattering without overlap, stages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.geometry import transform, transform_points
from pipeline.synth.worlds.world import Light, Piece, Stage

Thing = list[Piece]
"""Pieces that belong together, in a frame of their own: standing on z = 0, and with its back at y = 0 if it has one."""


def frame(x: float = 0.0, y: float = 0.0, z: float = 0.0, turn_deg: float = 0.0) -> Float[np.ndarray, "4 4"]:
    """World from a frame that is turned about z and shifted."""
    return transform(Rotation.from_euler("z", turn_deg, degrees=True).as_matrix(), np.array([x, y, z]))


def tilt(angle_deg: float) -> Float[np.ndarray, "4 4"]:
    """A turn about x: a flat thing's far side (+y) goes up."""
    return transform(Rotation.from_euler("x", angle_deg, degrees=True).as_matrix(), np.zeros(3))


def placed(thing: Thing, world_from_thing: Float[np.ndarray, "4 4"]) -> Thing:
    """The thing moved by a rigid transform."""
    return [_placed_piece(piece, world_from_thing) for piece in thing]


def _placed_piece(piece: Piece, world_from_thing: Float[np.ndarray, "4 4"]) -> Piece:
    normals = None if piece.normals is None else piece.normals @ world_from_thing[:3, :3].T
    hulls = tuple(transform_points(world_from_thing, hull) for hull in piece.hulls)
    return replace(piece, vertices=transform_points(world_from_thing, piece.vertices), normals=normals, hulls=hulls)


@dataclass
class Furnished:
    """A scene in the making."""

    size: tuple[float, float, float]
    """Inside of the room, from the origin."""
    rng: np.random.Generator
    pieces: list[Piece] = field(default_factory=list)
    lights: list[Light] = field(default_factory=list)
    stages: list[Stage] = field(default_factory=list)

    def put(self, thing: Thing, world_from_thing: Float[np.ndarray, "4 4"] | None = None) -> None:
        """Add a thing."""
        self.pieces += thing if world_from_thing is None else placed(thing, world_from_thing)

    def wall(self, side: str, along: float = 0.0, z: float = 0.0) -> Float[np.ndarray, "4 4"]:
        """Frame on a wall, looking at it from inside: x to the right, -y into the room; `along` from its left end."""
        width, depth, _ = self.size
        origin = {"north": (0, depth, 0), "east": (width, depth, -90), "south": (width, 0, 180), "west": (0, 0, 90)}
        x, y, turn = origin[side]
        return frame(x, y, 0.0, turn) @ frame(along, 0.0, z)

    def stage(
        self,
        name: str,
        world_from_surface: Float[np.ndarray, "4 4"],
        low: tuple[float, float],
        high: tuple[float, float],
        free_height: float,
    ) -> Stage:
        """Declare a rectangle of a horizontal surface a stage, and return it; its frame has the origin in the middle."""
        half = (np.array(high) - low) / 2.0
        centre = (np.array(high) + low) / 2.0
        polygon = half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        stage = Stage(name, polygon, world_from_surface @ frame(*centre), free_height)
        self.stages.append(stage)
        return stage

    def scatter(
        self,
        things: Sequence[Thing],
        world_from_surface: Float[np.ndarray, "4 4"],
        low: tuple[float, float],
        high: tuple[float, float],
        turn_deg: float = 180.0,
    ) -> None:
        """Set things down at random on a rectangle of a surface, clear of each other and of all stages.

        Those for which no room is found are left out.
        """
        taken: list[tuple[np.ndarray, float]] = []
        for thing in sorted(things, key=_radius, reverse=True):
            surface_from_thing = self._free_place(thing, world_from_surface, (low, high), taken, turn_deg)
            if surface_from_thing is not None:
                self.put(thing, world_from_surface @ surface_from_thing)

    def _free_place(
        self,
        thing: Thing,
        world_from_surface: Float[np.ndarray, "4 4"],
        area: tuple[tuple[float, float], tuple[float, float]],
        taken: list[tuple[np.ndarray, float]],
        turn_deg: float,
    ) -> Float[np.ndarray, "4 4"] | None:
        for _ in range(60):
            at, turn = self.rng.uniform(*area), self.rng.uniform(-turn_deg, turn_deg)
            place = frame(*at, turn_deg=turn)
            corners = transform_points(place, _footprint(thing))[:, :2]
            centre = corners.mean(axis=0)
            radius = float(np.linalg.norm(corners - centre, axis=1).max())
            inside = (corners >= np.array(area[0]) - 0.01).all() and (corners <= np.array(area[1]) + 0.01).all()
            apart = all(np.linalg.norm(centre - c) > radius + r + 0.004 for c, r in taken)
            if inside and apart and not self._on_stage(transform_points(world_from_surface @ place, _footprint(thing))):
                taken.append((centre, radius))
                return place
        return None

    def _on_stage(self, corners: Float[np.ndarray, "4 3"], gap: float = 0.012) -> bool:
        """Whether the rectangle with these corners comes nearer than `gap` to a stage, or above it."""
        share = np.linspace(0, 1, 9)
        grid = [(1 - s) * ((1 - t) * corners[0] + t * corners[1]) + s * ((1 - t) * corners[3] + t * corners[2])
                for s in share for t in share]  # fmt: skip
        points = np.array(grid)
        for stage in self.stages:
            local = transform_points(np.linalg.inv(stage.world_from_stage), points)
            beside = stage.contains(local[:, :2], -gap)
            if (beside & (local[:, 2] > -0.05) & (local[:, 2] < stage.free_height)).any():
                return True
        return False


def _footprint(thing: Thing) -> Float[np.ndarray, "4 3"]:
    """Corners of the rectangle that the thing covers, counter-clockwise."""
    vertices = np.concatenate([piece.vertices for piece in thing])
    (x0, y0), (x1, y1) = vertices.min(axis=0)[:2], vertices.max(axis=0)[:2]
    return np.array([[x0, y0, 0], [x1, y0, 0], [x1, y1, 0], [x0, y1, 0.0]])


def _radius(thing: Thing) -> float:
    corners = _footprint(thing)
    return float(np.linalg.norm(corners[2] - corners[0]) / 2)


def row(things: Sequence[Thing], gap: float = 0.002) -> Thing:
    """Things side by side along x, from x = 0 on."""
    pieces: Thing = []
    x = 0.0
    for thing in things:
        corners = _footprint(thing)
        pieces += placed(thing, frame(x - corners[0, 0]))
        x += corners[1, 0] - corners[0, 0] + gap
    return pieces


def stacked(things: Sequence[Thing], rng: np.random.Generator, turn_deg: float = 8.0) -> Thing:
    """Things one on top of the other, each turned a little."""
    pieces: Thing = []
    z = 0.0
    for thing in things:
        x, y, turn = rng.uniform(-1, 1, 3) * (0.006, 0.006, turn_deg)
        pieces += placed(thing, frame(x, y, z, turn))
        z += max(piece.vertices[:, 2].max() for piece in thing)
    return pieces
