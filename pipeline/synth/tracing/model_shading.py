"""How an object model is shaded: its own normals, or smooth ones with sharp edges where it has none."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int, UInt8

from pipeline.model_cache import per_model
from pipeline.scene import Model

CREASE_DEG = 40.0
"""Edges with a larger angle between their faces stay sharp."""


@dataclass(frozen=True, eq=False)
class Shaded:
    """A triangle mesh with all that its look depends on."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "v 3"] | None = None
    uv: Float[np.ndarray, "v 2"] | None = None
    colors: UInt8[np.ndarray, "v 3"] | None = None


@per_model
def shaded(model: Model) -> Shaded:
    """The model's mesh with normals; a model without gets them, and its corners are then separate vertices."""
    if model.normals is not None and np.isfinite(model.normals).all() and np.abs(model.normals).any(axis=1).all():
        return Shaded(model.vertices, model.faces, model.normals, model.texture_uv, model.colors)
    corners = model.faces.ravel()
    faces = np.arange(len(corners), dtype=np.int32).reshape(-1, 3)
    uv = None if model.texture_uv is None else model.texture_uv[corners]
    colors = None if model.colors is None else model.colors[corners]
    return Shaded(model.vertices[corners], faces, crease_normals(model.vertices, model.faces), uv, colors)


def crease_normals(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], crease_deg: float = CREASE_DEG
) -> Float[np.ndarray, "c 3"]:
    """Unit normal of each corner (three per face): the mean, by area, of the faces about it that meet it smoothly."""
    from scipy.sparse import csr_matrix

    a, b, c = (vertices[faces[:, k]] for k in range(3))
    area_normals = np.cross(b - a, c - a)
    unit = area_normals / (np.linalg.norm(area_normals, axis=1, keepdims=True) + 1e-300)
    _, joined = np.unique(np.round(vertices, 9), axis=0, return_inverse=True)  # repeated vertices are one corner
    corner_of = joined.ravel()[faces].ravel()
    face_of = np.repeat(np.arange(len(faces)), 3)
    at_vertex = csr_matrix((np.ones(len(corner_of)), (corner_of, face_of)), shape=(len(vertices), len(faces)))
    about = at_vertex[corner_of].tocoo()  # rows: corners; columns: faces that share the corner's vertex
    smooth = np.einsum("ij,ij->i", unit[face_of[about.row]], unit[about.col]) > np.cos(np.radians(crease_deg))
    normals = np.zeros((len(corner_of), 3))
    np.add.at(normals, about.row[smooth], area_normals[about.col[smooth]])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(lengths > 0, normals / np.maximum(lengths, 1e-300), (0.0, 0.0, 1.0))
