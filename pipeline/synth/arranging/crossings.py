"""Whether two surfaces cross, and how far one must be moved for them not to.

Depth inside the other says little of thin walls: two sheets may cross from side to side while no point of the one is
deeper than half the other's thickness. Surfaces cross where an edge of one meets a face of the other.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.geometry import inverse, transform_points
from pipeline.model_cache import per_model
from pipeline.ray_casting import _raycaster
from pipeline.scene import Model

Posed = tuple[Model, Float[np.ndarray, "4 4"]]
"""A model and world from model."""


def separation(first: Posed, second: Posed, least: float) -> float:
    """Metres by which one of two objects must be moved until their surfaces no longer cross; 0 where they do not.

    At least `least`, then doubled; along the axes and the diagonals: more than needed, but of the right order. A
    diameter where nothing helps.
    """
    if not cross(first, second):
        return 0.0
    directions = np.array([d for d in np.ndindex(3, 3, 3) if d != (1, 1, 1)], float) - 1.0
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    distance = least
    while distance < first[0].diameter:
        for direction in directions:
            moved = first[1].copy()
            moved[:3, 3] += distance * direction
            if not cross((first[0], moved), second):
                return distance
        distance *= 2
    return first[0].diameter


def cross(first: Posed, second: Posed) -> bool:
    """Whether an edge of one object meets a face of the other."""
    return _pierces(first, second) or _pierces(second, first)


def _pierces(first: Posed, second: Posed) -> bool:
    """Whether an edge of the first meets a face of the second."""
    from open3d.core import Tensor

    vertices = transform_points(inverse(second[1]) @ first[1], first[0].vertices)
    starts, ends = (vertices[column] for column in _edges(first[0]).T)
    near = _meets_box(starts, ends, second[0])
    if not near.any():
        return False
    rays = np.concatenate([starts[near], (ends - starts)[near]], axis=1).astype(np.float32)
    return bool((_raycaster(second[0]).cast_rays(Tensor.from_numpy(rays))["t_hit"].numpy() <= 1.0).any())


def _meets_box(
    starts: Float[np.ndarray, "n 3"], ends: Float[np.ndarray, "n 3"], model: Model
) -> Bool[np.ndarray, " n"]:
    """Edges whose own boxes meet that of a model."""
    low, high = model.vertices.min(axis=0), model.vertices.max(axis=0)
    near = np.ones(len(starts), bool)
    for k in range(3):
        near &= (np.minimum(starts[:, k], ends[:, k]) < high[k]) & (np.maximum(starts[:, k], ends[:, k]) > low[k])
    return near


@per_model
def _edges(model: Model) -> Int[np.ndarray, "e 2"]:
    """Each edge once."""
    edges = np.sort(np.concatenate([model.faces[:, [0, 1]], model.faces[:, [1, 2]], model.faces[:, [2, 0]]]), axis=1)
    return np.unique(edges, axis=0)
