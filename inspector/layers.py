"""Overlays as RGBA images: contours, fills, masks, depth and depth differences, and the wipe between two of them."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from pipeline.scene import Camera

GROUND_TRUTH = (60, 220, 100)
ESTIMATE = (60, 150, 255)
COMPARED = (255, 150, 40)
OTHERS = (225, 225, 225)
"""Colours by role (RGB): ground truth green and estimate blue as in the thesis, the compared method orange."""

Rgba = UInt8[np.ndarray, "h w 4"]


class ColorScale(NamedTuple):
    """What the colours of a layer mean, for the legend."""

    label: str
    low: str
    high: str
    stops: tuple[tuple[int, int, int], ...]


def supersampled(camera: Camera, factor: int) -> Camera:
    """Return a camera whose pixels are `factor` times finer and that sees exactly the same (pixel centres are integers)."""
    K = camera.K.copy()
    K[:2] *= factor
    K[:2, 2] += (factor - 1) / 2
    return Camera(K, camera.width * factor, camera.height * factor, camera.world_from_camera)


def blank(height: int, width: int) -> Rgba:
    """Return a fully transparent layer."""
    return np.zeros((height, width, 4), np.uint8)


def contour_of(mask: Bool[np.ndarray, "h w"], thickness: int = 1) -> Bool[np.ndarray, "h w"]:
    """Pixels of the mask that touch its outside (within `thickness` pixels); also where the image's border cuts it."""
    if not mask.size:
        return mask
    inner = cv2.erode(mask.astype(np.uint8), np.ones((3, 3), np.uint8), iterations=thickness, borderValue=0)
    return mask & (inner == 0)


def paint(layer: Rgba, mask: Bool[np.ndarray, "h w"], color: tuple[int, int, int], alpha: float) -> None:
    """Set the pixels of the mask to a colour with an opacity of 0..1, in place."""
    layer[mask] = (*color, round(255 * alpha))


def silhouette(
    mask: Bool[np.ndarray, "h w"],
    color: tuple[int, int, int],
    *,
    fill: float,
    opacity: float,
    thickness: int,
) -> Rgba:
    """Return a layer with the mask filled (opacity `fill`) and its contour on top (opacity `opacity`)."""
    layer = blank(*mask.shape)
    if fill > 0:
        paint(layer, mask, color, fill)
    paint(layer, contour_of(mask, thickness), color, opacity)
    return layer


def wiped(left: Rgba, right: Rgba, position: float) -> Rgba:
    """Return `left` left of a vertical line at `position` (0..1 of the width), `right` on its other side, and the line."""
    result = right.copy()
    column = int(np.clip(round(position * result.shape[1]), 0, result.shape[1] - 1))
    result[:, :column] = left[:, :column]
    result[:, column] = (255, 255, 255, 200)
    return result


def depth_layer(depth: Float[np.ndarray, "h w"], opacity: float = 1.0) -> tuple[Rgba, ColorScale]:
    """Depth in colours (near warm, far cold), transparent where it was not measured, with its scale."""
    measured = depth > 0
    low, high = np.percentile(depth[measured], [1, 99]) if measured.any() else (0.0, 1.0)
    colors = turbo(1 - np.clip((depth - low) / max(high - low, 1e-6), 0, 1))
    layer = np.dstack([colors, np.where(measured, round(255 * opacity), 0).astype(np.uint8)])
    return layer, ColorScale("depth", f"{low:.2f} m", f"{high:.2f} m", _stops(lambda x: turbo(1 - x)))


def difference_layer(
    difference: Float[np.ndarray, "h w"], valid: Bool[np.ndarray, "h w"], limit: float, opacity: float = 1.0
) -> tuple[Rgba, ColorScale]:
    """Signed differences in metres, blue below zero, white at zero, red above, saturated at +-`limit` metres."""
    colors = _diverging(np.clip(difference / limit, -1, 1))
    layer = np.dstack([colors, np.where(valid, round(255 * opacity), 0).astype(np.uint8)])
    scale = ColorScale(
        "measured minus rendered depth",
        f"-{limit * 1000:.0f} mm",
        f"+{limit * 1000:.0f} mm",
        _stops(lambda x: _diverging(2 * x - 1)),
    )
    return layer, scale


def heat_layer(values: Float[np.ndarray, "h w"], unit: str, opacity: float = 1.0) -> tuple[Rgba, ColorScale]:
    """Non-negative values in colours, zero transparent and NaN too, with their scale."""
    shown = np.isfinite(values) & (values > 0)
    high = float(values[shown].max()) if shown.any() else 1.0
    colors = turbo(np.clip(np.where(shown, values, 0) / high, 0, 1))
    layer = np.dstack([colors, np.where(shown, round(255 * opacity), 0).astype(np.uint8)])
    return layer, ColorScale(unit, "0", f"{high:.3g}", _stops(turbo))


def near_far(values: Float[np.ndarray, "h w"], low: float, high: float) -> UInt8[np.ndarray, "h w 3"]:
    """Distances as opaque colours, near warm and far cold, dark where there is none (0)."""
    colors = turbo(1 - np.clip((values - low) / max(high - low, 1e-6), 0, 1))
    return np.where((values > 0)[..., None], colors, np.uint8(25))


def signed(values: Float[np.ndarray, "h w"], limit: float) -> UInt8[np.ndarray, "h w 3"]:
    """Signed values as opaque colours, blue below zero, red above, saturated at +-`limit`; dark where NaN."""
    known = np.isfinite(values)
    colors = _diverging(np.clip(np.where(known, values, 0) / limit, -1, 1))
    return np.where(known[..., None], colors, np.uint8(25))


def label_colors(count: int) -> list[tuple[int, int, int]]:
    """Return well-spread colours for `count` labels (golden-angle hues)."""
    hues = (np.arange(count) * 0.381966 % 1 * 180).astype(np.uint8)
    hsv = np.stack([hues, np.full(count, 190, np.uint8), np.full(count, 255, np.uint8)], axis=-1)[None]
    return [(int(r), int(g), int(b)) for r, g, b in cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)[0]]


def upsampled(layer: Rgba, factor: int) -> UInt8[np.ndarray, "H W 4"]:
    """Repeat every pixel `factor` times in both directions, because the browser's textures are bilinear."""
    return layer if factor == 1 else layer.repeat(factor, axis=0).repeat(factor, axis=1)


def turbo(values: Float[np.ndarray, "*n"]) -> UInt8[np.ndarray, "*n 3"]:
    """Colours of numbers between 0 (blue) and 1 (red)."""
    levels = (values * 255).astype(np.uint8)
    return cv2.applyColorMap(levels.reshape(-1, 1), cv2.COLORMAP_TURBO)[:, 0, ::-1].reshape(*levels.shape, 3)


def _diverging(values: Float[np.ndarray, "*n"]) -> UInt8[np.ndarray, "*n 3"]:
    """Map -1..1 through blue, near-white and red."""
    negative, middle, positive = (np.array(c, np.float32) for c in ((40, 90, 220), (245, 245, 245), (220, 50, 40)))
    share = np.abs(values)[..., None].astype(np.float32)
    end = np.where(values[..., None] < 0, negative, positive)
    return (middle * (1 - share) + end * share).astype(np.uint8)


def _stops(colormap) -> tuple[tuple[int, int, int], ...]:
    return tuple((int(r), int(g), int(b)) for r, g, b in colormap(np.linspace(0, 1, 9)))
