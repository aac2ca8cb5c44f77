"""What the tests of fitting share: slow, obviously right references, and correspondences with known answers."""

import numpy as np

from pipeline.bop import errors
from pipeline.epos.fitting.correspondences import PotentialCorrespondences, correspondences_of_pixels
from pipeline.epos.fitting.results import Fitting
from pipeline.epos.fitting.synthetic import K, MadeScene
from pipeline.geometry import project, transform, transform_points

TAU = 4.0


def random_pose(rng: np.random.Generator, distance: float = 0.5) -> np.ndarray:
    """A pose in view of the camera."""
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    rotation *= np.linalg.det(rotation)
    return transform(rotation, np.array([*rng.uniform(-0.05, 0.05, 2), distance]))


def exact_correspondences(
    rng: np.random.Generator, pose: np.ndarray, count: int = 60, flat: bool = False
) -> PotentialCorrespondences:
    """One true point at each pixel, no noise; on a plane if asked for."""
    points = rng.uniform(-0.05, 0.05, (count, 3))
    points[:, 2] *= not flat
    return correspondences_of_pixels(1, project(K, transform_points(pose, points)), points, np.ones(count))


def reprojection_errors(c: PotentialCorrespondences, pose: np.ndarray) -> np.ndarray:
    """Re-projection error of each correspondence, pixels; infinite behind the camera."""
    points = transform_points(pose, c.points_in_model)
    off = np.linalg.norm(project(K, points) - c.pixels, axis=1)
    return np.where(points[:, 2] > 0, off, np.inf)


def slow_quality(c: PotentialCorrespondences, pose: np.ndarray, known: tuple[np.ndarray, ...] = ()) -> float:
    """The thesis's q, pixel by pixel (eq. pose_quality_single; with known poses eq. pose_quality_multi)."""
    error = reprojection_errors(c, pose)
    by_others = np.min([np.full(len(c), np.inf), *(reprojection_errors(c, other) for other in known)], axis=0)
    total = 0.0
    pixels = sorted(set(c.pixel_ids.tolist()))
    for pixel in pixels:
        candidates = np.flatnonzero(c.pixel_ids == pixel)
        total += max(max(0.0, min(1 - error[i] ** 2 / TAU**2, by_others[i] ** 2 / TAU**2)) for i in candidates)
    return total / len(pixels)


def right_instances(scene: MadeScene, fitting: Fitting, limit_px: float = 5.0) -> list[int]:
    """Instances that some pose is right for (MSPD, modulo symmetry), each pose counting once."""
    free = list(range(len(scene.camera_from_model)))
    for pose in fitting.poses:
        off = [errors.mspd(scene.model, K, pose.camera_from_model, scene.camera_from_model[k]).value for k in free]
        if off and min(off) < limit_px:
            del free[int(np.argmin(off))]
    return [k for k in range(len(scene.camera_from_model)) if k not in free]
