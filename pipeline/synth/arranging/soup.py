"""Triangles cut by planes."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

Soup = Float[np.ndarray, "_ 3 3"]
"""Triangles, by their corners."""


def split(soup: Soup, axis: int, at: float) -> tuple[Soup, Soup]:
    """Triangles below and above the plane at a coordinate of an axis; those that cross it are cut."""
    height = soup[..., axis] - at
    above, below = (height >= 0).all(axis=1), (height <= 0).all(axis=1)
    crossing = ~(above | below)
    low, high = _cut(soup[crossing], height[crossing])
    return np.concatenate([soup[below], low]), np.concatenate([soup[above & ~below], high])


def _cut(soup: Soup, height: Float[np.ndarray, "n 3"]) -> tuple[Soup, Soup]:
    """Both sides of triangles that cross the plane of height 0."""
    lone_above = (height > 0).sum(axis=1) == 1  # else one corner is below and the others above or one of them on it
    lone = np.where(lone_above, height.argmax(axis=1), height.argmin(axis=1))
    turn = (lone[:, None] + np.arange(3)) % 3
    soup, height = np.take_along_axis(soup, turn[..., None], 1), np.take_along_axis(height, turn, 1)
    share = height[:, :1] / (height[:, :1] - height[:, 1:])
    cuts = soup[:, :1] + share[..., None] * (soup[:, 1:] - soup[:, :1])
    tips = np.stack([soup[:, 0], cuts[:, 0], cuts[:, 1]], axis=1)
    bases = np.concatenate([np.stack([cuts[:, 0], soup[:, 1], soup[:, 2]], axis=1),
                            np.stack([cuts[:, 0], soup[:, 2], cuts[:, 1]], axis=1)])  # fmt: skip
    twice = np.concatenate([lone_above, lone_above])
    return np.concatenate([tips[~lone_above], bases[twice]]), np.concatenate([tips[lone_above], bases[~twice]])
