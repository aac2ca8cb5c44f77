"""Plants, vases, cushions, pictures. Each thing stands on z = 0; what hangs on walls has its back at y = 0."""

from __future__ import annotations

import numpy as np

from pipeline.synth.materials import Material, paint, textured
from pipeline.synth.worlds import prints, surfaces
from pipeline.synth.worlds.finishes import BLACK, WHITE, glaze
from pipeline.synth.worlds.layout import Thing
from pipeline.synth.worlds.shapes import Shape, box, cylinder, joined, sheet, surface, turned, upright


def plant(rng: np.random.Generator, height: float = 0.4) -> Thing:
    """A pot with leaves that bend over."""
    r = 0.28 * height
    pot = turned([(0, 0), (0.68 * r, 0), (r, 1.35 * r), (1.05 * r, 1.35 * r), (1.05 * r, 1.5 * r), (0.95 * r, 1.5 * r),
                  (0.93 * r, 1.35 * r), (0, 1.33 * r)])  # fmt: skip
    clay = paint(174, 104, 72, roughness=0.85) if rng.random() < 0.5 else glaze(rng)
    green = paint(*np.array((62, 104, 48)) * rng.uniform(0.7, 1.2), roughness=0.45)
    soil = cylinder(0.92 * r, 0.004).moved(z=1.34 * r).piece("soil", paint(52, 38, 28, roughness=1.0))
    count = int(rng.integers(12, 22))
    leaves = [
        _leaf(rng, height).moved(z=1.34 * r, turn_deg=360.0 * k / count + rng.uniform(-14, 14)) for k in range(count)
    ]
    return [pot.piece("pot", clay), soil, joined(leaves).piece("leaves", green)]


def _leaf(rng: np.random.Generator, height: float) -> Shape:
    """A long leaf that rises from the origin and bends towards +x."""
    length, width = height * rng.uniform(0.6, 1.05), height * rng.uniform(0.05, 0.10)
    rise = rng.uniform(0.5, 1.35)
    t = np.linspace(0, 1, 12)
    bend = rise - t * rng.uniform(0.5, 1.5)
    step = length / len(t)
    spine = np.stack([np.cumsum(np.cos(bend)) * step, 0 * t, np.cumsum(np.sin(bend)) * step], axis=1)
    half = width * np.sin(np.pi * np.clip(t * 0.96 + 0.04, 0, 1)) ** 0.8
    across = np.linspace(-1, 1, 5)
    points = spine[:, None, :] + np.stack(
        [np.zeros((12, 5)), half[:, None] * across, 0.25 * half[:, None] * np.abs(across)], axis=-1
    )
    return surface(points)


def vase(rng: np.random.Generator) -> Thing:
    """A vase."""
    h, r = float(rng.uniform(0.16, 0.3)), float(rng.uniform(0.045, 0.08))
    t = np.linspace(0, 1, 16)
    radius = r * (0.62 + 0.38 * np.sin(np.pi * (0.15 + 0.8 * t ** rng.uniform(0.7, 1.5))))
    outer = [(float(x), float(h * z)) for x, z in zip(radius, t, strict=True)]
    inner = [(x - 0.004, z) for x, z in outer[:2:-1]]
    return [turned([(0, 0), *outer, *inner, (0, outer[3][1])]).piece("vase", glaze(rng))]


def candle(rng: np.random.Generator) -> Thing:
    """A candle on a dish."""
    wax = (
        cylinder(0.03, rng.uniform(0.06, 0.14), 0.004)
        .moved(z=0.01)
        .piece("candle", paint(236, 226, 204, roughness=0.5))
    )
    return [cylinder(0.055, 0.01, 0.003).piece("dish", glaze(rng)), wax]


def cushion(rng: np.random.Generator, material: Material) -> Thing:
    """A square cushion that lies flat."""
    n, half = 25, float(rng.uniform(0.19, 0.23))
    s = np.linspace(-1, 1, n)
    x, y = np.meshgrid(s, s, indexing="ij")
    bulge = ((1 - x**2) * (1 - y**2)) ** 0.42
    pinch = 1 - 0.07 * (x**2 * (1 - y**2) + y**2 * (1 - x**2))
    sides = []
    for sign in (1, -1):
        z = 0.075 + sign * 0.075 * bulge
        points = np.stack([half * x * pinch, half * y * pinch, z], axis=-1)
        sides.append(surface(points if sign > 0 else points[::-1]))
    body = box(1.7 * half, 1.7 * half, 0.14)
    hull = joined(sides)
    return [Shape(hull.vertices, hull.faces, hull.normals, hull.uv, body.hulls).piece("cushion", material)]


def picture_frame(rng: np.random.Generator, width: float, height: float) -> list[tuple[Shape, Material]]:
    """A painting in a frame for a wall: its back at y = 0, its lower edge at z = 0, centred."""
    wood = paint(30) if rng.random() < 0.4 else textured(surfaces.wood(rng, "walnut", 0.5), 0.5)
    rails = [box(width, 0.02, 0.025).moved(y=-0.01, z=z) for z in (0.0, height - 0.025)]
    rails += [box(0.025, 0.02, height).moved(x=s * (width - 0.025) / 2, y=-0.01) for s in (-1, 1)]
    art = textured(prints.painting(rng, width - 0.05, height - 0.05), roughness=0.7)
    canvas = upright(sheet(width - 0.05, height - 0.05)).moved(y=-0.006, z=height / 2)
    return [(joined(rails), wood), (canvas, art)]


def clock(rng: np.random.Generator) -> list[tuple[Shape, Material]]:
    """A wall clock: back at y = 0, centred at the origin."""
    rim = turned([(0, 0), (0.15, 0), (0.15, 0.03), (0.138, 0.034), (0.136, 0.02), (0, 0.02)]).tilted("x", 90.0)
    hour, minute = rng.uniform(0, 360, 2)
    hands = [box(0.008, 0.002, length, 0.0005).moved(y=-0.024).tilted("y", float(angle))
             for length, angle in ((0.075, hour), (0.115, minute))]  # fmt: skip
    marks = [box(0.006, 0.002, 0.018, 0.0005).moved(y=-0.022, z=0.108).tilted("y", 30.0 * k) for k in range(12)]
    return [(rim, WHITE), (joined([*hands, *marks]), BLACK)]
