"""The pose of a template at a window (thesis sec. Refinement by Particle Swarm Optimization)."""

import numpy as np
from jaxtyping import Float

from pipeline.hashmatch.templates import Templates


def rotation_to_ray(K: Float[np.ndarray, "3 3"], pixel: Float[np.ndarray, "2"]) -> Float[np.ndarray, "3 3"]:
    """R_a: the smallest rotation that brings the optical axis to the ray through a pixel (u, v)."""
    ray = np.linalg.inv(K) @ np.array([pixel[0], pixel[1], 1.0])
    x, y, z = ray / np.linalg.norm(ray)
    cross = np.array([[0, 0, x], [0, 0, y], [-x, -y, 0]])  # of the axis with the ray
    return np.eye(3) + cross + cross @ cross / (1 + z)


def pose_at_window(
    templates: Templates,
    template: int,
    K: Float[np.ndarray, "3 3"],
    center: Float[np.ndarray, "2"],
    distance: float,
) -> Float[np.ndarray, "4 4"]:
    """P_{t,w} = [R_a R_t | R_a t_t s_w], camera_from_model in metres.

    Args:
        templates: Of the object.
        template: Which one.
        K: Of the image.
        center: (u_w, v_w), pixels of the image.
        distance: Of the centroid from the camera centre, metres: |t_t| s_w (see `centroid_distance`), or better.

    """
    R_a = rotation_to_ray(K, center)
    pose = np.eye(4)
    pose[:3, :3] = R_a @ templates.rotations[template]
    pose[:3, 3] = R_a[:, 2] * distance - pose[:3, :3] @ templates.centroid
    return pose


def centroid_distance(templates: Templates, scale: float, focal_px: float) -> float:
    """Distance at which a template that matches at a scale of the image has its centroid: |t_t| s_w, metres."""
    return templates.distance * scale * focal_px / templates.focal_px
