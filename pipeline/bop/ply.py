"""Reading PLY meshes: ASCII and binary, with normals, colours and texture coordinates, vertices in the file's order.

A reader of our own because it takes a fraction of the time of a general one, whose import alone costs more than
reading all models of a dataset (measured in `benchmarks/dataset_index.py`).
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float, Int, UInt8

from pipeline.bop.json_files import read_bytes
from pipeline.bop.ply_rows import AsciiRows, BadPlyError, BinaryRows, Table, read_header, read_table
from pipeline.exceptions import FormatError

_UV_NAMES = (("texture_u", "texture_v"), ("s", "t"), ("u", "v"))


@dataclass(frozen=True, eq=False)
class Ply:
    """A triangle mesh as its file has it, in the file's unit."""

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "v 3"] | None
    colors: UInt8[np.ndarray, "v 3"] | None
    uv: Float[np.ndarray, "v 2"] | None
    """Texture coordinates of the vertices."""
    corner_uv: Float[np.ndarray, "f 3 2"] | None
    """Texture coordinates of the faces' corners ("wedges")."""
    texture_file: str | None
    """Name of the texture image beside the file."""


def read_ply(path: Path) -> Ply:
    """Read a PLY file; polygons become fans of triangles.

    Raises MissingFileError if it cannot be read and FormatError if it is no PLY, is cut off or has no faces.
    """
    try:
        return _parse(read_bytes(path))
    except BadPlyError as error:
        raise FormatError(f"{path}: {error}") from error


def _parse(data: bytes) -> Ply:
    header, body = read_header(data)
    source = BinaryRows(body, header.order) if header.order else AsciiRows(body)
    tables = {element.name: read_table(source, element) for element in header.elements if element.properties}
    vertices = _columns(tables.get("vertex", []), "x", "y", "z")
    if vertices is None or not len(vertices):
        raise BadPlyError("has no vertices; export the mesh again")
    if not np.isfinite(vertices).all():
        raise BadPlyError("has a vertex that is NaN or infinite; export the mesh again")
    faces, corner_uv = _triangles(tables.get("face", []), len(vertices))
    uv = (_columns(tables["vertex"], *names) for names in _UV_NAMES)
    return Ply(
        vertices=vertices,
        faces=faces,
        normals=_columns(tables["vertex"], "nx", "ny", "nz"),
        colors=_colors(tables["vertex"]),
        uv=next((columns for columns in uv if columns is not None), None),
        corner_uv=corner_uv,
        texture_file=header.texture_file,
    )


def _columns(tables: list[Table], *names: str) -> Float[np.ndarray, "n k"] | None:
    """Columns of all runs side by side as float64, None if one is missing."""
    if not tables or any(name not in tables[0] for name in names):
        return None
    with np.errstate(invalid="ignore"):  # a damaged file may hold signalling NaNs
        return np.concatenate(
            [np.stack([table[name] for name in names], axis=1).astype(np.float64) for table in tables]
        )


def _colors(vertices: list[Table]) -> UInt8[np.ndarray, "v 3"] | None:
    colors = _columns(vertices, "red", "green", "blue")
    return None if colors is None else np.clip(colors, 0, 255).astype(np.uint8)


def _triangles(
    tables: list[Table], vertex_count: int
) -> tuple[Int[np.ndarray, "f 3"], Float[np.ndarray, "f 3 2"] | None]:
    """Faces as triangles, and the texture coordinates of their corners if the file has them."""
    faces, corners = [], []
    for table in tables:
        polygons = table.get("vertex_indices", table.get("vertex_index"))
        if polygons is None or polygons.shape[1] < 3:
            continue
        fan = _fan(polygons.shape[1])
        faces.append(polygons[:, fan].reshape(-1, 3))
        uv = table.get("texcoord")
        if uv is not None and uv.shape[1] == 2 * polygons.shape[1]:
            corners.append(uv.reshape(len(uv), -1, 2)[:, fan].reshape(-1, 3, 2))
    if not faces or not any(map(len, faces)):
        raise BadPlyError("has no faces; a point cloud cannot be rendered, export a triangle mesh")
    triangles = np.concatenate(faces).astype(np.int64)
    if triangles.min() < 0 or triangles.max() >= vertex_count:
        worst = triangles.max() if triangles.max() >= vertex_count else triangles.min()
        raise BadPlyError(f"a face names vertex {worst} of {vertex_count}; export the mesh again")
    corner_uv = np.concatenate(corners).astype(np.float64) if corners else None
    complete = corner_uv is not None and len(corner_uv) == len(triangles)
    return triangles.astype(np.int32), corner_uv if complete else None


def _fan(corners: int) -> list[list[int]]:
    """Corner numbers of the triangles that a polygon is cut into."""
    return [[0, i, i + 1] for i in range(1, corners - 1)]
