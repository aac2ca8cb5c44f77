"""Surface fragments of an object (thesis sec. epos_fragments)."""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pipeline.exceptions import InputError
from pipeline.scene import Model

DEFAULT_COUNT = 64
"""n of the thesis."""

_SPACING = 1 / 100
"""How exactly the sizes of fragments are measured, in diagonals of the model's bounding box."""


class Located(NamedTuple):
    """Surface points in terms of fragments."""

    fragment_ids: Int[np.ndarray, "k"]
    coordinates: Float[np.ndarray, "k 3"]
    """3D fragment coordinates r = (x - g) / h."""


@dataclass(frozen=True, eq=False)
class Fragments:
    """How the surface of an object is split: a point belongs to the fragment whose centre is nearest."""

    centers: Float[np.ndarray, "n 3"]
    """g, metres, model frame; vertices of the model."""
    sizes: Float[np.ndarray, "n"]
    """h, metres: longest side of the fragment's axis-aligned bounding box in the model frame."""

    def __len__(self) -> int:
        return len(self.sizes)

    def locate(self, points_in_model: Float[np.ndarray, "k 3"]) -> Located:
        """Fragment and 3D fragment coordinates of surface points, metres."""
        ids = nearest_center(self.centers, points_in_model)
        return Located(ids, (points_in_model - self.centers[ids]) / self.sizes[ids, None])

    def points(
        self, fragment_ids: Int[np.ndarray, "k"], coordinates: Float[np.ndarray, "k 3"]
    ) -> Float[np.ndarray, "k 3"]:
        """Points x = h r + g in the model frame, metres (thesis sec. epos_establish_coords)."""
        return self.sizes[fragment_ids, None] * coordinates + self.centers[fragment_ids]


def fragments_of(model: Model, count: int = DEFAULT_COUNT) -> Fragments:
    """Split a model into fragments; the same vertices, faces and count are computed once.

    Centres are vertices, found by farthest-point sampling from the mean of the vertices, which is then dropped. A model
    with fewer different vertices than that gets more along its edges.

    Raises:
        InputError: the count is below 1, the model has no faces or is a point, or its vertices are not finite.

    """
    name = f"object {model.obj_id}"
    if count < 1:
        raise InputError(f"{name}: {count} fragments; expected 1 or more")
    if not len(model.faces):
        raise InputError(f"{name}: the model has no faces, so there is no surface to split; get a mesh")
    if not np.isfinite(model.vertices).all():
        raise InputError(f"{name}: the model has vertices that are not finite; mend the mesh")
    if np.ptp(model.vertices[model.faces].reshape(-1, 3), axis=0).max() == 0:
        raise InputError(f"{name}: all vertices are in one place; mend the mesh")
    vertices = np.ascontiguousarray(model.vertices, np.float64)
    faces = np.ascontiguousarray(model.faces, np.int64)
    return _computed(vertices.tobytes(), faces.tobytes(), count)


def nearest_center(centers: Float[np.ndarray, "n 3"], points: Float[np.ndarray, "k 3"]) -> Int[np.ndarray, "k"]:
    """Index of the centre that is nearest to each point."""
    from scipy.spatial import KDTree

    return KDTree(centers).query(points)[1].astype(np.int64).reshape(-1)


def farthest_points(points: Float[np.ndarray, "v 3"], count: int) -> Int[np.ndarray, "n"]:
    """Choose points one by one, each the farthest from those already chosen and from the mean of all.

    Of points equally far the first is taken; there must be as many different ones.
    """
    distances = _squared_distances(points, points.mean(axis=0))
    chosen = np.empty(count, np.int64)
    for i in range(count):
        chosen[i] = np.argmax(distances)
        np.minimum(distances, _squared_distances(points, points[chosen[i]]), out=distances)
    return chosen


def _squared_distances(points: Float[np.ndarray, "v 3"], point: Float[np.ndarray, "3"]) -> Float[np.ndarray, "v"]:
    return np.square(points - point).sum(axis=1)


@lru_cache(maxsize=256)
def _computed(vertices_bytes: bytes, faces_bytes: bytes, count: int) -> Fragments:
    """Work on the content of the arrays, which is the key of the cache."""
    vertices = np.frombuffer(vertices_bytes).reshape(-1, 3)
    faces = np.frombuffer(faces_bytes, np.int64).reshape(-1, 3)
    vertices = vertices[np.unique(faces)]  # a vertex of no face is not on the surface
    faces = np.unique(faces, return_inverse=True)[1].reshape(-1, 3)
    candidates = _at_least(vertices, faces, count)
    centers = candidates[farthest_points(candidates, count)]
    sizes = _sizes(centers, vertices, faces)
    centers.flags.writeable = sizes.flags.writeable = False  # shared by all who ask
    return Fragments(centers, sizes)


def _at_least(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], count: int
) -> Float[np.ndarray, "w 3"]:
    """The vertices, with points between them where fewer than `count` are different."""
    from trimesh.remesh import subdivide

    points = vertices
    while len(np.unique(points, axis=0)) < count:
        points, faces = subdivide(points, faces)[:2]
    return points


def _sizes(
    centers: Float[np.ndarray, "n 3"], vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"]
) -> Float[np.ndarray, "n"]:
    """Longest side of each fragment's bounding box.

    Fragments are cut out by convex cells: a face with its corners in one of them is all in it, and only the others are
    divided further.
    """
    from trimesh.remesh import subdivide

    spacing = _SPACING * float(np.linalg.norm(np.ptp(vertices, axis=0)))
    lowest, highest = centers.copy(), centers.copy()
    while len(faces):
        ids = nearest_center(centers, vertices)
        np.minimum.at(lowest, ids, vertices)
        np.maximum.at(highest, ids, vertices)
        corners = vertices[faces]
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        faces = faces[(np.ptp(ids[faces], axis=1) > 0) & (longest > spacing)]
        used, faces = np.unique(faces, return_inverse=True)
        vertices, faces = subdivide(vertices[used], faces.reshape(-1, 3))[:2] if len(used) else (vertices, faces)
    return np.maximum((highest - lowest).max(axis=1), spacing)  # never 0: one divides by it
