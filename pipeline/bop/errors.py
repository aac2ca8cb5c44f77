"""Pose errors of an estimate against a ground-truth pose (thesis secs. bop_mssd, bop_mspd, rel_eval; definitions as in BOP).

Poses are 4x4 `camera_from_model`, rotations as submitted or annotated. Lengths have the unit of the model and
the translations (metres in this program). A pose that is not finite has infinite error. VSD is in `pipeline.bop.vsd` and is handed on from here.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pipeline import geometry
from pipeline.bop.vsd import Vsd, vsd, vsd_of_poses
from pipeline.model_cache import convex_hull, per_model
from pipeline.scene import Model

__all__ = [
    "Mspd",
    "Mssd",
    "Vsd",
    "add",
    "adi",
    "mspd",
    "mssd",
    "rotation_error",
    "sphere_projections_overlap",
    "spheres_overlap",
    "translation_error",
    "vsd",
    "vsd_of_poses",
]

Pose = Float[np.ndarray, "4 4"]


class Mssd(NamedTuple):
    """Maximum symmetry-aware surface distance and where it is reached."""

    value: float
    """In the unit of the model; infinite for poses that are not finite."""
    vertex: int
    """Row of `model.vertices` that is farthest off; -1 where the value is infinite."""
    symmetry: int
    """Row of `model.symmetries` that brings the ground truth nearest to the estimate; -1 where the value is infinite."""


class Mspd(NamedTuple):
    """Maximum symmetry-aware projection distance and where it is reached."""

    value: float
    """Pixels; infinite for poses that are not finite or put a vertex at z = 0."""
    vertex: int
    """Row of `model.vertices` whose projection is farthest off; -1 where the value is infinite."""
    symmetry: int
    """Row of `model.symmetries` that brings the ground truth nearest to the estimate; -1 where the value is infinite."""


class _Prepared(NamedTuple):
    """A model's arrays as the compiled loops want them."""

    vertices: Float[np.ndarray, "3 v"]
    hull: Float[np.ndarray, "3 h"]
    hull_ids: Int[np.ndarray, "h"]
    symmetries: Float[np.ndarray, "s 4 4"]


@per_model
def _prepared(model: Model) -> _Prepared:
    vertices = np.array(model.vertices.T, dtype=np.float64, order="C")
    hull_ids = convex_hull(model)
    symmetries = np.array(model.symmetries, dtype=np.float64, order="C")
    return _Prepared(vertices, np.ascontiguousarray(vertices[:, hull_ids]), hull_ids, symmetries)


_NO_LENS = np.eye(3, 4)


def mssd(model: Model, estimate: Pose, ground_truth: Pose) -> Mssd:
    """Maximum symmetry-aware surface distance (thesis eq. e_MSSD).

    Only vertices of the convex hull are looked at, which is exact: the distance is a convex function of the vertex.
    BOP's scripts take it for infinite where the bounding spheres do not overlap: see `spheres_overlap`.
    """
    from pipeline.bop.point_distances import max_distance

    prepared = _prepared(model)
    poses = np.array((estimate, ground_truth), dtype=np.float64)
    value, row, symmetry = max_distance(prepared.hull, poses, prepared.symmetries, _NO_LENS, False)
    return Mssd(value, int(prepared.hull_ids[row]) if row >= 0 else -1, symmetry)


def mspd(model: Model, K: Float[np.ndarray, "3 3"], estimate: Pose, ground_truth: Pose) -> Mspd:
    """Maximum symmetry-aware projection distance (thesis eq. e_MSPD), in pixels of the image itself.

    BOP multiplies it by 640 / image width before comparing it with its thresholds.
    """
    from pipeline.bop.point_distances import max_distance

    prepared = _prepared(model)
    poses = np.array((estimate, ground_truth), dtype=np.float64)
    lens = np.zeros((3, 4))
    lens[:, :3] = K
    return Mspd(*max_distance(prepared.vertices, poses, prepared.symmetries, lens, True))


def add(model: Model, estimate: Pose, ground_truth: Pose) -> float:
    """Average distance of corresponding vertices, for objects without indistinguishable views (thesis sec. rel_eval)."""
    from pipeline.bop.point_distances import mean_distance

    value = mean_distance(_prepared(model).vertices, np.array((estimate, ground_truth), dtype=np.float64))
    return value if np.isfinite(value) else np.inf


def adi(model: Model, estimate: Pose, ground_truth: Pose) -> float:
    """Average distance of ground-truth vertices to the closest vertex at the estimate (thesis sec. rel_eval, eq. e_ADI)."""
    if not (np.isfinite(estimate).all() and np.isfinite(ground_truth).all()):
        return np.inf
    at_estimate = geometry.transform_points(estimate, model.vertices)
    at_truth = geometry.transform_points(ground_truth, model.vertices)
    if np.allclose(estimate[:3, :3] @ estimate[:3, :3].T, np.eye(3), atol=1e-5):
        # A rotation keeps distances, so the closest vertex can be looked up in the model frame, in a tree built once.
        in_estimate_frame = geometry.transform_points(geometry.inverse(estimate), at_truth)
        closest = _vertex_tree(model).query(in_estimate_frame)[1]
        return float(np.linalg.norm(at_truth - at_estimate[closest], axis=1).mean())
    from scipy.spatial import KDTree

    return float(KDTree(at_estimate).query(at_truth)[0].mean())


@per_model
def _vertex_tree(model: Model) -> Any:
    from scipy.spatial import KDTree

    return KDTree(model.vertices, leafsize=32)  # fastest for meshes of some thousand vertices


def rotation_error(estimate: Pose, ground_truth: Pose) -> float:
    """Angle between the two rotations, radians; infinite for poses that are not finite or cannot be inverted."""
    if not (np.isfinite(estimate).all() and np.isfinite(ground_truth).all()):
        return np.inf
    try:
        return geometry.rotation_error(estimate[:3, :3], ground_truth[:3, :3])
    except np.linalg.LinAlgError:
        return np.inf


def translation_error(estimate: Pose, ground_truth: Pose) -> float:
    """Distance between the two model origins; infinite for poses that are not finite."""
    distance = float(np.linalg.norm(estimate[:3, 3] - ground_truth[:3, 3]))
    return distance if np.isfinite(distance) else np.inf


def spheres_overlap(estimate: Pose, ground_truth: Pose, diameter: float) -> bool:
    """Tell whether spheres of the object's diameter about the two origins meet.

    Where they do not, BOP's scripts take MSSD, ADD and ADI for infinite.
    """
    return translation_error(estimate, ground_truth) < diameter


def sphere_projections_overlap(estimate: Pose, ground_truth: Pose, diameter: float) -> bool:
    """Tell whether the images of those spheres meet (BOP's approximation); where they do not, VSD counts as 1."""
    a, b = estimate[:3, 3], ground_truth[:3, 3]
    if a[2] == 0 or b[2] == 0:
        return False
    return bool(np.linalg.norm(a[:2] / a[2] - b[:2] / b[2]) < diameter / 2 * (1 / a[2] + 1 / b[2]))
