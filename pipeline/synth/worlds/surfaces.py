"""Procedural textures of building materials and furniture: wood, stone, tiles, fabric, metal, concrete, plaster."""

from __future__ import annotations

from itertools import pairwise

import cv2
import numpy as np
from jaxtyping import Float

from pipeline.synth.materials import Texture
from pipeline.synth.worlds.noise import clouds, jittered, mixed

SIZE = 1024
"""Pixels of a texture along each side."""

Color = tuple[float, float, float]

WOODS: dict[str, tuple[Color, Color]] = {
    "oak": ((206, 172, 128), (158, 118, 78)),
    "beech": ((222, 188, 148), (192, 148, 108)),
    "walnut": ((126, 88, 60), (76, 50, 34)),
    "pine": ((228, 196, 146), (196, 146, 92)),
    "cherry": ((178, 112, 70), (132, 72, 42)),
    "birch": ((232, 212, 180), (208, 178, 138)),
    "gray oak": ((168, 156, 142), (122, 108, 96)),
    "wenge": ((82, 62, 50), (48, 36, 30)),
}


def _texture(image: np.ndarray, size: float, relief: np.ndarray | None = None, depth: float = 0.0) -> Texture:
    picture = np.clip(np.rint(image), 0, 255).astype(np.uint8)
    return Texture(picture, (size, size), None if relief is None else relief.astype(np.float32), depth)


def wood(rng: np.random.Generator, kind: str = "oak", size: float = 1.1) -> Texture:
    """Boards cut along the grain (first texture coordinate): year rings that bend, fibres and pores."""
    light, dark = (jittered(rng, color, 8) for color in WOODS[kind])
    y = np.arange(SIZE)[:, None] / SIZE
    bend = clouds(rng, SIZE, 2.0, (7.0, 1.0)) - 0.5
    rings = (y * rng.integers(7, 14) + 2.4 * bend + 0.12 * (clouds(rng, SIZE, 1.2, (16, 1)) - 0.5)) % 1.0
    fibres = clouds(rng, SIZE, 0.7, (60.0, 1.0), low=8)
    pores = np.clip(clouds(rng, SIZE, 0.4, (26.0, 1.0), low=30) - 0.62, 0, 1) * 2.2
    shade = 0.42 * rings**2.2 + 0.75 * (fibres - 0.36) + 0.3 * (clouds(rng, SIZE, 1.8) - 0.5)
    return _texture(mixed(light, dark, shade + pores), size, 1.0 - pores - 0.4 * fibres, 0.0003)


def planks(rng: np.random.Generator, kind: str = "oak", width: float = 0.14, size: float = 1.68) -> Texture:
    """A floor of boards, each from another place of the trunk, with thin joints."""
    grain = wood(rng, kind).image.astype(np.float32)
    count = round(size / width)
    rows = np.linspace(0, SIZE, count + 1).astype(int)
    image, relief = np.empty_like(grain), np.ones((SIZE, SIZE), np.float32)
    for top, bottom in pairwise(rows.tolist()):
        shift, end = rng.integers(0, SIZE, 2)
        board = np.roll(grain, (int(shift) // 3, int(shift)), axis=(0, 1))[top:bottom] * rng.uniform(0.86, 1.08)
        board[:, end : end + 2] *= 0.45
        board[:1] *= 0.5
        image[top:bottom], relief[top : top + 2] = board, 0.0
        relief[top:bottom, end : end + 2] = 0.0
    return _texture(image, size, relief, 0.0012)


def tiles(
    rng: np.random.Generator, color: Color = (226, 226, 222), columns: int = 4, rows: int = 4, size: float = 0.6
) -> Texture:
    """Ceramic tiles with joints; every second row is shifted by half a tile where there are more rows than columns."""
    ceramic, joint = jittered(rng, color, 6), jittered(rng, (168, 164, 156), 14)
    y, x = np.mgrid[0:SIZE, 0:SIZE] / SIZE
    row = np.floor(y * rows).astype(int)
    along = x * columns + (0.5 * (row % 2) if rows > columns else 0.0)
    column = np.floor(along).astype(int) % columns
    tone = rng.normal(0.0, 5.0, (rows, columns))[row, column]
    edge = np.minimum(
        *(np.abs((v % 1.0) - 0.5) * -1 + 0.5 for v in (along, y * rows))
    )  # distance to the border, in tiles
    edge_px = edge * SIZE / max(rows, columns)
    inside = np.clip((edge_px - 1.5) / 1.5, 0, 1)
    body = mixed(ceramic, tuple(0.9 * np.array(ceramic)), clouds(rng, SIZE, 1.7) * 0.5) + tone[..., None]
    grout = mixed(joint, tuple(0.7 * np.array(joint)), clouds(rng, SIZE, 0.8))
    image = grout + (body - grout) * inside[..., None]
    return _texture(image, size, np.clip(edge_px / 6.0, 0, 1) ** 0.5, 0.0015)


def stone(rng: np.random.Generator, color: Color = (92, 90, 88), size: float = 0.5) -> Texture:
    """Granite: grains of several minerals."""
    base = mixed(jittered(rng, color, 8), tuple(0.72 * np.array(color)), clouds(rng, SIZE, 1.2, low=6))
    for tone, slope, threshold in ((1.7, 0.7, 0.66), (0.35, 0.6, 0.68), (1.35, 0.9, 0.62), (2.1, 0.3, 0.75)):
        grains = np.clip((clouds(rng, SIZE, slope, low=40) - threshold) * 14, 0, 1)[..., None]
        base = base * (1 - grains) + np.clip(np.array(color) * tone + 12, 0, 245) * grains
    return _texture(base, size)


def marble(rng: np.random.Generator, color: Color = (232, 230, 226), size: float = 1.2) -> Texture:
    """Light stone with bent veins."""
    vein = np.zeros((SIZE, SIZE), np.float32)
    for width, strength in ((0.012, 0.8), (0.02, 0.5), (0.006, 0.7)):
        field = clouds(rng, SIZE, 1.75)
        vein = np.maximum(vein, strength * np.exp(-(((field - 0.5) / width) ** 2)) * clouds(rng, SIZE, 1.6))
    base = mixed(jittered(rng, color, 5), tuple(0.88 * np.array(color)), clouds(rng, SIZE, 2.0))
    gray = np.array(jittered(rng, (128, 124, 120), 14), np.float32)
    return _texture(base + (gray - base) * np.clip(vein * 1.3, 0, 1)[..., None], size)


def fabric(rng: np.random.Generator, color: Color = (120, 128, 138), thread: float = 0.0016) -> Texture:
    """A plain weave of slightly uneven threads."""
    count = 64
    phase = np.arange(SIZE) * (count / SIZE)
    warp, weft = np.abs(np.sin(np.pi * phase))[None, :], np.abs(np.sin(np.pi * phase))[:, None]
    over = ((phase.astype(int)[None, :] + phase.astype(int)[:, None]) % 2).astype(np.float32)
    height = over * (0.5 + 0.5 * warp) * (0.35 + 0.65 * weft) + (1 - over) * (0.5 + 0.5 * weft) * (0.35 + 0.65 * warp)
    uneven = 0.10 * (clouds(rng, SIZE, 0.8, (20, 1)) + clouds(rng, SIZE, 0.8, (1, 20)) - 1.0)
    tone = 0.62 + 0.42 * height + uneven + 0.12 * (clouds(rng, SIZE, 1.6) - 0.5)
    return _texture(np.array(jittered(rng, color, 8)) * tone[..., None], count * thread, height, 0.4 * thread)


def carpet(rng: np.random.Generator, color: Color = (148, 138, 126), stripes: int = 0) -> Texture:
    """Short pile, in one colour or with a pattern of stripes, 1.2 m wide."""
    pile = clouds(rng, SIZE, 0.25, low=60)
    tone = 0.86 + 0.5 * (pile - 0.5) + 0.25 * (clouds(rng, SIZE, 1.5) - 0.5)
    base = np.broadcast_to(np.array(jittered(rng, color, 8), np.float32), (SIZE, SIZE, 3)).copy()
    if stripes:
        second = np.array(jittered(rng, tuple(0.55 * np.array(color) + 20), 20))
        x = (np.arange(SIZE) * stripes / SIZE) % 1.0
        base[:, (x < 0.32) | ((x > 0.62) & (x < 0.7))] = second
    return _texture(base * tone[..., None], 1.2, pile, 0.003)


def brushed_metal(rng: np.random.Generator, color: Color = (205, 205, 204), size: float = 0.5) -> Texture:
    """Fine scratches along the first texture coordinate."""
    streaks = clouds(rng, SIZE, 0.35, (70.0, 1.0), low=6)
    tone = 0.93 + 0.22 * (streaks - 0.5) + 0.06 * (clouds(rng, SIZE, 1.6) - 0.5)
    return _texture(np.array(color) * tone[..., None], size)


def concrete(rng: np.random.Generator, color: Color = (150, 148, 144), size: float = 2.2) -> Texture:
    """Clouds, stains and pores."""
    cloud, fine = clouds(rng, SIZE, 1.7), clouds(rng, SIZE, 0.6, low=30)
    pores = np.clip((clouds(rng, SIZE, 0.9, low=20) - 0.74) * 9, 0, 1)
    stains = np.clip((clouds(rng, SIZE, 1.9) - 0.58) * 3, 0, 1)
    tone = 0.95 + 0.30 * (cloud - 0.5) + 0.12 * (fine - 0.5) - 0.35 * pores - 0.14 * stains
    return _texture(np.array(jittered(rng, color, 8)) * tone[..., None], size, 0.5 * fine + 0.5 * (1 - pores), 0.0015)


def plaster(rng: np.random.Generator, color: Color = (232, 228, 220), size: float = 1.5) -> Texture:
    """A painted wall: hardly any colour of its own, a rolled-on grain."""
    grain = clouds(rng, SIZE, 0.7, low=24)
    tone = 0.985 + 0.03 * (clouds(rng, SIZE, 1.8) - 0.5) + 0.02 * (grain - 0.5)
    return _texture(np.array(jittered(rng, color, 4)) * tone[..., None], size, grain, 0.0022)


def bricks(rng: np.random.Generator, color: Color = (164, 96, 72), size: float = 1.0) -> Texture:
    """A wall of bricks in mortar."""
    wall = tiles(rng, color, columns=4, rows=12, size=size)
    image = wall.image.astype(np.float32)
    image *= (0.80 + 0.45 * clouds(rng, SIZE, 1.0, low=8))[..., None]
    assert wall.relief is not None
    return _texture(image, size, 0.8 * wall.relief + 0.2 * clouds(rng, SIZE, 1.0, low=8), 0.004)


def speckled(rng: np.random.Generator, color: Color = (190, 190, 186), size: float = 0.6) -> Texture:
    """Laminate, moulded plastic or rubber: one colour with a fine grain and faint clouds."""
    grain = clouds(rng, SIZE, 0.3, low=80)
    tone = 0.97 + 0.10 * (grain - 0.5) + 0.08 * (clouds(rng, SIZE, 1.7) - 0.5)
    return _texture(np.array(jittered(rng, color, 6)) * tone[..., None], size, grain, 0.00025)


def worn_metal(rng: np.random.Generator, color: Color = (108, 120, 124), size: float = 0.8) -> Texture:
    """Painted sheet metal with scratches, scuffs and dirt."""
    image = np.empty((SIZE, SIZE, 3), np.float32)
    image[:] = np.array(jittered(rng, color, 8))
    image *= (0.95 + 0.18 * (clouds(rng, SIZE, 1.6) - 0.5) - 0.25 * _scratches(rng, 90))[..., None]
    bare = np.clip((clouds(rng, SIZE, 1.3, low=4) - 0.76) * 10, 0, 1)[..., None]
    return _texture(image * (1 - bare) + np.array((150, 146, 140)) * bare, size)


def cardboard(rng: np.random.Generator, color: Color = (184, 148, 108), size: float = 0.5) -> Texture:
    """Brown fibres over faint corrugation."""
    fibres = clouds(rng, SIZE, 0.8, (4.0, 1.0), low=10)
    wave = np.sin(2 * np.pi * 70 * np.arange(SIZE) / SIZE)[None, :]
    tone = 0.97 + 0.14 * (fibres - 0.5) + 0.012 * wave + 0.08 * (clouds(rng, SIZE, 1.8) - 0.5)
    return _texture(
        np.array(jittered(rng, color, 10)) * tone[..., None], size, 0.5 + 0.5 * wave * np.ones((SIZE, 1)), 2e-4
    )


def pegboard(rng: np.random.Generator, color: Color = (214, 206, 190), pitch: float = 0.025) -> Texture:
    """A board with a grid of holes."""
    y, x = np.mgrid[0:SIZE, 0:SIZE] * (16 / SIZE) % 1.0 - 0.5
    hole = np.clip((0.14 - np.hypot(x, y)) * 30, 0, 1)
    tone = (1 - 0.82 * hole) * (0.97 + 0.06 * (clouds(rng, SIZE, 1.0) - 0.5))
    return _texture(np.array(jittered(rng, color, 6)) * tone[..., None], 16 * pitch, 1 - hole, 0.003)


def _scratches(rng: np.random.Generator, count: int) -> Float[np.ndarray, "n n"]:
    mask = np.zeros((SIZE, SIZE), np.float32)
    for _ in range(count):
        start = rng.uniform(0, SIZE, 2)
        end = start + rng.normal(0, 1, 2) * rng.uniform(20, 160)
        color = float(rng.uniform(0.3, 1.0))
        cv2.line(mask, start.astype(int).tolist(), end.astype(int).tolist(), color, 1, cv2.LINE_AA)
    return mask
