"""Calibration patterns and their corners in images: checkerboards and ChArUco boards."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from pipeline.exceptions import InputError
from pipeline.synth.boards.marker_board import opencv_dictionary

FEWEST_CORNERS = 6


@dataclass(frozen=True, eq=False)
class PatternView:
    """Corners of a pattern in one image."""

    points: Float[np.ndarray, "n 3"]
    """On the pattern (z = 0), metres."""
    pixels: Float[np.ndarray, "n 2"]


@runtime_checkable
class Pattern(Protocol):
    """What is held before the camera."""

    def find(self, gray: UInt8[np.ndarray, "h w"]) -> PatternView | None:
        """Its corners to a fraction of a pixel; None where it is not seen."""
        ...


@dataclass(frozen=True)
class Checkerboard:
    """A plain checkerboard, which must be seen as a whole. Raises InputError for sizes that make no sense."""

    columns: int
    """Inner corners along a row: one less than squares."""
    rows: int
    square: float
    """Side of a square, metres."""

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 3 or self.square <= 0:
            raise InputError(
                f"checkerboard of {self.columns} x {self.rows} inner corners, squares of {self.square:g} m:"
                " give 3 or more both ways, and a side above 0"
            )

    def find(self, gray: UInt8[np.ndarray, "h w"]) -> PatternView | None:
        """See `Pattern`."""
        flags = cv2.CALIB_CB_ACCURACY | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
        found, corners = cv2.findChessboardCornersSB(gray, (self.columns, self.rows), flags=flags)
        if not found:
            return None
        y, x = np.divmod(np.arange(self.columns * self.rows), self.columns)
        points = np.stack([x, y, np.zeros_like(x)], axis=-1) * self.square
        return PatternView(points, corners.reshape(-1, 2).astype(float))


@dataclass(frozen=True)
class CharucoBoard:
    """A checkerboard with markers in its white squares; a part of it is enough. Raises InputError for wrong sizes."""

    columns: int
    """Squares along a row."""
    rows: int
    square: float
    """Side of a square, metres."""
    marker: float
    """Side of a marker, metres."""
    dictionary: str
    """OpenCV's name, such as `DICT_4X4_50`."""

    def __post_init__(self) -> None:
        if min(self.columns, self.rows) < 3 or not 0 < self.marker < self.square:
            raise InputError(
                f"ChArUco board of {self.columns} x {self.rows} squares of {self.square:g} m with markers of"
                f" {self.marker:g} m: give 3 or more both ways, and markers smaller than the squares"
            )
        opencv_dictionary(self.dictionary)

    def find(self, gray: UInt8[np.ndarray, "h w"]) -> PatternView | None:
        """See `Pattern`."""
        size = (self.columns, self.rows)
        board = cv2.aruco.CharucoBoard(size, self.square, self.marker, opencv_dictionary(self.dictionary))
        corners, ids, _, _ = cv2.aruco.CharucoDetector(board).detectBoard(gray)
        if ids is None or len(ids) < FEWEST_CORNERS:
            return None
        points = np.array(board.getChessboardCorners(), dtype=np.float64)[np.asarray(ids, int).ravel()]
        straight = min(len(np.unique(points[:, k].round(9))) for k in (0, 1)) < 2
        return None if straight else PatternView(points, np.reshape(corners, (-1, 2)).astype(float))
