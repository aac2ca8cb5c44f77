"""Simple sensors: linear radiance to an 8-bit photograph, and exact depth to what a depth camera measures."""

import numpy as np
from jaxtyping import Float, UInt8


def photograph(
    radiance: Float[np.ndarray, "h w 3"], rng: np.random.Generator, exposure: float = 1.0, noise: float = 0.006
) -> UInt8[np.ndarray, "h w 3"]:
    """Vignetting, shot noise, a soft shoulder for highlights, and gamma."""
    height, width = radiance.shape[:2]
    v, u = np.indices((height, width))
    radius = np.hypot(u - (width - 1) / 2, v - (height - 1) / 2) / np.hypot(width / 2, height / 2)
    linear = radiance * (exposure * (1.0 - 0.22 * radius**2.5))[..., None]
    grain = rng.standard_normal(linear.shape).astype(np.float32)
    linear = np.clip(linear + noise * grain * np.sqrt(np.clip(linear, 0, 1) + 0.02), 0, None)
    knee = 0.62
    shoulder = knee + (1 - knee) * (1 - np.exp(-(linear - knee) / (1 - knee)))
    linear = np.where(linear > knee, shoulder, linear)
    return np.clip(np.rint(255 * linear ** (1 / 2.2)), 0, 255).astype(np.uint8)


def measured_depth(
    depth: Float[np.ndarray, "h w"],
    K: Float[np.ndarray, "3 3"],
    rng: np.random.Generator,
    noise_m: float = 0.0008,
    range_m: float = 2.0,
) -> Float[np.ndarray, "h w"]:
    """Depth (metres) with correlated noise that grows with distance, and 0 at depth steps, grazing views and far off.

    `noise_m` is the standard deviation at 0.7 m.
    """
    import cv2

    grain = cv2.GaussianBlur(rng.standard_normal(depth.shape), (0, 0), 0.9) * 3.2
    noisy = depth + noise_m * grain * (depth / 0.7) ** 2
    high = cv2.dilate(depth, np.ones((3, 3)))
    low = cv2.erode(depth, np.ones((3, 3)))
    step = (high - low) > 0.02
    dropped = step & (rng.random(depth.shape) < 0.75)
    dropped |= (_cosine_of_view(depth, K) < 0.16) & (rng.random(depth.shape) < 0.9)
    return np.where(dropped | (depth <= 0) | (depth > range_m), 0.0, noisy)


def _cosine_of_view(depth: Float[np.ndarray, "h w"], K: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "h w"]:
    """Cosine between the surface normal (from differences of neighbouring points) and the viewing ray."""
    v, u = np.indices(depth.shape)
    points = np.stack([(u - K[0, 2]) / K[0, 0] * depth, (v - K[1, 2]) / K[1, 1] * depth, depth], axis=-1)
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    lengths = np.linalg.norm(normal, axis=-1) * np.linalg.norm(points, axis=-1)
    return np.abs(np.sum(normal * points, axis=-1)) / np.maximum(lengths, 1e-12)
