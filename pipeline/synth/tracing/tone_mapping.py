"""From linear radiance to an 8-bit photograph: exposure, white balance, tone curve, sRGB, camera noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8

from pipeline.synth.materials import RGB


@dataclass(frozen=True)
class PhotoConfig:
    """How a camera develops its picture."""

    percentile: float = 94.0
    """Of the luminance; what lies at it is shown at `bright`."""
    bright: float = 0.78
    """Linear value of the percentile."""
    dark: float = 0.13
    """Linear value that the median reaches at least, in pictures with much dark and a little very bright ..."""
    most_lift: float = 3.5
    """... but no more than this factor is added for it."""
    white_balance: float = 0.7
    """Share of the light's colour that the camera takes out."""
    noise: float = 0.0
    """Standard deviation of the noise at full brightness (linear); it falls with the root of the light. 0 for none."""


def photograph(
    radiance: Float[np.ndarray, "h w 3"],
    config: PhotoConfig | None = None,
    white: RGB = (1.0, 1.0, 1.0),
    rng: np.random.Generator | None = None,
) -> UInt8[np.ndarray, "h w 3"]:
    """Expose by percentile, balance, bend highlights, encode as sRGB; `rng` is needed for noise only."""
    config = config or PhotoConfig()
    balanced = radiance / np.array(white, np.float32) ** config.white_balance
    linear = balanced * exposure(balanced, config)
    if config.noise > 0:
        rng = rng or np.random.default_rng(0)
        grain = rng.standard_normal(linear.shape).astype(np.float32)
        linear = linear + config.noise * grain * np.sqrt(np.clip(linear, 0, 1) + 0.01)
    return np.rint(255.0 * _srgb(_shoulder(np.clip(linear, 0, None)))).astype(np.uint8)


def exposure(radiance: Float[np.ndarray, "h w 3"], config: PhotoConfig) -> float:
    """The factor that brings the percentile of the luminance to its place; 1 for a black image."""
    luminance = radiance @ np.array((0.2126, 0.7152, 0.0722), radiance.dtype)
    median, high = (float(value) for value in np.percentile(luminance, [50.0, config.percentile]))
    if high <= 0:
        return 1.0
    factor = config.bright / high
    lift = config.dark / max(median * factor, 1e-9)
    return factor * float(np.clip(lift, 1.0, config.most_lift))


def _shoulder(linear: Float[np.ndarray, "h w 3"], knee: float = 0.65) -> Float[np.ndarray, "h w 3"]:
    """Highlights bend towards 1 and lose colour instead of being cut off."""
    peak = linear.max(axis=-1, keepdims=True)
    over = np.maximum(peak - knee, 0.0) / (1 - knee)
    bent = np.where(peak > knee, knee + (1 - knee) * (1 - np.exp(-over)), peak)
    scaled = linear * (bent / np.maximum(peak, 1e-9))
    whitening = np.clip((peak - 1.2) / 6.0, 0, 1)
    return np.clip(scaled + (bent - scaled) * whitening, 0, 1)


def _srgb(linear: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "h w 3"]:
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)
