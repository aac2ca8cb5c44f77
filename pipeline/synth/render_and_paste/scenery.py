"""Made-up backgrounds: surfaces laid out as walls and tables, strewn with simple things, unevenly lit, out of focus."""

from __future__ import annotations

import cv2
import numpy as np

from pipeline.synth.render_and_paste.clutter import strew
from pipeline.synth.render_and_paste.patterns import RGB, clouds, gradient, random_surface


def made_up_scenery(rng: np.random.Generator, width: int, height: int) -> RGB:
    """A varied background: a room with a table, a floor seen from above, dense clutter, or a plain surface."""
    kind = rng.random()
    if kind < 0.45:
        rgb = _room(rng, width, height)
        strew(rgb, rng, int(rng.integers(8, 40)))
    elif kind < 0.7:
        rgb = _seen_aslant(random_surface(rng, width, height), rng, 0.25)
        strew(rgb, rng, int(rng.integers(2, 30)))
    elif kind < 0.9:
        rgb = random_surface(rng, width, height)
        strew(rgb, rng, int(rng.integers(40, 90)))
    else:
        rgb = gradient(rng, width, height) if rng.random() < 0.5 else random_surface(rng, width, height)
    rgb = _unevenly_lit(_grained(rgb, rng), rng)
    sigma = rng.choice([0.0, rng.uniform(0.4, 0.9), rng.uniform(0.9, 5.0)], p=[0.45, 0.35, 0.2])
    return cv2.GaussianBlur(rgb, (0, 0), float(sigma)) if sigma else rgb


def _grained(rgb: RGB, rng: np.random.Generator) -> RGB:
    """Roughen all surfaces a little, some parts of the image more than others."""
    height, width = rgb.shape[:2]
    words = rng.integers(0, 2**64 - 1, -(-width * height // 8), np.uint64, endpoint=True)
    fine = words.view(np.uint8)[: width * height].reshape(height, width)
    grain = cv2.GaussianBlur(fine, (0, 0), rng.uniform(0.5, 1.0))
    strength = rng.uniform(0.0, 0.35)
    darker = cv2.convertScaleAbs(grain, alpha=strength, beta=255 * (1 - strength / 2) - 64 * strength)
    return cv2.multiply(rgb, cv2.merge([darker] * 3), None, 1 / 255)


def _room(rng: np.random.Generator, width: int, height: int) -> RGB:
    """A wall and, below a horizon, a table or floor that recedes."""
    rgb = random_surface(rng, width, height)
    if rng.random() < 0.5:  # what hangs on the wall or stands before it
        strew(rgb, rng, int(rng.integers(2, 8)))
        rgb = cv2.GaussianBlur(rgb, (0, 0), rng.uniform(0.8, 4.0))
    left, right = rng.uniform(-0.05, 0.6) * height + rng.uniform(-0.12, 0.12, 2) * height
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], np.float32)
    wide = rng.uniform(0.2, 1.5) * width
    seen = np.array([[0, left], [width, right], [width + wide, height], [-wide, height]], np.float32)
    warp = cv2.getPerspectiveTransform(corners, seen)
    table = cv2.warpPerspective(random_surface(rng, width, height), warp, (width, height), borderMode=cv2.BORDER_WRAP)
    below = np.array([[0, left], [width, right], [width, height], [0, height]])
    mask = np.zeros((height, width), np.uint8)
    cv2.fillConvexPoly(mask, np.rint(below).astype(np.int32), 255, cv2.LINE_AA)
    cv2.copyTo(table, mask, rgb)
    return rgb


def _seen_aslant(surface: RGB, rng: np.random.Generator, most: float) -> RGB:
    """A surface seen from a random direction: its corners are moved by up to a share of its size, outwards."""
    height, width = surface.shape[:2]
    size = np.array([width, height])
    corners = (np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) * size).astype(np.float32)
    outwards = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) * rng.uniform(0, most, (4, 2)) * size
    warp = cv2.getPerspectiveTransform(corners, (corners + outwards).astype(np.float32))
    return cv2.warpPerspective(surface, warp, (width, height), borderMode=cv2.BORDER_REFLECT)


def _unevenly_lit(rgb: RGB, rng: np.random.Generator) -> RGB:
    """Soft light and dark, and a tint, over the whole image."""
    height, width = rgb.shape[:2]
    small = clouds(rng, max(2, width // 16), max(2, height // 16), 2)
    strength = cv2.resize(small, (width, height), interpolation=cv2.INTER_CUBIC)
    depth = rng.uniform(0.0, 0.55)
    light = np.clip((1.0 - depth + depth * strength) * rng.uniform(0.75, 1.1) * 160, 0, 255).astype(np.uint8)
    tint = 1.0 + rng.uniform(-0.12, 0.12) * np.array([1.0, 0.0, -1.0])
    lit = cv2.multiply(rgb, cv2.merge([light] * 3), None, 1 / 160)
    return cv2.transform(lit, np.diag(tint))
