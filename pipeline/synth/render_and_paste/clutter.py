"""Simple things to strew over made-up backgrounds: boxes, cans, balls, sheets, sticks and cables, with shadows."""

from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import UInt8

from pipeline.synth.render_and_paste.patterns import RGB, random_color, random_surface

Polygon = np.ndarray
Surface = UInt8[np.ndarray, "sh sw 3"]


def strew(rgb: RGB, rng: np.random.Generator, count: int) -> None:
    """Paint things over an image: boxes, cans, balls, sheets, sticks and cables, many with a shadow."""
    height, width = rgb.shape[:2]
    print_ = random_surface(rng, 192, 192)  # on the sides of boxes
    for size in rng.uniform(0.03, 0.3, count) ** 1.3 * width:
        middle = rng.uniform([-20, 0], [width + 20, height + 20])
        kind = rng.random()
        if kind < 0.35:
            _box(rgb, rng, middle, float(size), print_)
        else:
            thing = (_can, _ball, _sheet, _stick, _cable)[int(rng.integers(5))]
            thing(rgb, rng, middle, float(size))


def _box(rgb: RGB, rng: np.random.Generator, middle: np.ndarray, size: float, print_: Surface) -> None:
    """A box: three faces that meet in a corner, each of its own brightness."""
    ends = np.array([0.3, 2.4, 4.5]) + rng.uniform(-0.45, 0.45, 3)  # directions of the three edges
    a, b, c = np.stack([np.cos(ends), np.sin(ends)], axis=1) * rng.uniform(0.3, 1.0, (3, 1)) * size
    color, shades = random_color(rng), rng.permutation([1.0, rng.uniform(0.6, 0.9), rng.uniform(0.3, 0.7)])
    _shadow(rgb, rng, middle + np.array([a, a + b, b, b + c, c, c + a]))
    for (u, v), shade in zip(((a, b), (b, c), (c, a)), shades, strict=True):
        side = middle + np.array([0 * u, u, u + v, v])
        _fill(rgb, side, color * shade, rng)
        if rng.random() < 0.3:
            _stick_on(rgb, side, print_)


def _can(rgb: RGB, rng: np.random.Generator, middle: np.ndarray, size: float) -> None:
    """An upright cylinder: bands of brightness round it, and a lid."""
    radius, tall, flat = 0.3 * size, rng.uniform(0.4, 1.2) * size, rng.uniform(0.15, 0.5)
    color, light = random_color(rng), rng.uniform(-1, 1)
    outline = middle + np.array([[-radius, 0], [radius, 0], [radius, tall], [-radius, tall]])
    _shadow(rgb, rng, outline)
    turns = np.linspace(-1, 1, 9)
    for start, end in pairwise(turns):
        x, drop = radius * np.sin([start * 1.57, end * 1.57]), radius * flat * np.cos([start * 1.57, end * 1.57])
        band = [[x[0], drop[0]], [x[1], drop[1]], [x[1], drop[1] + tall], [x[0], drop[0] + tall]]
        _fill(rgb, middle + np.array(band), color * (0.35 + 0.65 * np.cos((start + end) / 2 - light) ** 2), None)
    axes = (max(1, round(radius)), max(1, round(radius * flat)))
    lid = np.clip(color * rng.uniform(0.8, 1.4), 0, 255)
    cv2.ellipse(rgb, _pixel(middle), axes, 0, 0, 360, tuple(map(int, lid)), -1, cv2.LINE_AA)


def _ball(rgb: RGB, rng: np.random.Generator, middle: np.ndarray, size: float) -> None:
    """A ball, lit from a side."""
    color, radius = random_color(rng), max(2.0, 0.35 * size)
    towards = rng.uniform(-0.5, 0.5, 2)
    for share in np.linspace(1.0, 0.08, 14):
        lit = np.clip(color * (0.4 + 0.75 * (1 - share)), 0, 255)
        place = _pixel(middle + towards * radius * (1 - share))
        cv2.circle(rgb, place, max(1, round(radius * share)), tuple(map(int, lit)), -1, cv2.LINE_AA)


def _sheet(rgb: RGB, rng: np.random.Generator, middle: np.ndarray, size: float) -> None:
    """A flat thing with a pattern on it: a book, a print, a cloth."""
    angles = np.sort(rng.uniform(0, 2 * np.pi, int(rng.integers(4, 7))))
    outline = middle + size * rng.uniform(0.4, 0.7) * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    _shadow(rgb, rng, outline)
    _stick_on(rgb, outline, random_surface(rng, max(4, round(1.5 * size)), max(4, round(1.5 * size))))


def _stick_on(rgb: RGB, outline: Polygon, surface: Surface) -> None:
    """Fill a convex outline with a surface, as far as that and the image reach."""
    x0, y0 = np.maximum(np.floor(outline.min(axis=0)), 0).astype(int)
    x1, y1 = np.minimum(np.ceil(outline.max(axis=0)) + 1, rgb.shape[1::-1]).astype(int)
    width, height = min(x1 - x0, surface.shape[1]), min(y1 - y0, surface.shape[0])
    if width < 2 or height < 2:
        return
    mask = np.zeros((height, width), np.uint8)
    cv2.fillConvexPoly(mask, np.rint(outline - [x0, y0]).astype(np.int32), 255, cv2.LINE_AA)
    cv2.copyTo(surface[:height, :width], mask, rgb[y0 : y0 + height, x0 : x0 + width])


def _stick(rgb: RGB, rng: np.random.Generator, middle: np.ndarray, size: float) -> None:
    angle = rng.uniform(0, np.pi)
    along = np.array([np.cos(angle), np.sin(angle)]) * size
    across = np.array([-np.sin(angle), np.cos(angle)]) * size * rng.uniform(0.02, 0.12)
    color = random_color(rng)
    for part, shade in ((1.0, 0.6), (0.6, 0.9), (0.2, 1.2)):  # brighter along its middle, as round sticks are
        corners = [-along - part * across, along - part * across, along + part * across, -along + part * across]
        _fill(rgb, middle + np.array(corners), color * shade, None)


def _cable(rgb: RGB, rng: np.random.Generator, middle: np.ndarray, size: float) -> None:
    steps = rng.normal(0, 0.35, 24).cumsum() + rng.uniform(0, 6.28)
    points = middle + np.cumsum(np.stack([np.cos(steps), np.sin(steps)], axis=1) * size * 0.12, axis=0)
    color = tuple(map(int, random_color(rng) * 0.8))
    cv2.polylines(rgb, [np.rint(points).astype(np.int32)], False, color, int(rng.integers(1, 6)), cv2.LINE_AA)


def _fill(rgb: RGB, outline: Polygon, color: np.ndarray, rng: np.random.Generator | None) -> None:
    shade = tuple(map(int, np.clip(color, 0, 255)))
    cv2.fillConvexPoly(rgb, np.rint(outline * 16).astype(np.int32), shade, cv2.LINE_AA, 4)
    if rng is not None and rng.random() < 0.3:  # a label
        middle = outline.mean(axis=0)
        label = middle + (outline - middle) * rng.uniform(0.2, 0.8)
        other = tuple(map(int, random_color(rng) * color.mean() / 255))
        cv2.fillConvexPoly(rgb, np.rint(label * 16).astype(np.int32), other, cv2.LINE_AA, 4)


def _shadow(rgb: RGB, rng: np.random.Generator, outline: Polygon) -> None:
    """Darken what lies beside an outline, softly."""
    shift = rng.uniform([-6, -2], [6, 10])
    x0, y0 = np.maximum(np.floor((outline + shift).min(axis=0)) - 8, 0).astype(int)
    x1, y1 = np.minimum(np.ceil((outline + shift).max(axis=0)) + 9, rgb.shape[1::-1]).astype(int)
    if x1 - x0 < 4 or y1 - y0 < 4:
        return
    mask = np.zeros((y1 - y0, x1 - x0), np.uint8)
    hull = cv2.convexHull(np.rint(outline + shift - [x0, y0]).astype(np.int32))
    cv2.fillConvexPoly(mask, hull, int(rng.uniform(60, 160)))
    light = cv2.merge([255 - cv2.blur(mask, (9, 9))] * 3)
    part = rgb[y0:y1, x0:x1]
    cv2.multiply(part, light, part, 1 / 255)


def _pixel(point: np.ndarray) -> tuple[int, int]:
    return round(float(point[0])), round(float(point[1]))
