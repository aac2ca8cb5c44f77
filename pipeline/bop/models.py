"""Object models of a BOP dataset: mesh, diameter and symmetries as a `Model` in metres."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, UInt8

from pipeline.bop.images import read_rgb
from pipeline.bop.json_files import read_json_object
from pipeline.bop.ply import Ply, read_ply
from pipeline.exceptions import FormatError, InputError
from pipeline.scene import Model
from pipeline.symmetry import symmetry_transforms

MOST_COMPARED = 5000
"""Points of which every pair is measured to find the diameter; more are sorted out first."""


def read_model(path: Path, obj_id: int, info: Mapping[str, Any] | None = None, appearance: bool = True) -> Model:
    """Read a model file; `info` is its entry in `models_info.json` (diameter and symmetries).

    PLY files are in millimetres (BOP), GLB files in metres (glTF). Without a diameter in `info` it is computed.
    `appearance=False` leaves out colours and texture. With texture coordinates per corner, vertices on a seam
    are doubled behind the others, so that the first vertices are those of the file.
    Raises FormatError and MissingFileError that name the file.
    """
    try:
        symmetries = symmetry_transforms(info or {})
    except FormatError as error:
        raise FormatError(f"models_info.json beside {path}: object {obj_id}: {error}") from error
    ply = _read_glb(path) if path.suffix.lower() == ".glb" else read_ply(path)
    vertices = ply.vertices if path.suffix.lower() == ".glb" else ply.vertices / 1000.0
    diameter = _diameter(info or {}, path, obj_id, vertices)
    faces, uv, kept = ply.faces, ply.uv, np.arange(len(vertices))
    if appearance and ply.corner_uv is not None:
        faces, uv, kept = _split_seams(ply)
    return Model(
        obj_id=obj_id,
        vertices=vertices[kept],
        faces=faces,
        diameter=diameter,
        symmetries=symmetries,
        normals=None if ply.normals is None else _unit(ply.normals)[kept],
        colors=ply.colors[kept] if appearance and ply.colors is not None else None,
        texture=_read_texture(path, ply.texture_file) if appearance and uv is not None else None,
        texture_uv=uv if appearance else None,
    )


def read_models_info(path: Path) -> dict[int, dict[str, Any]]:
    """Entries of a `models_info.json` by object id. Raises FormatError for anything but objects by id."""
    content = read_json_object(path)
    for key, entry in content.items():
        if not key.isdecimal() or not isinstance(entry, dict):
            raise FormatError(f"{path}: entry {key!r} is not an object by its id; get the file again")
    return {int(key): entry for key, entry in content.items()}


def diameter_of(points: Float[np.ndarray, "n 3"]) -> float:
    """Largest distance between two points, exactly, in their unit."""
    from scipy.spatial import ConvexHull, QhullError
    from scipy.spatial.distance import cdist

    try:
        corners = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):  # flat or too few points have no hull
        corners = np.unique(points, axis=0)
    if len(corners) > MOST_COMPARED:
        return _diameter_of_many(corners)
    blocks = np.array_split(corners, 1 + len(corners) // 1000)  # a bound on memory
    return max(float(cdist(block, corners).max()) for block in blocks)


def _diameter_of_many(corners: Float[np.ndarray, "n 3"]) -> float:
    """Largest distance between many points, exactly, in time that hardly grows with their square.

    Every direction is within an angle of one of a grid of directions. Seen along that one, a pair at the largest
    distance spans at least its cosine times any distance that is known: only the points at both ends can be the pair.
    """
    from scipy.spatial.distance import cdist

    count = 32
    steps = (2 * np.arange(count) + 1) / count - 1
    a, b, c = (grid.ravel() for grid in np.meshgrid(steps, steps, [1.0]))
    directions = np.concatenate([np.stack(axes, axis=1) for axes in ((a, b, c), (b, c, a), (c, a, b))])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    cosine = np.cos(np.arctan(np.sqrt(2) / count))  # of half the diagonal of a cell in the middle of a side of the cube
    largest = max(
        np.linalg.norm(corners[along.argmax()] - corners[along.argmin()]) for along in _along(corners, directions)
    )
    for along in _along(corners, directions):
        low, high, reach = along.min(), along.max(), largest * cosine
        if high - low >= reach:
            ends = corners[along >= low + reach], corners[along <= high - reach]
            largest = max(largest, *(cdist(part, ends[1]).max() for part in np.array_split(ends[0], _parts(ends))))
    return float(largest)


def _along(points: np.ndarray, directions: np.ndarray) -> Iterator[np.ndarray]:
    """Coordinates of points along each direction."""
    for block in np.array_split(directions, 1 + len(directions) // 16):
        yield from block @ points.T


def _parts(ends: tuple[np.ndarray, np.ndarray]) -> int:
    """In how many parts to compare two sets of points, for a bound on memory."""
    return 1 + len(ends[0]) * len(ends[1]) // 10_000_000


def _diameter(info: Mapping[str, Any], path: Path, obj_id: int, vertices: Float[np.ndarray, "v 3"]) -> float:
    given = info.get("diameter")
    if given is None:
        return diameter_of(vertices)
    if not isinstance(given, int | float) or not 0 < given < np.inf:
        raise FormatError(
            f"models_info.json beside {path}: diameter of object {obj_id} is {given!r}; expected millimetres above 0"
        )
    return given / 1000.0


def _unit(vectors: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors / np.where(lengths > 0, lengths, 1.0)


def _split_seams(ply: Ply) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faces, texture coordinates and source vertices such that every vertex has one texture coordinate."""
    assert ply.corner_uv is not None
    corners = np.column_stack([ply.faces.reshape(-1, 1), ply.corner_uv.reshape(-1, 2)])
    pairs, corner_to_pair = np.unique(corners, axis=0, return_inverse=True)
    source = pairs[:, 0].astype(np.int64)
    first = np.r_[True, source[1:] != source[:-1]] if len(source) else np.zeros(0, bool)
    count = len(ply.vertices)
    target = np.where(first, source, count + np.cumsum(~first) - 1)
    uv = np.zeros((count + int((~first).sum()), 2))
    uv[target] = pairs[:, 1:]
    faces = target[corner_to_pair.ravel()].reshape(-1, 3).astype(np.int32)
    return faces, uv, np.r_[np.arange(count), source[~first]]


def _read_texture(path: Path, name: str | None) -> UInt8[np.ndarray, "h w 3"] | None:
    """The texture image beside a model; a model whose texture is absent or damaged is shown without."""
    if name is None or Path(name).name != name:  # a name from a file must not lead elsewhere
        return None
    try:
        return read_rgb(path.with_name(name))
    except InputError:
        return None


def _read_glb(path: Path) -> Ply:
    """A binary glTF mesh (HOT3D), its parts as one, without appearance."""
    import trimesh

    try:
        mesh = trimesh.load_mesh(path, process=False)
    except Exception as error:  # the loader raises all kinds of errors on damaged files
        raise FormatError(f"{path}: is no readable glTF mesh ({type(error).__name__}); get the file again") from error
    vertices, faces = np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32)
    if not len(faces):
        raise FormatError(f"{path}: has no faces; a point cloud cannot be rendered, export a triangle mesh")
    return Ply(vertices, faces, None, None, None, None, None)
