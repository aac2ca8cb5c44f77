"""A model's surface with all that distances to it need: samples, a grid of distances, exact nearest points."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Float, Float32

from pipeline.exceptions import FormatError
from pipeline.scene import Model
from pipeline.symmetry_search.groups import Extent

GRID = 60
"""Nodes of the grid of distances along each side."""
SPACING = 0.0125
"""Longest edge of the pieces whose corners are the samples, as a share of the size."""
COARSE, MIDDLE = 384, 3000
"""Samples in the sparse sets, spread evenly, for looking at many rotations and for fits."""
MOST_SAMPLES = 150_000
"""Meshes with more vertices are thinned out to about this many samples."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A surface in a frame with its origin at the surface's centre of area; metres."""

    center: Float[np.ndarray, "3"]
    """In the model frame."""
    size: float
    """Twice the distance from the centre to the farthest vertex; about the diameter."""
    samples: Float[np.ndarray, "n 3"]
    """All vertices and enough points between: every surface point is within `gap` of one."""
    gap: float
    """Metres."""
    middle: Float[np.ndarray, "m 3"]
    """Some samples, spread evenly."""
    coarse: Float[np.ndarray, "c 3"]
    """Fewer samples, spread evenly."""
    _caster: Any

    @classmethod
    def of(cls, model: Model) -> "Surface":
        """Prepare a model. Raises FormatError if its faces have no area."""
        from pipeline.symmetry_search.loops import farthest_points

        corners = model.vertices[model.faces]
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        if not areas.sum() > 0:
            raise FormatError(f"object {model.obj_id}: the faces of its model have no area; export the mesh again")
        center = (corners.mean(axis=1) * areas[:, None]).sum(axis=0) / areas.sum()
        corners = corners - center
        size = 2 * float(np.linalg.norm(corners, axis=2).max())
        samples, gap = _samples(corners, size)
        sparse = _thinned(samples, 2 * SPACING * size)
        middle = sparse[farthest_points(sparse, min(MIDDLE, len(sparse)))]
        return cls(center, size, samples, gap, middle, middle[:COARSE], _caster(corners))

    @property
    def extent(self) -> Extent:
        """Where the surface is in the model frame."""
        return Extent(self.center, self.size / 2)

    @cached_property
    def field(self) -> tuple[Float32[np.ndarray, "g g g 4"], Float[np.ndarray, "3"], float]:
        """The grid of distances as `loops` takes it: nodes, lowest corner, cells per metre."""
        reach = 0.525 * self.size
        steps = np.linspace(-reach, reach, GRID)
        nodes = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
        vectors = self.nearest(nodes)[0] - nodes
        lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
        grid = np.hstack([vectors, lengths]).astype(np.float32).reshape(GRID, GRID, GRID, 4)
        return grid, np.full(3, -reach), (GRID - 1) / (2 * reach)

    def nearest(self, points: Float[np.ndarray, "n 3"]) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n 3"]]:
        """Nearest points of the surface and the normals of their faces (of either sign)."""
        found = self._caster.compute_closest_points(_tensor(points))
        return found["points"].numpy().astype(float), found["primitive_normals"].numpy().astype(float)

    def distances(self, points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n"]:
        """Distances to the surface, exact to single precision."""
        return self._caster.compute_distance(_tensor(points)).numpy().astype(float)

    def largest_distance(self, images: Iterator[Float[np.ndarray, "n 3"]]) -> float:
        """Largest distance to the surface of any point of several sets; only those that may have it are measured."""
        from pipeline.symmetry_search.loops import bounds

        grid, low, per_metre = self.field
        largest = 0.0
        for points in images:
            about = bounds(grid, low, per_metre, points)
            candidates = points[about > max(largest, about.max() - 1 / per_metre) - 1 / per_metre]
            largest = max(largest, float(self.distances(candidates).max(initial=0.0)))
        return largest


def _caster(corners: Float[np.ndarray, "f 3 3"]) -> Any:
    import open3d as o3d

    caster = o3d.t.geometry.RaycastingScene()
    faces = np.arange(3 * len(corners), dtype=np.uint32).reshape(-1, 3)
    caster.add_triangles(_tensor(corners.reshape(-1, 3)), o3d.core.Tensor.from_numpy(faces))
    return caster


def _tensor(points: Float[np.ndarray, "n 3"]) -> Any:
    import open3d as o3d

    return o3d.core.Tensor.from_numpy(np.ascontiguousarray(points, np.float32))


def _samples(corners: Float[np.ndarray, "f 3 3"], size: float) -> tuple[Float[np.ndarray, "n 3"], float]:
    """Corners of the faces after halving every edge longer than the spacing, and how far a point may be from one."""
    longest = SPACING * size
    found = [np.unique(corners.reshape(-1, 3), axis=0)]
    pieces = corners
    while True:
        edges = np.linalg.norm(pieces - np.roll(pieces, -1, axis=1), axis=2)
        long = edges.max(axis=1) > longest
        if not long.any():
            break
        rows, first = np.flatnonzero(long), edges[long].argmax(axis=1)
        a, b, c = (pieces[rows, (first + k) % 3] for k in range(3))
        middle = (a + b) / 2
        found.append(middle)
        pieces = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
    points = np.concatenate(found)
    # Of a triangle whose edges are no longer than s, every point is within s / sqrt(3) of a corner.
    gap = longest / np.sqrt(3)
    if len(points) > MOST_SAMPLES:
        points, gap = _thinned(points, 0.5 * longest), gap + 0.5 * np.sqrt(3) * longest
    return _thinned(points, 1e-7 * size), gap


def _thinned(points: Float[np.ndarray, "n 3"], cell: float) -> Float[np.ndarray, "k 3"]:
    """One point of each cell of a grid."""
    keys = np.floor(points / cell).astype(np.int64)
    _, first = np.unique(keys, axis=0, return_index=True)
    return points[np.sort(first)]
