"""A board of fiducial markers: which markers, and where their corners are (thesis sec. tless_acquisition_setup).

The board frame has its origin in the middle of the board's upper side, x to the right, y away from the reader, z up;
metres. Corners are listed as OpenCV finds them: clockwise from the upper left of the upright marker.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from pipeline.exceptions import InputError, UnknownIdError
from pipeline.geometry import inverse, transform, transform_points

SQUARENESS = 0.02
"""Sides and diagonals of a marker may differ from those of a square by this share."""
TOP = "top"
SIDES = ("south", "east", "north", "west")
"""Of the block, by where they look in the board frame: south is -y, east +x."""


@dataclass(frozen=True, eq=False)
class MarkerBoard:
    """Markers of one of OpenCV's dictionaries on the faces of a flat block.

    Raises `InputError` (`UnknownIdError` for the dictionary) where markers repeat, are not in the dictionary, or are
    no squares seen from outside.
    """

    dictionary: str
    """OpenCV's name, such as `DICT_4X4_100` or `DICT_APRILTAG_36h11`."""
    ids: tuple[int, ...]
    corner_points: Float[np.ndarray, "n 4 3"]
    """Board frame, in the order of `ids`."""
    size: tuple[float, float]
    """Width (x) and depth (y) of the upper side, in metres."""
    free: tuple[float, float] = (0.0, 0.0)
    """Width and depth of the free middle on which objects stand; zeros where there is none."""
    height: float = 0.0
    """Of the block's sides, where they bear markers; else 0."""

    def __post_init__(self) -> None:
        count = len(opencv_dictionary(self.dictionary).bytesList)
        if len(self.ids) != len(self.corner_points) or not self.ids:
            raise InputError(f"marker board: {len(self.ids)} ids for {len(self.corner_points)} markers; give one each")
        if len(set(self.ids)) != len(self.ids):
            twice = next(k for k in self.ids if self.ids.count(k) > 1)
            raise InputError(f"marker board: id {twice} appears more than once; give every marker an id of its own")
        wrong = [k for k in self.ids if not 0 <= k < count]
        if wrong:
            raise InputError(
                f"marker board: id {wrong[0]} is not in {self.dictionary}, which has ids 0 to {count - 1};"
                " take a larger dictionary or fewer markers"
            )
        if min(self.size) <= 0 or min(self.free) < 0 or self.height < 0 or (np.array(self.free) > self.size).any():
            raise InputError(
                f"marker board: size {self.size}, free middle {self.free}, height {self.height} m; give a size above 0"
                " and a free middle that is no larger"
            )
        for marker_id, corners in zip(self.ids, self.corner_points, strict=True):
            _check_square(marker_id, corners)

    def corners(self, marker_id: int) -> Float[np.ndarray, "4 3"]:
        """Corners of one marker, board frame. Raises `UnknownIdError`."""
        if marker_id not in self.ids:
            raise UnknownIdError("marker", marker_id, "the board", self.ids)
        return self.corner_points[self.ids.index(marker_id)]

    def modules(self, marker_id: int) -> Bool[np.ndarray, "m m"]:
        """Which cells of the marker are black, its border included; first row on top. Raises `UnknownIdError`."""
        if marker_id not in self.ids:
            raise UnknownIdError("marker", marker_id, "the board", self.ids)
        kind = opencv_dictionary(self.dictionary)
        return np.asarray(kind.generateImageMarker(marker_id, kind.markerSize + 2, borderBits=1)) == 0

    @property
    def faces(self) -> dict[str, Face]:
        """The sides of the block that can bear markers: `top`, and `south` and so on if the block has a height."""
        width, depth = self.size
        faces = {TOP: Face(np.eye(4), width, depth)}
        if self.height > 0:
            for k, name in enumerate(SIDES):
                out = (depth, width)[k % 2] / 2
                faces[name] = Face(_board_from_side(90.0 * k, out, self.height), self.size[k % 2], self.height)
        return faces

    def picture(self, px_per_metre: float, face: str = TOP) -> UInt8[np.ndarray, "h w"]:
        """The print of a face, black on white, seen from outside.

        Edges are right to half a pixel, and so is the size. Raises `UnknownIdError` for a face that there is not.
        """
        if face not in self.faces:
            raise UnknownIdError("face", face, "the board", self.faces)
        sheet = self.faces[face]
        image = np.full((round(sheet.height * px_per_metre), round(sheet.width * px_per_metre)), 255, np.uint8)
        for marker_id in self.ids:
            corners = transform_points(inverse(sheet.board_from_face), self.corners(marker_id))
            if np.abs(corners[:, 2]).max() < 1e-6:
                in_pixels = (corners[:, :2] * (1, -1) + (sheet.width / 2, sheet.height / 2)) * px_per_metre
                _draw(image, in_pixels, self.modules(marker_id))
        return image


@dataclass(frozen=True, eq=False)
class Face:
    """A rectangle that bears markers."""

    board_from_face: Float[np.ndarray, "4 4"]
    """Of a frame in its middle, x to the right, y up, z out of the block."""
    width: float
    """Metres, along x."""
    height: float
    """Metres, along y."""


def _board_from_side(turn_deg: float, out: float, height: float) -> Float[np.ndarray, "4 4"]:
    """Frame in the middle of an upright side: the southern one turned about z."""
    c, s = np.cos(np.radians(turn_deg)).round(15), np.sin(np.radians(turn_deg)).round(15)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]])
    south = np.array([[1, 0, 0], [0, 0, -1], [0, 1.0, 0]])
    return transform(turn @ south, turn @ np.array([0, -out, -height / 2]))


def _draw(image: np.ndarray, corners: Float[np.ndarray, "4 2"], black: Bool[np.ndarray, "m m"]) -> None:
    """Blacken the pixels whose centres lie on black cells; pixel k covers k..k+1 here."""
    low, high = np.floor(corners.min(axis=0)).astype(int), np.ceil(corners.max(axis=0)).astype(int)
    low, high = np.maximum(low, 0), np.minimum(high, image.shape[::-1])
    x, y = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5)
    sides = np.stack([corners[1] - corners[0], corners[3] - corners[0]], axis=1)
    cells = (np.stack([x, y], axis=-1) - corners[0]) @ np.linalg.inv(sides).T * len(black)
    column, row = np.floor(cells + 1e-9).astype(int).transpose(2, 0, 1)
    inside = (np.minimum(row, column) >= 0) & (np.maximum(row, column) < len(black))
    limit = len(black) - 1
    dark = inside & black[np.clip(row, 0, limit), np.clip(column, 0, limit)]
    image[low[1] : high[1], low[0] : high[0]][dark] = 0


def _check_square(marker_id: int, corners: Float[np.ndarray, "4 3"]) -> None:
    sides = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    diagonals = np.linalg.norm(corners[2:] - corners[:2], axis=1) / np.sqrt(2)
    lengths = np.concatenate([sides, diagonals])
    if not np.isfinite(corners).all() or lengths.max() <= 0 or np.ptp(lengths) > SQUARENESS * lengths.max():
        shown = ", ".join(f"{1000 * side:.4g}" for side in sides)
        raise InputError(
            f"marker board: marker {marker_id} is no square (sides of {shown} mm);"
            " list its corners clockwise from the upper left"
        )
    flat = np.ptp(corners[:, 2]) < 0.01 * lengths.max()
    if flat and np.cross(corners[1] - corners[0], corners[3] - corners[0])[2] > 0:
        raise InputError(
            f"marker board: corners of marker {marker_id} run counter-clockwise seen from above (z up);"
            " list them clockwise from the upper left"
        )


def dictionary_names() -> list[str]:
    """OpenCV's dictionaries of markers."""
    return [name for name in dir(cv2.aruco) if name.startswith("DICT_")]


@cache
def opencv_dictionary(name: str) -> Any:
    """The dictionary itself. Raises `UnknownIdError`, which lists the names."""
    if name not in dictionary_names():
        raise UnknownIdError("dictionary", name, "those of OpenCV", dictionary_names())
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
