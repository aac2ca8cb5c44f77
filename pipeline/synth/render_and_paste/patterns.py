"""Surfaces that are made up: clouds of colour, wood, stripes, tiles, bricks, carpet, paper; all seeded, all sizes."""

from __future__ import annotations

import colorsys
from collections.abc import Callable
from functools import lru_cache
from math import cos, sin

import cv2
import numpy as np
from jaxtyping import Float32, UInt8

RGB = UInt8[np.ndarray, "h w 3"]
Field = Float32[np.ndarray, "h w"]


def random_color(rng: np.random.Generator) -> np.ndarray:
    """An 8-bit RGB colour as float, such as rooms have: half of them grayish, more light than dark, few garish."""
    saturation = rng.uniform(0, 0.15) if rng.random() < 0.6 else rng.uniform(0.15, 0.65)
    hue = rng.normal(0.09, 0.06) if rng.random() < 0.4 else rng.random()  # many things are brown, red or beige
    return 255 * np.array(colorsys.hsv_to_rgb(hue % 1.0, saturation, 0.1 + 0.9 * rng.random() ** 0.7))


def clouds(rng: np.random.Generator, width: int, height: int, octaves: int = 8, fading: float = 0.6) -> Field:
    """Noise of several octaves, 0..1: each twice as fine and `fading` times as strong as the one before."""
    total = np.zeros((height, width), np.float32)
    cells = int(rng.integers(2, 5))
    for octave in range(octaves):
        rows = max(2, min(height, round(cells * 2**octave * height / width)))
        grid = rng.random((rows, min(width, cells * 2**octave)), np.float32)
        total += np.float32(fading**octave) * cv2.resize(grid, (width, height), interpolation=cv2.INTER_LINEAR)
    return _stretched(total)


def colored(values: Field, rng: np.random.Generator, stops: int = 3, spread: float = 60.0) -> RGB:
    """Colours for values 0..1, between random stops that differ from one another by about `spread` levels."""
    base = random_color(rng)
    colors = np.clip(base + rng.normal(0, spread, (stops, 1)) + rng.normal(0, spread / 4, (stops, 3)), 0, 255)
    places = np.sort(rng.random(stops))
    ramp = np.stack([np.interp(np.linspace(0, 1, 256), places, colors[:, k]) for k in range(3)], axis=1)
    return _ramped(values, ramp)


def _ramped(values: Field, ramp: np.ndarray) -> RGB:
    """Colours of values 0..1 by a table (256, 3) of levels."""
    levels = cv2.convertScaleAbs(values, alpha=255)
    return cv2.LUT(cv2.merge([levels] * 3), np.rint(np.clip(ramp, 0, 255)).astype(np.uint8)[:, None])


def _painted(index: np.ndarray, table: np.ndarray) -> RGB:
    """Colours (n, 3) by an image of indices; four bytes at a time, which is much faster than three."""
    rgba = np.zeros((len(table), 4), np.uint8)
    rgba[:, :3] = np.clip(table, 0, 255)
    picked = rgba.view(np.uint32).ravel().take(index)
    return cv2.cvtColor(picked.view(np.uint8).reshape(*index.shape, 4), cv2.COLOR_RGBA2RGB)


def gradient(rng: np.random.Generator, width: int, height: int) -> RGB:
    """A soft change from one colour to others, along a line or about a point."""
    x, y = _grid(width, height)
    if rng.random() < 0.5:
        along = _turned(x, y, rng)
        return colored(_stretched(along), rng, 3, 35.0)
    u, v = rng.uniform(0, width), rng.uniform(0, height)
    return colored(_stretched(cv2.magnitude(x - u, y - v)), rng, 3, 35.0)


def marble(rng: np.random.Generator, width: int, height: int) -> RGB:
    """Clouds of colour: plaster, stone, cloth."""
    return colored(clouds(rng, width, height, fading=rng.uniform(0.5, 0.95)), rng, int(rng.integers(2, 6)), 60.0)


def wood(rng: np.random.Generator, width: int, height: int) -> RGB:
    """Grain along boards that are cut from different places of a trunk."""
    small = max(2, width // 2), max(2, height // 2)
    y = np.arange(small[1], dtype=np.float32)[:, None]
    boards = np.floor(y / rng.uniform(small[1] / 8, small[1] / 2))
    grain = clouds(rng, *small, 4) * rng.uniform(0.5, 3.0) + np.float32(0.37) * boards * (1 + boards)
    rings = np.sin((y / small[1] * rng.uniform(4, 12) + 2.5 * grain) * np.float32(2 * np.pi))
    shade = cv2.resize(0.2 * rings + 0.16 * np.sin(boards * 12.9898), (width, height))
    shade += cv2.resize(rng.random((height, 24), np.float32), (width, height)) * np.float32(0.6)
    tone = np.array(colorsys.hsv_to_rgb(rng.uniform(0.05, 0.11), rng.uniform(0.2, 0.6), rng.uniform(0.45, 1.0)))
    ramp = np.linspace(1.0, 1.0 - rng.uniform(0.25, 0.7), 256)[:, None] * tone * 255
    return _ramped(_stretched(shade), ramp)


def stripes(rng: np.random.Generator, width: int, height: int) -> RGB:
    """Stripes of two or more widths in a few colours, at any angle."""
    along = _turned(*_grid(width, height), rng)
    colors = np.stack([random_color(rng) for _ in range(int(rng.integers(2, 5)))])
    edges = np.cumsum(rng.uniform(0.3, 1.0, len(colors)))
    period = rng.uniform(6, 80) * edges[-1]
    table = colors[np.searchsorted(edges / edges[-1], np.arange(256) / 256)]
    return _painted((along * np.float32(256 / period)).astype(np.int32) & 255, table)


def tiles(rng: np.random.Generator, width: int, height: int) -> RGB:
    """Tiles, bricks or a checkerboard, each tile a little different, with joints."""
    size_x = rng.uniform(10, 90)
    size_y = size_x * rng.choice([1.0, 1.0, 0.33, 0.5])
    table = random_color(rng) + rng.normal(0, rng.uniform(2, 25), (64, 64, 1)) + rng.normal(0, 4, (64, 64, 3))
    if size_x == size_y and rng.random() < 0.5:
        table[(np.indices((64, 64)).sum(axis=0) % 2) == 0] = random_color(rng)
    joint, joint_color = rng.uniform(0.0, 0.05) * size_x, random_color(rng)
    y, shift = np.arange(height), size_x / 2 if size_y < size_x else 0.0
    row = (y // size_y).astype(np.int32)
    x = np.arange(width) + np.array([[0.0], [shift]])  # of even and odd rows
    column = (x // size_x).astype(np.int32) % 64
    column[x % size_x < joint] = 64 * 64
    index = np.minimum((row % 64 * 64)[:, None] + column[row % 2], 64 * 64)
    index[y % size_y < joint] = 64 * 64
    return _painted(index, np.vstack([table.reshape(-1, 3), joint_color]))


def carpet(rng: np.random.Generator, width: int, height: int) -> RGB:
    """Fine grain: carpet, cork, concrete, gravel."""
    fine = rng.integers(0, 256, (height, width), np.uint8)
    grain = cv2.GaussianBlur(fine, (0, 0), rng.uniform(0.6, 1.6)).astype(np.float32)
    grain = _stretched(grain)
    return colored(cv2.addWeighted(grain, 0.7, clouds(rng, width, height, 3), 0.3, 0.0), rng, 4, 35.0)


def printed(rng: np.random.Generator, width: int, height: int) -> RGB:
    """Paper with lines of what looks like print, headings and pictures."""
    rgb = np.full((height, width, 3), np.clip(random_color(rng) * 0.3 + 170, 0, 255).astype(np.uint8), np.uint8)
    ink = tuple(map(int, random_color(rng) * 0.4))
    step = int(rng.integers(5, 18))
    for y in range(step, height - step, step):
        if rng.random() < 0.06:
            x0, x1 = sorted(map(int, rng.integers(0, width, 2)))
            rgb[y : y + 4 * step, x0:x1] = random_color(rng).astype(np.uint8)
            continue
        letters = rng.random(width // 3 + 1) < 0.6
        words = np.repeat(letters & (np.convolve(rng.random(len(letters)) < 0.14, [1, 1], "same") == 0), 3)[:width]
        words[int(rng.uniform(0.6, 1.0) * width) :] = False
        rgb[y : y + max(1, step // 2)][:, words] = ink
    return rgb


SURFACES: tuple[Callable[[np.random.Generator, int, int], RGB], ...] = (
    *(gradient, marble, marble, wood, wood),
    *(stripes, tiles, tiles, carpet, printed),
)
"""All kinds, the frequent ones twice."""


def random_surface(rng: np.random.Generator, width: int, height: int) -> RGB:
    """One of the kinds."""
    return SURFACES[int(rng.integers(len(SURFACES)))](rng, width, height)


def _stretched(values: Field) -> Field:
    """Bring values to the range 0..1."""
    low, high, _, _ = cv2.minMaxLoc(values)
    scale = 1.0 / max(high - low, 1e-9)
    return (values - np.float32(low)) * np.float32(scale)


@lru_cache(maxsize=8)
def _grid(width: int, height: int) -> tuple[Field, Field]:
    """Column and row of each pixel; not to be written to."""
    y, x = np.indices((height, width), np.float32)
    return x, y


def _turned(x: Field, y: Field, rng: np.random.Generator) -> Field:
    angle = rng.uniform(0, np.pi)
    return cos(angle) * x + sin(angle) * y
