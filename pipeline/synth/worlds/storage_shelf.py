"""A shelf of bins in a storeroom, like that of the Amazon Picking Challenge (the thesis's Scene 6): a stage per bin."""

from __future__ import annotations

import numpy as np

from pipeline.synth.materials import paint, textured
from pipeline.synth.worlds import furniture, rooms, surfaces, things
from pipeline.synth.worlds.layout import Furnished, frame
from pipeline.synth.worlds.shapes import box, joined
from pipeline.synth.worlds.world import World

SIZE = (4.0, 3.6, 2.7)
COLUMNS, ROWS = 3, 4
BIN = (0.30, 0.42, 0.25)
"""Inside width, depth and height of a bin."""
WALL = 0.012
LIP = 0.03
"""Height of the edge at the front of a bin."""
TOTE = (0.36, 0.26, 0.11)
"""Inside width, depth and height of the box on the trolley."""
TOTE_WALL = 0.006
FIRST = 0.55
"""Height of the lowest bins' bottom."""


def storage_shelf(seed: int) -> World:
    """Stages: one per bin (`bin A1` at the upper left to `bin D3`), a trolley, and an open `tote` on it."""
    rng = np.random.default_rng([seed, 6])
    scene = Furnished(SIZE, rng)
    floor = textured(surfaces.concrete(rng, (158, 158, 156)), 0.5, 0.4)
    wall = textured(surfaces.plaster(rng, (222, 224, 224)), 0.9, 0.0)
    rooms.shell(scene, floor, wall, {}, (0.0, 0.0, 0.0))
    _bins(scene)
    _room(scene)
    kelvin, strength = rng.uniform(3400, 6500), rng.uniform(8, 16)
    for x in (1.0, 3.0):
        rooms.ceiling_panel(scene, x, 1.5, (0.3, 1.2), rooms.light(kelvin, strength))
    return rooms.finished("storage_shelf", seed, scene)


def _bins(scene: Furnished) -> None:
    rng = scene.rng
    width, depth, height = BIN
    colors = [(214, 202, 176), (198, 200, 202), (186, 150, 110), (228, 226, 220)]
    color = colors[int(rng.integers(len(colors)))]
    makers = (surfaces.cardboard, surfaces.speckled)
    board = textured(makers[int(rng.integers(2))](rng, color), 0.8, 0.0)
    at = scene.wall("north", SIZE[0] / 2)
    total = COLUMNS * (width + WALL) + WALL
    tall = ROWS * (height + WALL) + WALL
    posts = [box(WALL, depth, tall).moved(-total / 2 + WALL / 2 + k * (width + WALL), -depth / 2, FIRST - WALL)
             for k in range(COLUMNS + 1)]  # fmt: skip
    boards = [box(total, depth, WALL, 0.001).moved(0, -depth / 2, FIRST - WALL + k * (height + WALL))
              for k in range(ROWS + 1)]  # fmt: skip
    back = box(total, 0.01, tall, 0.001).moved(0, -0.005, FIRST - WALL)
    lips = [box(total - 0.002, 0.008, LIP).moved(0, -depth + 0.004, FIRST + k * (height + WALL)) for k in range(ROWS)]
    foot = furniture.cabinet(
        total, FIRST - WALL, depth, paint(120, roughness=0.5), paint(132, roughness=0.5), 3, 1, 0.05
    )
    scene.put([joined([*posts, *boards, back, *lips]).piece("shelf", board)], at)
    scene.put(foot, at)
    tags = [box(0.06, 0.001, 0.022, 0.0003).moved(-total / 2 + (c + 0.5) * (width + WALL), -depth - 0.0008,
            FIRST + 0.004 + r * (height + WALL)) for c in range(COLUMNS) for r in range(ROWS)]  # fmt: skip
    scene.put([joined(tags).piece("tag", paint(246, 240, 150, roughness=0.6))], at)
    for row in range(ROWS):
        for column in range(COLUMNS):
            _bin(scene, at, row, column, total)


def _bin(scene: Furnished, at: np.ndarray, row: int, column: int, total: float) -> None:
    """A stage over the bin's bottom, sometimes with a box left standing at its back."""
    rng = scene.rng
    width, depth, height = BIN
    x = -total / 2 + WALL + width / 2 + column * (width + WALL)
    bottom = at @ frame(x, 0.0, FIRST + (ROWS - 1 - row) * (height + WALL))
    deep = -depth + 0.02
    far = -0.03
    if rng.random() < 0.35:
        far = -0.13
    name = f"bin {'ABCD'[row]}{column + 1}"
    scene.stage(name, bottom, (-width / 2 + 0.015, deep), (width / 2 - 0.015, far), height - 0.015)
    if far < -0.1:
        kit = [things.printed_box(rng, float(rng.uniform(0.1, 0.2)), 0.07, float(rng.uniform(0.1, 0.2)))]
        scene.scatter(kit, bottom, (-width / 2 + 0.01, -0.115), (width / 2 - 0.01, -0.015), 3)


def _tote(scene: Furnished, at: np.ndarray) -> None:
    """An open plastic box, from which a robot picks: full of parts it is as hard as it gets."""
    width, depth, height = TOTE
    outer, rim = width + 2 * TOTE_WALL, TOTE_WALL / 2
    long = [box(outer, TOTE_WALL, height).moved(0, side * (depth / 2 + rim)) for side in (-1, 1)]
    short = [box(TOTE_WALL, depth, height).moved(side * (width / 2 + rim), 0) for side in (-1, 1)]
    bottom = box(width, depth, TOTE_WALL, 0.0005)
    colors = [(52, 84, 140), (92, 96, 100), (150, 44, 40), (46, 110, 88)]
    plastic = paint(*colors[int(scene.rng.integers(len(colors)))], roughness=0.55)
    scene.put([joined([*long, *short, bottom]).piece("tote", plastic)], at)
    stage = at @ frame(z=TOTE_WALL)
    margin = 0.005
    corner = (width / 2 - margin, depth / 2 - margin)
    scene.stage("tote", stage, (-corner[0], -corner[1]), corner, 0.9)


def _room(scene: Furnished) -> None:
    """Shelves with cartons on the other walls, a trolley with a free top."""
    rng = scene.rng
    metal = paint(70, 92, 140, roughness=0.45) if rng.random() < 0.5 else paint(160, roughness=0.4, metallic=0.6)
    for side, along in (("west", 1.9), ("south", 2.9)):
        rooms.against_wall(scene, furniture.metal_shelf(1.6, 1.8, 0.45, metal, 4), side, along)
        for k in range(4):
            level = rooms.surface_frame(scene, side, along, 0.115 + (1.8 - 0.12) * k / 3)
            kit = [things.carton(rng) for _ in range(5)] + [things.toolbox(rng), things.packet(rng)]
            scene.scatter(kit, level, (-0.74, -0.42), (0.74, -0.03), 8)
    at = frame(3.3, 1.75, turn_deg=float(rng.uniform(-10, 10)))
    gray = textured(surfaces.speckled(rng, (92, 96, 100)), 0.6)
    scene.put(furniture.table(0.6, 0.9, 0.8, gray, paint(190, roughness=0.3, metallic=0.9)), at)
    scene.stage("trolley", at @ frame(z=0.8), (-0.27, 0.02), (0.27, 0.42), 0.9)
    _tote(scene, at @ frame(0.0, -0.2, 0.8))
    scene.put(rooms.door(rng, paint(200, 202, 200, roughness=0.45)), scene.wall("east", 2.6))
