"""Orientations at which templates are rendered (thesis sec. Experimental Evaluation, "Templates and Parameters")."""

import numpy as np
from jaxtyping import Float

from pipeline.hashmatch.config import HashMatchConfig
from pipeline.scene import Model


def view_rotations(config: HashMatchConfig) -> Float[np.ndarray, "n 3 3"]:
    """Rotations camera_from_model without in-plane rotation: the camera's y axis points down along the model's z.

    Elevations are the middles of rings of `angle_step_deg`, which covers the pole evenly. The hemisphere has equally
    many views in each ring (36 x 9 at 10 degrees, as in the thesis); on the full sphere the rings near the poles have
    fewer, as many as their length needs.
    """
    step = config.angle_step_deg
    lowest = 0 if config.views == "hemisphere" else -90
    rotations = []
    for elevation in np.arange(lowest + step / 2, 90, step):
        count = round(360 / step)
        if config.views == "sphere":
            count = max(1, round(count * np.cos(np.deg2rad(elevation))))
        rotations += [_looking_from(azimuth, elevation) for azimuth in np.arange(count) * (360 / count)]
    return np.array(rotations)


def in_plane_angles(config: HashMatchConfig) -> Float[np.ndarray, "k"]:
    """Rotations about the optical axis, radians."""
    step, limit = config.angle_step_deg, config.in_plane_limit_deg
    angles = np.arange(-limit, limit + 1, step) if config.in_plane == "limited" else np.arange(0, 360, step)
    return np.deg2rad(angles.astype(float))


def without_symmetric(
    rotations: Float[np.ndarray, "n 3 3"], model: Model, step_deg: float
) -> Float[np.ndarray, "m 3 3"]:
    """Leave out each view whose direction a symmetry brings nearer than half a step to that of a view kept."""
    directions = -rotations[:, 2]  # to the camera, model frame
    kept: list[int] = []
    for i, direction in enumerate(directions):
        images = model.symmetries[1:, :3, :3] @ direction
        if not kept or not len(images) or (images @ directions[kept].T).max() < np.cos(np.deg2rad(step_deg / 2)):
            kept.append(i)
    return rotations[kept]


def about_axis(angle: float) -> Float[np.ndarray, "3 3"]:
    """Rotation about the optical axis by an angle in radians (x to y)."""
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1]])


def _looking_from(azimuth_deg: float, elevation_deg: float) -> np.ndarray:
    azimuth, elevation = np.deg2rad([azimuth_deg, elevation_deg])
    forward = -np.array([np.cos(azimuth) * np.cos(elevation), np.sin(azimuth) * np.cos(elevation), np.sin(elevation)])
    right = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.stack([right, np.cross(forward, right), forward])
