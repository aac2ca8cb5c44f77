"""Finding a board's markers in an image, and from them the pose of the camera (thesis sec. tless_calibration)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from pipeline.exceptions import InputError
from pipeline.geometry import project, transform, transform_points
from pipeline.scene import Camera
from pipeline.synth.boards.edge_corners import refined
from pipeline.synth.boards.marker_board import MarkerBoard, opencv_dictionary

FITS = 3
"""Least-squares fits, each to the inliers of the one before."""
LEAST_INLIERS = 0.5
"""Share of all corners."""
DRAWS = 60
"""Of three markers: with a third of them wrong, all draws hold a wrong one with a chance of 1e-9."""


class NoBoardError(InputError):
    """Too few of a board's markers are seen in an image."""


@dataclass(frozen=True, eq=False)
class Detections:
    """Markers of a board that an image shows."""

    ids: tuple[int, ...]
    pixels: Float[np.ndarray, "n 4 2"]
    """Their corners to a fraction of a pixel, in the order of the board's; pixel (0, 0) has its centre at (0, 0)."""


@dataclass(frozen=True, eq=False)
class BoardPose:
    """Where a camera stands by the markers that it sees."""

    camera_from_board: Float[np.ndarray, "4 4"]
    """Metres."""
    errors_px: Float[np.ndarray, "n 4"]
    """Distance of each detected corner from its projection."""
    inliers: Bool[np.ndarray, "n 4"]
    """Corners that the pose was fitted to."""

    @property
    def rms_px(self) -> float:
        """Root mean square over all detected corners, as the thesis states it."""
        return float(np.sqrt((self.errors_px**2).mean()))


def detect(image: UInt8[np.ndarray, "h w *rgb"], board: MarkerBoard) -> Detections:
    """The board's markers in a gray or RGB image, sorted by id; others of the dictionary are left out.

    Left out too are ids seen more than once, for at most one of them can be the board's, and markers one of whose
    corners cannot be measured well.
    """
    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    detector = cv2.aruco.ArucoDetector(opencv_dictionary(board.dictionary), parameters)
    corners, ids, _ = detector.detectMarkers(gray)
    seen = [] if ids is None else np.ravel(ids).tolist()
    known = sorted(k for k in set(seen) if k in board.ids and seen.count(k) == 1)
    rough = np.array([np.reshape(corners[seen.index(k)], (4, 2)) for k in known], np.float64).reshape(-1, 4, 2)
    pixels = refined(image, rough, opencv_dictionary(board.dictionary).markerSize + 2)
    sharp = np.isfinite(pixels).all(axis=(1, 2))
    return Detections(tuple(np.array(known, int)[sharp].tolist()), pixels[sharp])


def camera_pose(
    detections: Detections, board: MarkerBoard, camera: Camera, inlier_threshold_px: float = 2.0
) -> BoardPose:
    """PnP-RANSAC over all corners, then the non-linear least squares of the reprojection errors of the inliers.

    Raises `NoBoardError` where fewer than two markers are seen, since one alone leaves its tilt ambiguous, or where
    most of the corners fit no pose.
    """
    if len(detections.ids) < 2:
        raise NoBoardError(
            f"marker board: {len(detections.ids)} of {len(board.ids)} markers seen; at least 2 are needed"
        )
    points = np.concatenate([board.corners(k) for k in detections.ids])
    pixels = detections.pixels.reshape(-1, 2)
    pose = _roughly(points, pixels, camera, 2 * inlier_threshold_px)
    inliers = np.ones(len(points), bool)
    for _ in range(FITS):
        inliers = _errors(points, pixels, camera, pose) < inlier_threshold_px
        if inliers.mean() < LEAST_INLIERS:
            raise NoBoardError(
                f"marker board: only {inliers.sum()} of {len(points)} corners fit one pose of the camera;"
                " check the camera matrix and the board's description"
            )
        pose = _exactly(points[inliers], pixels[inliers], camera, pose)
    errors = _errors(points, pixels, camera, pose)
    return BoardPose(pose, errors.reshape(-1, 4), inliers.reshape(-1, 4))


def _roughly(points: np.ndarray, pixels: np.ndarray, camera: Camera, threshold_px: float) -> Float[np.ndarray, "4 4"]:
    """Of poses by three markers each, drawn at random, the one that most corners fit.

    OpenCV's own RANSAC begins with EPnP, which goes wrong on a board seen from above.
    """
    rng = np.random.default_rng(0)
    count = len(points) // 4
    best, most = np.eye(4), -1
    for _ in range(DRAWS):
        chosen = rng.choice(count, min(3, count), replace=False)
        corners = (4 * chosen[:, None] + np.arange(4)).ravel()
        found, turn, shift = cv2.solvePnP(points[corners], pixels[corners], camera.K, None, flags=cv2.SOLVEPNP_SQPNP)
        fitting = (_errors(points, pixels, camera, _pose(turn, shift)) < threshold_px).sum() if found else -1
        if fitting > most:
            best, most = _pose(turn, shift), fitting
    return best


def _exactly(points: np.ndarray, pixels: np.ndarray, camera: Camera, start: np.ndarray) -> Float[np.ndarray, "4 4"]:
    turn, _ = cv2.Rodrigues(start[:3, :3])
    return _pose(*cv2.solvePnPRefineLM(points, pixels, camera.K, None, turn, start[:3, 3:].copy()))


def _pose(turn: np.ndarray, shift: np.ndarray) -> Float[np.ndarray, "4 4"]:
    return transform(np.asarray(cv2.Rodrigues(turn)[0]), np.ravel(shift))


def _errors(points: np.ndarray, pixels: np.ndarray, camera: Camera, pose: np.ndarray) -> Float[np.ndarray, " n"]:
    return np.linalg.norm(project(camera.K, transform_points(pose, points)) - pixels, axis=1)
