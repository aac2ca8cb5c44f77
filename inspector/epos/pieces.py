"""The model's surface cut along the borders of its fragments, so that each piece can have a colour of its own."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pipeline.epos.fragments import nearest_center
from pipeline.scene import Model

MOST_FACES = 90_000
"""Faces from which borders are cut no finer, because the browser gets all of them."""
SPACING = 1 / 60
"""How exactly borders are cut, in diameters."""


class Pieces(NamedTuple):
    """A mesh whose every face lies in one fragment, in the model frame; no vertex is shared between fragments."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    fragment_of_vertex: Int[np.ndarray, "v"]


def cut(model: Model, centers: Float[np.ndarray, "n 3"]) -> Pieces:
    """Cut the surface where the nearest centre changes; kept for the models seen last."""
    return _cut(model, np.ascontiguousarray(centers, np.float64).tobytes())


@lru_cache(maxsize=8)
def _cut(model: Model, centers_bytes: bytes) -> Pieces:
    from trimesh.remesh import subdivide

    centers = np.frombuffer(centers_bytes).reshape(-1, 3)
    vertices, faces = model.vertices, model.faces.astype(np.int64)
    done: list[np.ndarray] = []
    longest_allowed = SPACING * model.diameter
    while len(faces) and sum(map(len, done)) + len(faces) < MOST_FACES:
        corners = vertices[faces]
        ids = nearest_center(centers, vertices)[faces]
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        crossed = (np.ptp(ids, axis=1) > 0) & (longest > longest_allowed)
        done.append(corners[~crossed])
        used, faces = np.unique(faces[crossed], return_inverse=True)
        vertices, faces = (
            subdivide(vertices[used], faces.reshape(-1, 3))[:2] if len(used) else (vertices, faces.reshape(-1, 3))
        )
    corners = np.concatenate([*done, vertices[faces]])
    return _joined(corners, nearest_center(centers, corners.mean(axis=1)))


def _joined(corners: Float[np.ndarray, "f 3 3"], ids: Int[np.ndarray, "f"]) -> Pieces:
    """Faces with shared vertices within each fragment."""
    named = np.column_stack([corners.reshape(-1, 3).round(7), ids.repeat(3)])
    unique, inverse = np.unique(named, axis=0, return_inverse=True)
    return Pieces(unique[:, :3], inverse.reshape(-1, 3), unique[:, 3].astype(np.int64))
