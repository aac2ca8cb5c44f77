"""Pinhole geometry in the OpenCV camera frame (x right, y down, z forward); pixel (0, 0) has its centre at (0, 0).

Transforms are 4x4 arrays named by their frames, `camera_from_model` maps model coordinates to camera
coordinates, so that in a product adjacent frames match: `world_from_camera @ camera_from_model`.
Rotations are kept as given: ground truth of some datasets is not orthonormal, and evaluation must not repair it.
"""

import numpy as np
from jaxtyping import Bool, Float


def transform(rotation: Float[np.ndarray, "3 3"], translation: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """Put a rotation (taken as it is) and a translation into one 4x4 float64 transform."""
    b_from_a = np.eye(4)
    b_from_a[:3, :3] = rotation
    b_from_a[:3, 3] = translation
    return b_from_a


def inverse(b_from_a: Float[np.ndarray, "*n 4 4"]) -> Float[np.ndarray, "*n 4 4"]:
    """Invert affine 4x4 transforms by the true inverse of their 3x3 part (never by its transpose)."""
    a_from_b = np.zeros_like(b_from_a)
    linear = np.linalg.inv(b_from_a[..., :3, :3])
    a_from_b[..., :3, :3] = linear
    a_from_b[..., :3, 3] = -np.einsum("...ij,...j->...i", linear, b_from_a[..., :3, 3])
    a_from_b[..., 3, 3] = 1.0
    return a_from_b


def transform_points(
    b_from_a: Float[np.ndarray, "4 4"], points_in_a: Float[np.ndarray, "*n 3"]
) -> Float[np.ndarray, "*n 3"]:
    """Map points from frame a to frame b."""
    return points_in_a @ b_from_a[:3, :3].T + b_from_a[:3, 3]


def project(K: Float[np.ndarray, "3 3"], points_in_camera: Float[np.ndarray, "*n 3"]) -> Float[np.ndarray, "*n 2"]:
    """Project points in the camera frame to pixels (u, v); points at z = 0 give infinities, not errors."""
    with np.errstate(divide="ignore", invalid="ignore"):
        homogeneous = points_in_camera @ K.T
        return homogeneous[..., :2] / homogeneous[..., 2:]


def unproject(
    K: Float[np.ndarray, "3 3"], pixels: Float[np.ndarray, "*n 2"], depth: Float[np.ndarray, "*n"]
) -> Float[np.ndarray, "*n 3"]:
    """Points in the camera frame of pixels (u, v) at the given depth (z, in the unit of the result)."""
    homogeneous = np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1)
    return homogeneous @ np.linalg.inv(K).T * depth[..., None]


def points_from_depth(
    K: Float[np.ndarray, "3 3"], depth: Float[np.ndarray, "h w"]
) -> tuple[Float[np.ndarray, "n 3"], Bool[np.ndarray, "h w"]]:
    """All measured points of a depth image in the camera frame, row by row, and the mask of their pixels."""
    measured = depth > 0
    v, u = np.nonzero(measured)
    return unproject(K, np.stack([u, v], axis=-1).astype(float), depth[measured].astype(float)), measured


def distance_from_depth(K: Float[np.ndarray, "3 3"], depth: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "h w"]:
    """Distance of each pixel's point from the camera centre (thesis sec. bop_vsd, D from depth), 0 where depth is 0.

    Integer pixel coordinates are pixel centres and the result is float64, as in the benchmark's own scripts.
    """
    v, u = np.indices(depth.shape)
    z = depth.astype(np.float64)
    return np.sqrt(((u - K[0, 2]) / K[0, 0] * z) ** 2 + ((v - K[1, 2]) / K[1, 1] * z) ** 2 + z**2)


def rotation_error(R_a: Float[np.ndarray, "3 3"], R_b: Float[np.ndarray, "3 3"]) -> float:
    """Angle in radians, 0..pi, of the rotation between two rotation matrices."""
    cosine = (np.trace(R_a @ np.linalg.inv(R_b)) - 1.0) / 2.0
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))
