"""Recorded maps as layers over the image: whatever a stage has logged per pixel or per cell."""

from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from inspector import layers
from inspector.layers import ColorScale, Rgba
from pipeline.recording import ColorImage, DepthMap, Heatmap, Mask, Probabilities

DRAWABLE = frozenset({"image", "depth", "heatmap", "mask", "probabilities"})
"""Kinds of records that `layer_of` can draw."""


def layer_of(record: Any, size: tuple[int, int], opacity: float) -> tuple[Rgba, ColorScale | None]:
    """Draw a record at the image's `size` (width, height) in pixels; cells are repeated, never smoothed."""
    match record:
        case ColorImage(rgb=rgb):
            return _opaque(cv2.resize(rgb, size, interpolation=cv2.INTER_NEAREST), opacity), None
        case DepthMap(depth=depth):
            return layers.depth_layer(_stretched(depth, size), opacity)
        case Mask(mask=mask):
            layer = layers.blank(size[1], size[0])
            layers.paint(layer, _stretched(mask.astype(np.uint8), size) > 0, (255, 80, 200), opacity)
            return layer, None
        case Heatmap(values=values, cell_px=cell_px, unit=unit):
            return _heat(repeated(values.astype(np.float32), cell_px, size), unit, opacity)
        case Probabilities():
            return _most_likely(record, size, opacity), None
    raise TypeError(f"no layer for {type(record).__name__}")


def _heat(values: Float[np.ndarray, "h w"], unit: str, opacity: float) -> tuple[Rgba, ColorScale]:
    known = np.isfinite(values)
    if known.any() and values[known].min() < 0:
        limit = float(np.abs(values[known]).max()) or 1.0
        layer, scale = layers.difference_layer(np.where(known, values, 0), known, limit, opacity)
        return layer, scale._replace(label=unit, low=f"{-limit:.3g}", high=f"{limit:.3g}")
    return layers.heat_layer(values, unit, opacity)


def _most_likely(record: Probabilities, size: tuple[int, int], opacity: float) -> Rgba:
    """Colour of the most likely class where anything was recorded, more opaque where it is surer."""
    rows, columns = record.grid
    grid = np.zeros((rows, columns, 4), np.uint8)
    best = record.values.argmax(axis=1)
    colors = np.array(layers.label_colors(max(record.values.shape[1], 1)), np.uint8)
    x, y = record.cells.T
    grid[y, x, :3] = colors[best]
    grid[y, x, 3] = (255 * opacity * record.values.max(axis=1).astype(np.float32)).astype(np.uint8)
    return repeated(grid, record.cell_px, size)


def repeated(values: np.ndarray, cell_px: int, size: tuple[int, int]) -> np.ndarray:
    """Repeat cells to pixels and cut or pad to the image's size."""
    full = values.repeat(cell_px, axis=0).repeat(cell_px, axis=1)[: size[1], : size[0]]
    missing = [(0, size[1] - full.shape[0]), (0, size[0] - full.shape[1])] + [(0, 0)] * (full.ndim - 2)
    return np.pad(full, missing) if any(after for _, after in missing) else full


def _stretched(values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    return values if values.shape[1::-1] == size else cv2.resize(values, size, interpolation=cv2.INTER_NEAREST)


def _opaque(rgb: np.ndarray, opacity: float) -> Rgba:
    return np.dstack([rgb, np.full(rgb.shape[:2], round(255 * opacity), np.uint8)])
