"""Poses from more than three correspondences, by OpenCV (thesis tab. epos_ransac_variants).

DLS of the thesis is not among them: OpenCV answers it with EPnP. SQPnP (Terzakis & Lourakis 2020) is its like.
"""

import cv2
import numpy as np
from jaxtyping import Float

from pipeline.epos.fitting.config import Solver

_LEAST = {"epnp": 4, "sqpnp": 3}


_FLAGS = {"epnp": cv2.SOLVEPNP_EPNP, "sqpnp": cv2.SOLVEPNP_SQPNP}


def solve_pnp(
    K: Float[np.ndarray, "3 3"],
    pixels: Float[np.ndarray, "n 2"],
    points: Float[np.ndarray, "n 3"],
    solver: Solver,
) -> Float[np.ndarray, "3 4"] | None:
    """Pose of points seen at pixels; None where there are too few, or the solver fails or gives no proper pose."""
    method, _, polish = solver.partition("+")
    if len(pixels) < _LEAST[method]:
        return None
    try:
        found, turn, shift = cv2.solvePnP(points, pixels, K, None, flags=_FLAGS[method])
        if found and polish:
            turn, shift = cv2.solvePnPRefineLM(points, pixels, K, None, turn, shift)
    except cv2.error:  # degenerate points
        return None
    pose = np.hstack([cv2.Rodrigues(turn)[0], shift]) if found else None
    return pose if pose is not None and np.isfinite(pose).all() and pose[2, 3] > 0 else None


def ransac_of_opencv(
    K: Float[np.ndarray, "3 3"],
    pixels: Float[np.ndarray, "n 2"],
    points: Float[np.ndarray, "n 3"],
    tau: float,
    iterations: int,
) -> Float[np.ndarray, "3 4"] | None:
    """Pose by OpenCV's RANSAC with EPnP, all correspondences being equals; None where it finds none."""
    if len(pixels) < _LEAST["epnp"] + 1:
        return None
    settings = {"iterationsCount": iterations, "reprojectionError": tau, "confidence": 0.9999}
    try:
        found, turn, shift, _ = cv2.solvePnPRansac(points, pixels, K, None, flags=cv2.SOLVEPNP_EPNP, **settings)
    except cv2.error:
        return None
    pose = np.hstack([cv2.Rodrigues(turn)[0], shift]) if found else None
    return pose if pose is not None and np.isfinite(pose).all() and pose[2, 3] > 0 else None
