"""Procedural printed pictures: pages, labels, book covers, screens, paintings and the view from a window."""

from __future__ import annotations

import colorsys

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from pipeline.synth.materials import Texture
from pipeline.synth.worlds.noise import clouds, jittered, mixed

Color = tuple[float, float, float]

_LETTERS = "ABDEFGHIKLMNOPRSTUVZ"
_SYLLABLES = ("ka", "lo", "mi", "ren", "to", "sal", "ve", "nor", "du", "pel", "ha", "zin", "bro", "fe", "gal", "ti")


def picture(image: np.ndarray, width: float, height: float) -> Texture:
    """A picture that covers a rectangle of the given size once."""
    return Texture(np.clip(np.rint(image), 0, 255).astype(np.uint8), (width, height))


def vivid(rng: np.random.Generator, low: float = 0.35, high: float = 0.85) -> Color:
    """A colour of print: saturated, never glowing."""
    rgb = colorsys.hsv_to_rgb(rng.random(), rng.uniform(0.35, 0.9), rng.uniform(low, high))
    return 255 * rgb[0], 255 * rgb[1], 255 * rgb[2]


def muted(rng: np.random.Generator, low: float = 0.4, high: float = 0.9) -> Color:
    """A colour of furniture: pale, grayish or deep, not loud."""
    rgb = colorsys.hsv_to_rgb(rng.random(), rng.uniform(0.08, 0.42), rng.uniform(low, high))
    return 255 * rgb[0], 255 * rgb[1], 255 * rgb[2]


def word(rng: np.random.Generator, syllables: int = 3) -> str:
    """A word that is no brand's."""
    return "".join(rng.choice(_SYLLABLES, syllables)).capitalize()


def page(rng: np.random.Generator, width: float = 0.21, height: float = 0.297) -> Texture:
    """A sheet with a heading, lines of text and now and then a figure."""
    rows, columns = 594, round(594 * width / height)
    image = np.full((rows, columns, 3), 246, np.float32) - 5 * clouds(rng, 1024, 1.5)[:rows, :columns, None]
    y, ink = 46, (58.0, 58.0, 62.0)
    cv2.rectangle(image, (40, y), (int(rng.uniform(0.4, 0.8) * columns), y + 13), ink, -1)
    y += 40
    while y < rows - 50:
        if rng.random() < 0.05 and y < rows - 190:
            _figure(rng, image, (48, y, columns - 96, 120))
            y += 140
        _text_line(rng, image, y, 40, columns - 40 if rng.random() < 0.85 else int(columns * rng.uniform(0.3, 0.8)))
        y += 11 if rng.random() < 0.93 else 24
    return picture(image, width, height)


def cover(rng: np.random.Generator, width: float, height: float) -> Texture:
    """The front of a book or a box: a ground, a shape or picture, a title."""
    rows = 360
    columns = max(24, round(rows * width / height))
    ground, accent = vivid(rng, 0.25, 0.8), vivid(rng, 0.5, 0.95)
    image = mixed(ground, tuple(0.8 * np.array(ground)), clouds(rng, 512, 2.0)[:rows, :1].repeat(columns, 1))
    kind = rng.integers(4)
    if kind == 0:
        image[int(0.12 * rows) : int(0.4 * rows)] = accent
    elif kind == 1:
        _blobs(rng, image, 7)
    elif kind == 2:
        image[int(0.3 * rows) : int(0.85 * rows), int(0.1 * columns) : int(0.9 * columns)] = cv2.resize(
            painting(rng, 0.3, 0.3).image, (int(0.9 * columns) - int(0.1 * columns), int(0.85 * rows) - int(0.3 * rows))
        )
    _write(image, word(rng), (0.08, 0.10), 0.16, _contrasting(image[int(0.16 * rows), columns // 2]))
    _write(image, f"{word(rng)} {word(rng, 2)}", (0.08, 0.9), 0.05, _contrasting(image[int(0.93 * rows), columns // 2]))
    return picture(image, width, height)


def spines(rng: np.random.Generator, count: int, width: float, height: float) -> Texture:
    """The backs of a row of books, seen side by side."""
    rows, columns = 320, 40 * count
    image = np.empty((rows, columns, 3), np.float32)
    for k in range(count):
        ground = vivid(rng, 0.2, 0.8) if rng.random() < 0.8 else jittered(rng, (225, 220, 208), 15)
        spine = np.full((40, rows, 3), ground, np.float32)
        spine[:, 20:26] = spine[:, rows - 40 : rows - 34] = vivid(rng, 0.4, 0.95)
        _write(spine, f"{word(rng)} {word(rng, 2)}", (0.16, 0.28), 0.5, _contrasting(np.array(ground)))
        spine[[0, 1, -2, -1]] *= 0.6
        image[:, 40 * k : 40 * k + 40] = np.rot90(spine, -1)
    return picture(image, width, height)


def label(rng: np.random.Generator, width: float, height: float) -> Texture:
    """What is wrapped around a bottle, a can or a jar: bands, a name, small print, a bar code."""
    columns = 1024
    rows = max(64, round(columns * height / width))
    ground, accent = jittered(rng, (238, 234, 224), 10) if rng.random() < 0.5 else vivid(rng), vivid(rng)
    image = np.full((rows, columns, 3), ground, np.float32)
    image[: int(0.14 * rows)] = image[int(0.84 * rows) :] = accent
    if rng.random() < 0.6:
        cv2.ellipse(image, (columns // 4, rows // 2), (120, int(0.3 * rows)), 0, 0, 360, vivid(rng), -1, cv2.LINE_AA)
    for start in (0.10, 0.58):
        _write(image, word(rng), (start, 0.36), 0.26, _contrasting(np.array(ground)))
        _write(image, word(rng, 4), (start + 0.02, 0.68), 0.08, _contrasting(np.array(ground)))
    for y in range(int(0.3 * rows), int(0.75 * rows), 12):
        _text_line(rng, image, y, 840, 930)
    _bar_code(rng, image[int(0.4 * rows) : int(0.72 * rows), 950:1010])
    return picture(image, width, height)


def screen(rng: np.random.Generator, width: float, height: float) -> Texture:
    """A monitor that shows some windows."""
    rows, columns = 540, 960
    top, bottom = vivid(rng, 0.15, 0.4), vivid(rng, 0.3, 0.6)
    image = mixed(top, bottom, np.linspace(0, 1, rows)[:, None].repeat(columns, 1))
    for _ in range(3):
        x, y = int(rng.uniform(20, 420)), int(rng.uniform(20, 180))
        w, h = int(rng.uniform(300, 500)), int(rng.uniform(220, 330))
        dark = rng.random() < 0.5
        cv2.rectangle(image, (x, y), (x + w, y + h), (38, 40, 46) if dark else (242, 242, 240), -1)
        cv2.rectangle(image, (x, y), (x + w, y + 18), (70, 76, 88), -1)
        for line in range(y + 30, y + h - 10, 12):
            _text_line(rng, image, line, x + 12, x + int(w * rng.uniform(0.3, 0.95)), 170.0 if dark else 80.0)
    image[-26:] = (32, 34, 40)
    return picture(image, width, height)


def painting(rng: np.random.Generator, width: float, height: float) -> Texture:
    """Something for the wall: hills, coloured blobs or stripes."""
    rows = 400
    columns = max(40, round(rows * width / height))
    kind = rng.integers(3)
    if kind == 0:
        image = _hills(rng, rows, columns)
    else:
        ground = jittered(rng, (230, 224, 212), 16)
        image = mixed(ground, vivid(rng, 0.5, 0.9), clouds(rng, 512, 1.8)[:rows, :1].repeat(columns, 1) * 0.5)
        _blobs(rng, image, 16) if kind == 1 else _stripes(rng, image)
    canvas = clouds(rng, 512, 0.6, low=30)[:rows]
    canvas = np.tile(canvas, (1, columns // 512 + 1))[:, :columns]
    return picture(image * (0.94 + 0.12 * canvas)[..., None], width, height)


def outdoors(rng: np.random.Generator, rows: int = 192, columns: int = 256) -> Float[np.ndarray, "h w 3"]:
    """The view from a window as linear radiance with mean 1: bright sky over blurred trees or houses."""
    height = np.linspace(1, 0, rows)[:, None].repeat(columns, 1)
    cloud = cv2.resize(clouds(rng, 256, 1.7, (2.5, 1.0)), (columns, rows))
    blue = np.clip((height - 0.25) * 1.3, 0, 1)[..., None] * rng.uniform(0.2, 1.0)
    sky = np.array((1.0, 1.0, 1.0)) * (1 - blue) + np.array((0.50, 0.70, 1.0)) * blue
    sky = sky + np.clip(cloud - 0.5, 0, 1)[..., None] * 0.8
    horizon = rng.uniform(0.18, 0.42) + 0.14 * (cv2.resize(clouds(rng, 256, 1.4), (columns, rows))[:1] - 0.5)
    leaves = cv2.resize(clouds(rng, 256, 1.0, low=6), (columns, rows))[..., None]
    ground = (
        np.array((0.20, 0.26, 0.13)) * (0.5 + leaves) if rng.random() < 0.6 else np.array((0.3, 0.27, 0.25)) * leaves
    )
    image = np.where((height < horizon)[..., None], ground, sky).astype(np.float32)
    image = cv2.GaussianBlur(image, (0, 0), columns / 90)
    return image / image.mean()


def beam_pattern(rng: np.random.Generator, bars: tuple[int, int] = (2, 2)) -> UInt8[np.ndarray, "h w 3"]:
    """The shape of a patch of sunlight: window panes between bars, with soft edges."""
    image = np.zeros((256, 256), np.float32)
    edges = [np.linspace(30, 226, count + 1) for count in bars]
    for x0, x1 in zip(edges[0][:-1], edges[0][1:], strict=True):
        for y0, y1 in zip(edges[1][:-1], edges[1][1:], strict=True):
            image[int(y0) + 5 : int(y1) - 5, int(x0) + 5 : int(x1) - 5] = 1.0
    image = cv2.GaussianBlur(image, (0, 0), float(rng.uniform(1.5, 4.0)))
    return np.repeat((255 * image).astype(np.uint8)[..., None], 3, axis=2)


def _contrasting(ground: np.ndarray) -> Color:
    return (34, 34, 38) if float(np.mean(ground)) > 120 else (238, 236, 228)


def _write(image: np.ndarray, text: str, at: tuple[float, float], height: float, color: Color) -> None:
    """Text whose upper left corner and letter height are given in shares of the picture; it is kept inside."""
    rows, columns = image.shape[:2]
    room = (0.98 - at[0]) * columns
    scale = height * rows / 30.0
    scale *= min(1.0, room / cv2.getTextSize(text, cv2.FONT_HERSHEY_DUPLEX, scale, 1)[0][0])
    origin = (int(at[0] * columns), int(at[1] * rows + 24 * scale))
    ink = np.zeros((rows, columns), np.uint8)  # letters can be drawn on 8-bit images only
    cv2.putText(ink, text, origin, cv2.FONT_HERSHEY_DUPLEX, scale, 255.0, max(1, round(1.6 * scale)), cv2.LINE_AA)
    image += (np.array(color, np.float32) - image) * (ink[..., None] / np.float32(255.0))


def _text_line(rng: np.random.Generator, image: np.ndarray, y: int, start: int, end: int, tone: float = 70.0) -> None:
    x = start
    while x < end:
        length = int(rng.uniform(6, 34))
        cv2.line(image, (x, y), (min(x + length, end), y), (tone, tone, tone + 4), 2)
        x += length + 5


def _figure(rng: np.random.Generator, image: np.ndarray, box: tuple[int, int, int, int]) -> None:
    x, y, width, height = box
    cv2.rectangle(image, (x, y), (x + width, y + height), (120, 120, 124), 1)
    for _ in range(2):
        values = y + height * (0.1 + 0.8 * clouds(rng, 64, 1.6)[0])
        points = np.stack([np.linspace(x, x + width, 64), values], axis=1).astype(np.int32)
        cv2.polylines(image, [points], False, vivid(rng), 2, cv2.LINE_AA)


def _blobs(rng: np.random.Generator, image: np.ndarray, count: int) -> None:
    rows, columns = image.shape[:2]
    for _ in range(count):
        centre = (int(rng.uniform(0, columns)), int(rng.uniform(0, rows)))
        axes = (int(rng.uniform(0.04, 0.25) * columns) + 1, int(rng.uniform(0.04, 0.2) * rows) + 1)
        cv2.ellipse(image, centre, axes, float(rng.uniform(0, 180)), 0, 360, vivid(rng), -1, cv2.LINE_AA)


def _stripes(rng: np.random.Generator, image: np.ndarray) -> None:
    columns, x = image.shape[1], 0
    while x < columns:
        width = int(rng.uniform(0.03, 0.16) * columns) + 2
        if rng.random() < 0.6:
            image[:, x : x + width] = vivid(rng, 0.3, 0.9)
        x += width


def _hills(rng: np.random.Generator, rows: int, columns: int) -> np.ndarray:
    """A landscape of hills that grow paler with distance."""
    sky = mixed(
        jittered(rng, (150, 186, 220), 20), (238, 226, 206), np.linspace(0, 1, rows)[:, None].repeat(columns, 1)
    )
    y = np.arange(rows)[:, None]
    for k in range(4):
        ridge = rows * (0.42 + 0.13 * k) + 60 * (np.interp(np.arange(columns), *_curve(rng, columns)) - 0.5)
        color = np.array(jittered(rng, (126, 148, 132), 12)) * (1.0 - 0.2 * k)
        sky = np.where((y > ridge[None, :])[..., None], color, sky)
    return sky.astype(np.float32)


def _curve(rng: np.random.Generator, columns: int) -> tuple[np.ndarray, np.ndarray]:
    return np.linspace(0, columns, 128), clouds(rng, 128, 1.6)[0]


def _bar_code(rng: np.random.Generator, image: np.ndarray) -> None:
    image[:] = 245
    image[:, rng.random(image.shape[1]) < 0.5] = 25
