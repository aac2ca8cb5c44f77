"""What OpenGL draws of a model: its triangles with normals, and its own colour."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float32, Int, UInt8, UInt32

from pipeline.model_cache import per_model
from pipeline.scene import Model
from pipeline.shading import GRAY, linear_from_srgb

CREASE_DEG = 40.0
"""Faces that meet at a larger angle keep their own normals, where a model brings none."""


@dataclass(frozen=True, eq=False)
class DrawnMesh:
    """Vertex rows as they are uploaded, the triangles of the model, and how to draw them."""

    rows: Float32[np.ndarray, "v 11"]
    """Position (metres), normal, linear RGB, texture coordinates (first texture row at 0)."""
    indices: UInt32[np.ndarray, "f 3"]
    texture: UInt8[np.ndarray, "h w 3"] | None
    closed: bool
    """Nothing of the inside can be seen, so that faces turned away need not be drawn."""


@per_model
def drawn_mesh(model: Model) -> DrawnMesh:
    """Prepare a model: its own normals, else smooth ones with creases; texture, else vertex colours, else gray."""
    source, indices, normals = _with_normals(model)
    uv = np.zeros((len(source), 2))
    texture = model.texture if model.colors is None and model.texture_uv is not None else None
    if texture is not None and model.texture_uv is not None:
        uv = model.texture_uv[source] * [1.0, -1.0] + [0.0, 1.0]
    colors = np.full((len(source), 3), GRAY**2.2)
    if model.colors is not None:
        colors = linear_from_srgb(model.colors[source])
    rows = np.hstack([model.vertices[source], normals, colors, uv]).astype(np.float32)
    rows, indices = _neighbours_together(rows, indices)
    return DrawnMesh(rows, indices, texture, is_closed(model))


def _neighbours_together(
    rows: Float32[np.ndarray, "v 11"], indices: Int[np.ndarray, "f 3"]
) -> tuple[Float32[np.ndarray, "n 11"], UInt32[np.ndarray, "f 3"]]:
    """Sort triangles along a space-filling (Morton) curve and vertices by first use: both are drawn faster so."""
    middles = rows[indices, :3].mean(axis=1)
    spread = np.ptp(middles, axis=0).max() + 1e-12
    bits = ((middles - middles.min(axis=0)) / spread * 1023).astype(np.int64)
    places = np.arange(10)
    code = (((bits[:, :, None] >> places) & 1) << (3 * places + np.arange(3)[:, None])).sum(axis=(1, 2))
    indices = indices[np.argsort(code, kind="stable")]
    used, first = np.unique(indices, return_index=True)
    order = used[np.argsort(first)]
    renamed = np.zeros(len(rows), np.uint32)
    renamed[order] = np.arange(len(order))
    return rows[order], renamed[indices]


def is_closed(model: Model) -> bool:
    """Whether the faces enclose a volume and look outwards: every edge is run through as often in either direction."""
    _, joined = np.unique(model.vertices, axis=0, return_inverse=True)
    faces = joined.ravel()[model.faces].astype(np.int64)
    starts, ends = faces[:, [0, 1, 2]].ravel(), faces[:, [1, 2, 0]].ravel()
    count = len(model.vertices)
    there, back = np.sort(starts * count + ends), np.sort(ends * count + starts)
    a, b, c = np.moveaxis(model.vertices[model.faces], 1, 0)
    volume = np.einsum("fk,fk->", a - model.vertices.mean(axis=0), np.cross(b - a, c - a))
    return bool(volume > 0) and np.array_equal(there, back)


def _with_normals(model: Model) -> tuple[Int[np.ndarray, "n"], Int[np.ndarray, "f 3"], np.ndarray]:
    """Source vertex of each drawn vertex, the faces in drawn vertices, and unit normals."""
    if model.normals is not None and not _flat(model.normals).any():
        return np.arange(len(model.vertices)), model.faces, model.normals
    normals = _corner_normals(model)
    keys = np.column_stack([model.faces.reshape(-1), np.rint(normals * 1e4)])
    _, first, drawn = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return model.faces.reshape(-1)[first], drawn.reshape(-1, 3), normals[first]


def _flat(normals: np.ndarray) -> Bool[np.ndarray, "n"]:
    return np.linalg.norm(normals, axis=1) < 0.5


def _corner_normals(model: Model) -> np.ndarray:
    """Normal of each corner of each face: mean of the faces about the vertex that are within the crease angle."""
    from scipy.sparse import csr_matrix

    a, b, c = np.moveaxis(model.vertices[model.faces], 1, 0)
    weighted = np.cross(b - a, c - a)  # long as the face is large
    unit = weighted / np.maximum(np.linalg.norm(weighted, axis=1, keepdims=True), 1e-30)
    _, joined = np.unique(model.vertices, axis=0, return_inverse=True)
    corner_vertex = joined.ravel()[model.faces].reshape(-1)
    corner_face = np.repeat(np.arange(len(model.faces)), 3)
    ones = np.ones(len(corner_face), np.float32)
    around = csr_matrix((ones, (corner_vertex, corner_face)), (corner_vertex.max() + 1, len(model.faces)))
    pairs = around[corner_vertex].tocoo()  # corner, each face about its vertex
    near = np.einsum("pk,pk->p", unit[corner_face[pairs.row]], unit[pairs.col]) >= np.cos(np.deg2rad(CREASE_DEG))
    chosen = csr_matrix((ones[0] * near, (pairs.row, pairs.col)), (len(corner_face), len(model.faces)))
    normals = chosen @ weighted
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(lengths > 1e-30, normals / np.maximum(lengths, 1e-30), unit[corner_face])
