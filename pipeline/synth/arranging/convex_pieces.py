"""Any mesh as a few convex pieces that together contain its surface: what collides in the simulation.

The surface is cut by planes, each triangle exactly, and a piece is the convex hull of what lies between cuts and of
the inside there: so the pieces contain the surface whatever the mesh is, watertight or not. What is cut is the piece
that reaches out of the mesh most; where, is decided on a coarse grid of cells.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass
from hashlib import blake2b
from itertools import count

import numpy as np
from jaxtyping import Float, Int

from pipeline.model_cache import convex_hull, per_model
from pipeline.scene import Model
from pipeline.synth.arranging.convex_hulls import corners_of, few_corners, moments, samples_of, volume_of
from pipeline.synth.arranging.soup import Soup, split
from pipeline.synth.arranging.watertight import is_watertight

MOST_PIECES = 28
TOLERANCE = 0.005
"""A piece is cut while it reaches out of the mesh by more than this share of the volume of the whole convex hull."""
CELLS = 30
"""Cells of the coarse grid along the longest side."""
RAYS = 7
"""Rays whose majority says whether a point is inside a mesh that is not watertight."""
LEAST_GAIN = 0.04
"""Share of a piece's volume that a cut must save; where none does, the middle of the longest side is cut."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """Convex pieces of a model and what moves like it, model frame, metres; density 1."""

    hulls: tuple[Float[np.ndarray, "_ 3"], ...]
    """Corners of the pieces."""
    volume: float
    centre: Float[np.ndarray, " 3"]
    """Centre of mass."""
    inertia: Float[np.ndarray, "3 3"]
    """About the centre of mass."""


@per_model
def pieces_of(model: Model) -> Pieces:
    """Convex pieces of a model, computed once per content: models that are equal copies share them."""
    key = blake2b(model.vertices.tobytes() + model.faces.tobytes(), digest_size=16).digest()
    if key not in _BY_CONTENT:
        hulls = convex_pieces(model)
        _BY_CONTENT[key] = Pieces(tuple(hulls), *moments(hulls))
    return _BY_CONTENT[key]


_BY_CONTENT: dict[bytes, Pieces] = {}


def extremes(model: Model) -> Float[np.ndarray, "n 3"]:
    """The vertices on the model's convex hull: all that bounds, and what it stands on, depend on them."""
    return model.vertices[convex_hull(model)]


def convex_pieces(model: Model, most: int = MOST_PIECES) -> list[Float[np.ndarray, "_ 3"]]:
    """Corners of at most `most` convex bodies that together contain the surface (to 0.1 mm)."""
    grid, order = _Grid(model), count()
    limit = TOLERANCE * volume_of(corners_of(model.vertices))
    queue = [_piece(grid, model.vertices[model.faces], grid.low, grid.high, order)]
    while len(queue) < most and -queue[0][0] > limit:
        _, _, piece = heapq.heappop(queue)
        axis, at = grid.best_cut(piece.low, piece.high)
        low, high = split(piece.soup, axis, grid.place(axis, at))
        for soup, start, stop in (
            (low, piece.low, _at(piece.high, axis, at)),
            (high, _at(piece.low, axis, at), piece.high),
        ):
            if len(soup):
                heapq.heappush(queue, _piece(grid, soup, start, stop, order))
    return [few_corners(piece.corners) for _, _, piece in sorted(queue, key=lambda entry: entry[1])]


@dataclass(frozen=True, eq=False)
class _Piece:
    soup: Soup
    low: Int[np.ndarray, " 3"]
    """Planes of the grid between which the piece lies."""
    high: Int[np.ndarray, " 3"]
    corners: Float[np.ndarray, "_ 3"]


def _piece(
    grid: _Grid, soup: Soup, low: Int[np.ndarray, " 3"], high: Int[np.ndarray, " 3"], order: count[int]
) -> tuple[float, int, _Piece]:
    """A piece with its place in the queue: that which reaches out most is first."""
    corners = corners_of(np.concatenate([soup.reshape(-1, 3), grid.inside(low, high)]))
    points, area = samples_of(corners)
    excess = area * float(np.maximum(grid.distance(points), 0.0).mean()) if (high - low).max() > 1 else 0.0
    return -excess, next(order), _Piece(soup, low, high, corners)


def _at(planes: Int[np.ndarray, " 3"], axis: int, at: int) -> Int[np.ndarray, " 3"]:
    moved = planes.copy()
    moved[axis] = at
    return moved


class _Grid:
    """Cells about a mesh: which hold its surface or lie inside; nodes of the grid that lie inside."""

    def __init__(self, model: Model) -> None:
        self._model = model
        self._origin = model.vertices.min(axis=0)
        size = np.ptp(model.vertices, axis=0)
        self._step = float(size.max()) / CELLS
        self.low = np.zeros(3, np.int64)
        self.high = np.maximum(1, np.ceil(size / self._step - 1e-9).astype(np.int64))
        nodes = np.stack(np.meshgrid(*(np.arange(n + 1) for n in self.high), indexing="ij"), axis=-1).reshape(-1, 3)
        self._nodes = nodes[self.distance(self._origin + nodes * self._step) < 0]
        surface = np.floor((_dense(model) - self._origin) / self._step).astype(np.int64)
        cells = np.concatenate([np.clip(surface, 0, self.high - 1), np.minimum(self._nodes, self.high - 1)])
        self._cells = np.unique(cells, axis=0)

    def place(self, axis: int, at: int) -> float:
        """Coordinate of a plane of the grid."""
        return float(self._origin[axis] + at * self._step)

    def inside(self, low: Int[np.ndarray, " 3"], high: Int[np.ndarray, " 3"]) -> Float[np.ndarray, "n 3"]:
        """Nodes inside the mesh, from plane to plane, both included."""
        chosen = ((self._nodes >= low) & (self._nodes <= high)).all(axis=1)
        return self._origin + self._nodes[chosen] * self._step

    def distance(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
        """Signed distance to the surface, negative inside."""
        return signed_distance(self._model, points)

    def best_cut(self, low: Int[np.ndarray, " 3"], high: Int[np.ndarray, " 3"]) -> tuple[int, int]:
        """Axis and plane of the cut that leaves the least volume to the convex hulls of both sides' cells."""
        cells = self._cells[((self._cells >= low) & (self._cells < high)).all(axis=1)]
        whole = _hull_volume(cells)
        axis = int(np.argmax(high - low))
        best = (whole * (1 - LEAST_GAIN), axis, int((low[axis] + high[axis]) // 2))
        for axis in range(3):
            for at in np.unique(np.linspace(low[axis], high[axis], 8)[1:-1].round().astype(int)):
                below = cells[:, axis] < at
                if below.any() and not below.all():
                    best = min(best, (_hull_volume(cells[below]) + _hull_volume(cells[~below]), axis, int(at)))
        return best[1], best[2]


def signed_distance(model: Model, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, " n"]:
    """Metres to the surface of a model, negative inside; of one that is not watertight, inside is what most rays say."""
    from open3d.core import Tensor

    from pipeline.ray_casting import _raycaster  # one acceleration structure serves all

    query = Tensor.from_numpy(np.ascontiguousarray(points, np.float32))
    rays = 1 if is_watertight(model) else RAYS
    return _raycaster(model).compute_signed_distance(query, nsamples=rays).numpy().astype(np.float64)


def _dense(model: Model) -> Float[np.ndarray, "n 3"]:
    """Points all over the surface."""
    import trimesh

    mesh = trimesh.Trimesh(model.vertices, model.faces, process=False)
    return np.concatenate([model.vertices, trimesh.sample.sample_surface(mesh, 20000, seed=0)[0]])


def _hull_volume(cells: Int[np.ndarray, "n 3"]) -> float:
    """Volume, in cells, of the convex hull of cells."""
    for axis in range(3):  # only the ends of each row of cells can be corners
        others = [k for k in range(3) if k != axis]
        row = cells[:, others[0]] * 4096 + cells[:, others[1]]
        order = np.lexsort((cells[:, axis], row))
        starts = np.r_[True, np.diff(row[order]) != 0]
        cells = cells[np.unique(np.r_[order[starts], order[np.r_[starts[1:], True]]])]
    corners = (cells[:, None] + np.array(list(np.ndindex(2, 2, 2)))).reshape(-1, 3)
    return volume_of(np.unique(corners, axis=0).astype(float))
