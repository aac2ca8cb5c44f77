"""Candidates per pixel as colours, and their numbers as text."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Num, UInt8

from inspector.layers import ColorScale, turbo
from pipeline.recording import Heatmap

LOGARITHMIC_FROM = 25.0
"""Ratio of the largest to the median value above which colours go by the logarithm."""
WEAKEST, STRONGEST = 0.22, 0.62
"""Opacity at the smallest and at the largest value; the image stays visible."""
THUMBNAIL_WIDTH = 132
"""Pixels."""


class Shades(NamedTuple):
    """How numbers become colours."""

    low: float
    high: float
    logarithmic: bool

    def shares(self, values: Num[np.ndarray, "*n"]) -> Float[np.ndarray, "*n"]:
        """Places on the colour bar, 0 to 1; 0 where the value is not positive."""
        known = np.where(values > 0, values, self.low).astype(np.float64)
        if self.logarithmic:
            return np.clip(np.log(known / self.low) / np.log(self.high / self.low), 0, 1)
        return np.clip(known / self.high, 0, 1)


def shades_of(values: Num[np.ndarray, "h w"]) -> Shades:
    """Colours that tell the values apart: by the logarithm where they differ by much."""
    positive = values[values > 0]
    if not len(positive):
        return Shades(1.0, 1.0, False)
    small, usual = (float(value) for value in np.percentile(positive, (2, 50)))
    high = float(positive.max())
    logarithmic = high > LOGARITHMIC_FROM * usual
    return Shades(small if logarithmic else 0.0, high, logarithmic)


def heat_pixels(heatmap: Heatmap, size: tuple[int, int], fineness: int = 1) -> UInt8[np.ndarray, "h w 4"]:
    """A heatmap as RGBA over an image of `size` (width, height); cells stay what they are, nothing is smoothed."""
    values = heatmap.values
    share = shades_of(values).shares(values)
    alpha = np.where(values > 0, 255 * (WEAKEST + (STRONGEST - WEAKEST) * share), 0)
    cells = np.dstack([turbo(share), alpha.astype(np.uint8)])
    factor = heatmap.cell_px * fineness
    width, height = size[0] * fineness, size[1] * fineness
    return cells.repeat(factor, axis=0).repeat(factor, axis=1)[:height, :width]


def scale_of(heatmap: Heatmap) -> ColorScale:
    """What the colours mean, for the legend."""
    shades = shades_of(heatmap.values)
    stops = turbo(np.linspace(0, 1, 9))
    low = counted(shades.low, markup=False) if shades.logarithmic else "0"
    unit = "candidates per pixel, logarithmic" if shades.logarithmic else "candidates per pixel"
    return ColorScale(
        unit,
        low,
        counted(shades.high, markup=False),
        tuple((int(r), int(g), int(b)) for r, g, b in stops),
    )


def thumbnail(heatmap: Heatmap | None, rgb: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "t u 3"]:
    """The image, small and dark, under the candidates of a stage; without any it stays dark."""
    height = round(rgb.shape[0] * THUMBNAIL_WIDTH / rgb.shape[1])
    small = cv2.resize(rgb, (THUMBNAIL_WIDTH, height), interpolation=cv2.INTER_AREA)
    gray = cv2.cvtColor(cv2.cvtColor(small, cv2.COLOR_RGB2GRAY), cv2.COLOR_GRAY2RGB).astype(np.float32) * 0.75
    if heatmap is None:
        return gray.astype(np.uint8)
    layer = heat_pixels(heatmap, (rgb.shape[1], rgb.shape[0]))
    layer = cv2.resize(layer, (THUMBNAIL_WIDTH, height), interpolation=cv2.INTER_AREA).astype(np.float32)
    alpha = np.minimum(layer[..., 3:] / 255 * 1.15, 1.0)
    return (gray * (1 - alpha) + layer[..., :3] * alpha).astype(np.uint8)


def colors_of(values: Float[np.ndarray, "n"], low: float, high: float) -> UInt8[np.ndarray, "n 3"]:
    """Colours of numbers between two ends, as on the colour bar."""
    return turbo(np.clip((values - low) / max(high - low, 1e-12), 0, 1))


def counted(number: float, *, markup: bool = True) -> str:
    """A number of candidates, short: 14 665, or 2.9·10^7 with the exponent raised (by `markup` or by signs)."""
    if number < 100_000:
        return f"{number:.3g}" if number < 10 and number != int(number) else f"{number:,.0f}"
    exponent = int(np.floor(np.log10(number)))
    factor = f"{number / 10**exponent:.1f}"
    if factor == "10.0":
        factor, exponent = "1.0", exponent + 1
    return f"{factor}·10<sup>{exponent}</sup>" if markup else f"{factor}·10{_raised(exponent)}"


def _raised(number: int) -> str:
    return "".join("⁰¹²³⁴⁵⁶⁷⁸⁹"[int(digit)] for digit in str(number))
