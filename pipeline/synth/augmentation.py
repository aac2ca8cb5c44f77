"""Random changes of training images: brightness, contrast, hue, saturation, Gaussian noise and blur.

The thesis augments its training images so (sec. synth_experiments, sec. epos_network_training) without naming ranges;
the defaults here are ours, of the order that is usual for the purpose. A few milliseconds for a 640x480 image: the four
changes of colour are one affine map, and noise is looked up in a table.
"""

from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from pipeline.exceptions import InputError

RGB = UInt8[np.ndarray, "h w 3"]

_LUMA = np.array([0.299, 0.587, 0.114])
"""Share of red, green and blue in the brightness of a colour (BT.601)."""


class AugmentationError(InputError):
    """A setting that no image can be changed by."""


@dataclass(frozen=True)
class Change:
    """How often something is changed, and the range that its amount is drawn from, uniformly."""

    chance: float
    """Share of images that are changed, 0..1."""
    low: float
    high: float

    def __post_init__(self) -> None:
        if not 0.0 <= self.chance <= 1.0:
            raise AugmentationError(f"chance {self.chance} of a change is outside 0..1; give the share of images")
        if not -np.inf < self.low <= self.high < np.inf:
            raise AugmentationError(f"range {self.low}..{self.high} of a change; give finite numbers, low before high")


@dataclass(frozen=True)
class Augmentation:
    """What is changed, in this order; None leaves it out. Amounts that change nothing: 0, contrast and saturation 1."""

    brightness: Change | None = Change(0.8, -0.2, 0.2)
    """Added to every channel; 1 is the way from black to white."""
    contrast: Change | None = Change(0.8, 0.7, 1.3)
    """Factor of the differences from the mean colour of the image; at least 0."""
    saturation: Change | None = Change(0.8, 0.7, 1.3)
    """Factor of the differences from gray of the same brightness; at least 0."""
    hue: Change | None = Change(0.8, -10.0, 10.0)
    """Turn about the axis of grays, degrees."""
    blur: Change | None = Change(0.5, 0.0, 1.5)
    """Standard deviation of the Gaussian, pixels; at least 0."""
    noise: Change | None = Change(0.5, 0.0, 0.05)
    """Standard deviation of Gaussian noise, independent in each pixel and channel; 1 is the way from black to white."""

    def __post_init__(self) -> None:
        for name in ("contrast", "saturation", "blur", "noise"):
            change = getattr(self, name)
            if change is not None and change.low < 0:
                raise AugmentationError(f"{name} from {change.low} on; nothing below 0 has a meaning")


def augment(rgb: RGB, rng: np.random.Generator, settings: Augmentation | None = None) -> RGB:
    """A randomly changed copy of an image; the same generator state makes the same image. Settings default to ours."""
    settings = settings or Augmentation()
    names = ("brightness", "contrast", "saturation", "hue", "blur", "noise")
    brightness, contrast, saturation, hue, blur, noise = (_amount(getattr(settings, name), rng) for name in names)
    rgb = _recolored(rgb, brightness or 0.0, _or_one(contrast), _or_one(saturation), np.deg2rad(hue or 0.0))
    if blur:
        rgb = cv2.GaussianBlur(rgb, (0, 0), blur)
    if noise:
        rgb = _with_noise(rgb, noise * 255.0, rng)
    return rgb


def _amount(change: Change | None, rng: np.random.Generator) -> float | None:
    if change is None:
        return None
    chance, amount = rng.random(), rng.uniform(change.low, change.high)  # always both: one change less moves no other
    return float(amount) if chance < change.chance else None


def _or_one(factor: float | None) -> float:
    return 1.0 if factor is None else factor


def _recolored(rgb: RGB, brightness: float, contrast: float, saturation: float, hue: float) -> RGB:
    """Apply the changes of colour as one affine map, so that only its result is cut to 0..255."""
    if (brightness, contrast, saturation, hue) == (0.0, 1.0, 1.0, 0.0):
        return rgb.copy()
    colors = _hue_turn(hue) @ (saturation * np.eye(3) + (1.0 - saturation) * _LUMA)
    mean = np.array(cv2.mean(rgb)[:3])
    offset = (1.0 - contrast) * colors @ mean + 255.0 * brightness
    return cv2.transform(np.ascontiguousarray(rgb), np.column_stack([contrast * colors, offset]))


def _hue_turn(angle: float) -> Float[np.ndarray, "3 3"]:
    """Turn colours about the axis of grays, keeping their brightness (a rotation of the chroma plane of YIQ)."""
    yiq = np.array([_LUMA, [0.596, -0.274, -0.322], [0.211, -0.523, 0.312]])
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.linalg.inv(yiq) @ np.array([[1, 0, 0], [0, cosine, -sine], [0, sine, cosine]]) @ yiq


def _with_noise(rgb: RGB, sigma: float, rng: np.random.Generator) -> RGB:
    """Add Gaussian noise: 16 random bits choose an entry in the table of equally likely values.

    The image is of whole numbers, so adding rounded noise is the same as rounding the noisy image.
    """
    table = np.rint(sigma * _normal_quantiles()).astype(np.int16)
    words = rng.integers(0, 2**64 - 1, -(-rgb.size // 4), np.uint64, endpoint=True)
    noise = table.take(words.view(np.uint16)[: rgb.size]).reshape(rgb.shape)
    return cv2.add(rgb, noise, dtype=cv2.CV_8U)


@cache
def _normal_quantiles() -> Float[np.ndarray, "65536"]:
    from scipy.special import ndtri

    return ndtri((np.arange(65536) + 0.5) / 65536)
