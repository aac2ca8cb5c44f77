"""One level of the image pyramid and its windows (thesis sec. Object Detection by Template Matching)."""

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from jaxtyping import Bool, Float, Integer, UInt8

from pipeline.hashmatch.config import TEMPLATE_SIZE
from pipeline.hashmatch.objectness import edgel_counts
from pipeline.hashmatch.views import CENTER

_FAR = np.finfo(np.float32).max


@dataclass(frozen=True, eq=False)
class Level:
    """One level of the pyramid, all its maps with a border of `overhang` empty pixels."""

    index: int
    """0 is the image as it is, larger levels are positive."""
    scale: float
    """s_w."""
    size: tuple[int, int]
    """Width and height without the border."""
    overhang: int
    distance: Float[np.ndarray, "H W"]
    """Metres from the camera centre, 0 where not measured."""
    normal_bins: UInt8[np.ndarray, "H W"]
    normal_response: UInt8[np.ndarray, "H W"]
    """Bits of the normals around each pixel; none at masked pixels."""
    gradient_response: UInt8[np.ndarray, "H W"]
    hue: UInt8[np.ndarray, "H W"]
    """Hue in steps of two degrees; NONE outside the image or without colour."""
    edgel: Bool[np.ndarray, "H W"]
    masked: Bool[np.ndarray, "H W"]
    """Pixels at which the tests compare nothing."""
    neighborhood: int
    """g: side of the square around a pixel in which a matching value is sought, odd."""

    @cached_property
    def some_masked(self) -> bool:
        """Whether any pixel is masked."""
        return bool(self.masked.any())

    @cached_property
    def distance_limits(self) -> tuple[Float[np.ndarray, "H W"], Float[np.ndarray, "H W"]]:
        """Least and largest distance in the square around each pixel; where nothing is measured, _FAR and 0."""
        square = np.ones((self.neighborhood, self.neighborhood), np.uint8)
        measured = np.where(self.distance > 0, self.distance, _FAR)
        return cv2.erode(measured, square), cv2.dilate(self.distance, square)

    def windows(self, step: int) -> Integer[np.ndarray, "n 2"]:
        """First pixels (x, y) of all windows, row by row, in the maps of this level."""
        height, width = self.distance.shape
        x = np.arange(0, width - TEMPLATE_SIZE + 1, step)
        y = np.arange(0, height - TEMPLATE_SIZE + 1, step)
        grid_x, grid_y = np.meshgrid(x, y)
        return np.stack([grid_x.ravel(), grid_y.ravel()], axis=-1).astype(np.int32)

    def centers(self, windows: Integer[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
        """(u_w, v_w): centres of windows in pixels of the image itself."""
        return (windows - self.overhang + CENTER + 0.5) / self.scale - 0.5

    def edgel_counts(self, windows: Integer[np.ndarray, "n 2"]) -> Integer[np.ndarray, "n"]:
        """Edgels in each window."""
        return edgel_counts(self.edgel, windows[:, 0], windows[:, 1], TEMPLATE_SIZE)
