"""Colours of EPOS: fragments by the place of their centre in the model, and what is lit among them."""

from collections.abc import Callable
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from inspector.layers import ColorScale, label_colors
from pipeline.scene import Model

UNLIT = (132, 136, 144)
"""Of fragments that are not meant."""
TRIPLET = ((255, 70, 70), (70, 215, 90), (80, 150, 255))
"""Of the three correspondences that a hypothesis was computed from."""
OUTLIER = (150, 60, 110)
HYPOTHESIS = (255, 140, 255)
BEFORE = (235, 225, 170)
"""Of the hypothesis before its local optimization."""
RESIDUAL_LIMIT = 2.0
"""Residuals are coloured up to this many tau_r."""


class Extent(NamedTuple):
    """The axis-aligned box of a model, metres."""

    low: Float[np.ndarray, "3"]
    high: Float[np.ndarray, "3"]

    def colors(self, points: Float[np.ndarray, "*n 3"]) -> UInt8[np.ndarray, "*n 3"]:
        """Colours of points by their place in the box: x is red, y green, z blue (thesis fig. epos_teaser)."""
        size = np.maximum(self.high - self.low, 1e-9)
        share = np.clip(np.nan_to_num((points - self.low) / size), 0, 1)
        return (25 + 230 * share).astype(np.uint8)

    def scales(self, of: str) -> tuple[ColorScale, ...]:
        """What the three channels mean, for the legend."""
        ends = np.eye(3) * 230 + 25
        return tuple(
            ColorScale(f"{of} {axis}", f"{low * 1000:.0f} mm", f"{high * 1000:.0f} mm", ((25, 25, 25), _rgb(end)))
            for axis, low, high, end in zip("xyz", self.low, self.high, ends, strict=True)
        )


def extent_of(points: Float[np.ndarray, "n 3"]) -> Extent:
    """The box about points; at least one."""
    return Extent(points.min(axis=0), points.max(axis=0))


def fragment_colors(
    model: Model | None, centers: Float[np.ndarray, "n 3"] | None, count: int
) -> UInt8[np.ndarray, "n 3"]:
    """Colours of fragments by their centres in the model's box, or in their own; without centres, well-spread ones."""
    if centers is None or not len(centers):
        return np.array(label_colors(max(count, 1)), np.uint8)
    return extent_of(centers if model is None else model.vertices).colors(centers)


def lit(colors: UInt8[np.ndarray, "n 3"], weights: Float[np.ndarray, "n"] | None) -> UInt8[np.ndarray, "n 3"]:
    """Colours of fragments that are lit by weights of 0..1; all of them where there are no weights."""
    if weights is None:
        return colors
    share = np.clip(weights, 0, 1)[:, None]
    return (share * colors + (1 - share) * np.array(UNLIT)).astype(np.uint8)


def coordinate_colors(coordinates: Float[np.ndarray, "*n 3"]) -> UInt8[np.ndarray, "*n 3"]:
    """3D fragment coordinates as colours, gray at the fragment's centre, saturated half a size away from it."""
    return (255 * np.clip(np.nan_to_num(coordinates, nan=0.0) + 0.5, 0, 1)).astype(np.uint8)


COORDINATE_SCALES = tuple(
    ColorScale(f"{axis} in the fragment", "-h/2", "+h/2", (_low, (128, 128, 128), _high))
    for axis, _low, _high in zip(
        "xyz",
        ((0, 128, 128), (128, 0, 128), (128, 128, 0)),
        ((255, 128, 128), (128, 255, 128), (128, 128, 255)),
        strict=True,
    )
)
"""What the colours of 3D fragment coordinates mean."""


def confidence_colors(values: Float[np.ndarray, "n"]) -> UInt8[np.ndarray, "n 3"]:
    """Probabilities 0..1 as colours from dark violet to yellow."""
    return _mapped(np.nan_to_num(values), cv2.COLORMAP_PLASMA)


def residual_colors(values: Float[np.ndarray, "n"], tau_r: float) -> UInt8[np.ndarray, "n 3"]:
    """Re-projection errors as colours: green at 0, yellow at tau_r, red from twice that on."""
    share = np.clip(np.nan_to_num(values / (RESIDUAL_LIMIT * tau_r), nan=1.0, posinf=1.0), 0, 1)
    red, green = np.minimum(2 * share, 1.0), np.minimum(2 - 2 * share, 1.0)
    return np.stack([60 + 195 * red, 60 + 165 * green, np.full_like(share, 70)], axis=-1).astype(np.uint8)


def residual_scale(tau_r: float) -> ColorScale:
    """For the legend."""
    stops = _stops(lambda x: residual_colors(x * RESIDUAL_LIMIT * tau_r, tau_r))
    return ColorScale("re-projection error", "0", f"{RESIDUAL_LIMIT * tau_r:g} px", stops)


def confidence_scale(label: str, highest: float = 1.0) -> ColorScale:
    """For the legend."""
    return ColorScale(label, "0", f"{highest:.2g}", _stops(confidence_colors))


def _mapped(values: Float[np.ndarray, "n"], colormap: int) -> UInt8[np.ndarray, "n 3"]:
    levels = (np.clip(values, 0, 1) * 255).astype(np.uint8).reshape(-1, 1)
    if not len(levels):
        return np.zeros((0, 3), np.uint8)
    return cv2.applyColorMap(levels, colormap)[:, 0, ::-1]


def _stops(colormap: Callable[[np.ndarray], np.ndarray]) -> tuple[tuple[int, int, int], ...]:
    return tuple(_rgb(color) for color in colormap(np.linspace(0, 1, 9)))


def _rgb(color: np.ndarray) -> tuple[int, int, int]:
    return int(color[0]), int(color[1]), int(color[2])
