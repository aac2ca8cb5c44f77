"""Random fields that repeat without seams: the raw material of the procedural textures."""

import numpy as np
from jaxtyping import Float


def clouds(
    rng: np.random.Generator, size: int, slope: float = 1.6, stretch: tuple[float, float] = (1.0, 1.0), low: float = 1.0
) -> Float[np.ndarray, "n n"]:
    """Noise with a spectrum 1 / frequency^slope, in 0..1 about 0.5, that repeats at its borders.

    `stretch` draws it out along x and y; frequencies below `low` cycles per picture are left out.
    """
    spectrum = np.fft.rfft2(rng.standard_normal((size, size)).astype(np.float32))
    fy = np.fft.fftfreq(size, 1.0 / size)[:, None] * stretch[1]
    fx = np.fft.rfftfreq(size, 1.0 / size)[None, :] * stretch[0]
    frequency = np.hypot(fx, fy)
    gain = np.where(frequency >= low, np.maximum(frequency, low) ** -slope, 0.0)
    field = np.fft.irfft2(spectrum * gain, s=(size, size)).astype(np.float32)
    return np.clip(0.5 + field / (6.0 * field.std() + 1e-12), 0.0, 1.0)


def mixed(
    first: tuple[float, ...], second: tuple[float, ...], share: Float[np.ndarray, "h w"]
) -> Float[np.ndarray, "h w 3"]:
    """Blend two sRGB colours per pixel: the first where `share` is 0, the second where it is 1."""
    a, b = np.array(first, np.float32), np.array(second, np.float32)
    return a + (b - a) * np.clip(share, 0.0, 1.0)[..., None].astype(np.float32)


def jittered(rng: np.random.Generator, color: tuple[float, ...], spread: float = 10.0) -> tuple[float, ...]:
    """A colour near the given one: a little lighter or darker and a little off in hue."""
    shift = rng.uniform(-spread, spread) + rng.uniform(-0.35, 0.35, 3) * spread
    return tuple(float(value) for value in np.clip(np.array(color) + shift, 0, 255))
