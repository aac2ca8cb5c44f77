"""Random light for drawn objects: ambient light from above and below, and a few distant lamps."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.exceptions import InputError

MOST_LAMPS = 4


class LightError(InputError):
    """A range of light that cannot be drawn from."""


@dataclass(frozen=True)
class LightRanges:
    """What light is drawn from, uniformly; strength 1 shows a white surface that faces the lamp as white."""

    lamps: tuple[int, int] = (1, 3)
    """At most 4."""
    strength: tuple[float, float] = (0.2, 0.6)
    """Of each lamp, before its colour."""
    ambient: tuple[float, float] = (0.2, 0.5)
    """Light from all sides; that from below is 40 to 100 % of that from above."""
    color: float = 0.25
    """How far the colour of a light may be off white, each channel by this share."""
    gloss: tuple[float, float] = (0.0, 0.3)
    """Strength of highlights, drawn for each object."""
    sharpness: tuple[float, float] = (8.0, 80.0)
    """Exponent of highlights (Blinn-Phong)."""

    def __post_init__(self) -> None:
        for name in ("lamps", "strength", "ambient", "gloss", "sharpness"):
            low, high = getattr(self, name)
            if not 0 <= low <= high < np.inf:
                raise LightError(f"{name} of the light from {low} to {high}; give numbers from 0 on, low before high")
        if self.lamps[1] > MOST_LAMPS:
            raise LightError(f"{self.lamps[1]} lamps; at most {MOST_LAMPS} can be drawn")
        if not 0 <= self.color <= 1:
            raise LightError(f"color {self.color} of the light is outside 0..1; 0 is white light")


@dataclass(frozen=True, eq=False)
class Light:
    """Light of one image, camera frame (x right, y down, z forward)."""

    directions: Float[np.ndarray, "n 3"]
    """Unit vectors towards the lamps."""
    colors: Float[np.ndarray, "n 3"]
    """Linear RGB."""
    from_above: Float[np.ndarray, "3"]
    """Ambient light on a surface that looks up, linear RGB; in between it is mixed."""
    from_below: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    """Unit vector."""


def sample_light(ranges: LightRanges, rng: np.random.Generator) -> Light:
    """Draw the light of an image; lamps shine from above and behind the camera, from a half of all directions."""
    count = int(rng.integers(ranges.lamps[0], ranges.lamps[1], endpoint=True))
    directions = _unit(rng.normal(size=(count, 3)))
    axis = _unit(np.array([0.0, -0.6, -0.8]))
    directions *= np.where(directions @ axis < 0, -1.0, 1.0)[:, None]
    strengths = rng.uniform(*ranges.strength, size=(count, 1))
    above = rng.uniform(*ranges.ambient) * _tint(ranges, rng)
    return Light(
        directions,
        strengths * np.stack([_tint(ranges, rng) for _ in range(count)]) if count else np.zeros((0, 3)),
        above,
        above * rng.uniform(0.4, 1.0),
        _unit(np.array([0.0, -1.0, 0.0]) + rng.normal(0, 0.3, 3)),
    )


def _tint(ranges: LightRanges, rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    """A colour of mean 1: mostly between warm and cold, a little towards green or purple."""
    warm, green = rng.uniform(-1, 1), 0.3 * rng.uniform(-1, 1)
    tint = 1.0 + ranges.color * np.array([0.75 * warm - green / 2, green, -0.75 * warm - green / 2])
    return tint / tint.mean()


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
