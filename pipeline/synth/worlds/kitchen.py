"""A kitchen: a counter with sink and hob along one wall, cupboards above it, an island, a breakfast table."""

from __future__ import annotations

import numpy as np

from pipeline.synth.materials import Material, paint, textured
from pipeline.synth.worlds import furniture, prints, rooms, surfaces, things
from pipeline.synth.worlds.layout import Furnished, Thing, frame
from pipeline.synth.worlds.rooms import Opening
from pipeline.synth.worlds.shapes import box, cylinder, joined, sheet, tube, upright
from pipeline.synth.worlds.world import AreaLight, World

SIZE = (4.2, 3.6, 2.5)
WINDOW = Opening(1.0, 2.4, 1.05, 2.1)
TOP = 0.92
"""Height of the worktop."""
DEPTH = 0.62


def kitchen(seed: int) -> World:
    """Stages: worktop left of the sink and right of the hob, island (two), breakfast table, floor."""
    rng = np.random.default_rng([seed, 2])
    scene = Furnished(SIZE, rng)
    gray = float(rng.uniform(90, 210))
    floor = textured(surfaces.tiles(rng, (gray, gray * 0.97, gray * 0.93), 3, 3, 1.2), 0.3)
    if rng.random() < 0.4:
        floor = textured(surfaces.planks(rng, "gray oak"), 0.4)
    wall = textured(surfaces.plaster(rng, (234, 231, 222)), 0.9, 0.0)
    day = rooms.light(rng.uniform(5200, 8500), rng.uniform(5.0, 14.0))
    rooms.shell(scene, floor, wall, {"east": WINDOW}, day)
    white_fronts = rng.random() < 0.5
    fronts = paint(238, 238, 236, roughness=0.2) if white_fronts else _front(scene)
    worktop = _worktop(scene)
    _counter(scene, fronts, worktop)
    _above(scene, fronts)
    _island(scene, fronts, worktop)
    _breakfast(scene)
    lamp = rooms.light(rng.uniform(2900, 5200), rng.uniform(6, 14))
    rooms.ceiling_panel(scene, 2.0, 1.9, (1.1, 0.28), lamp)
    if rng.random() < 0.35:
        sun = rooms.light(4800, rng.uniform(10, 25))
        rooms.sunbeam(scene, "east", WINDOW, (rng.uniform(1.6, 2.6), rng.uniform(1.4, 2.4), 0.9), sun)
    return rooms.finished("kitchen", seed, scene)


def _front(scene: Furnished) -> Material:
    rng = scene.rng
    if rng.random() < 0.5:
        return textured(surfaces.wood(rng, str(rng.choice(["oak", "birch", "walnut"]))), 0.4)
    return paint(*prints.muted(rng, 0.3, 0.75), roughness=0.3)


def _worktop(scene: Furnished) -> Material:
    rng = scene.rng
    kind = rng.integers(4)
    if kind == 0:
        return textured(surfaces.wood(rng, str(rng.choice(["oak", "beech", "walnut"]))), 0.35)
    if kind == 1:
        return textured(surfaces.marble(rng), 0.12)
    tone = float(rng.uniform(50, 170))
    return textured(surfaces.stone(rng, (tone, tone * 0.98, tone * 0.95)), float(rng.uniform(0.1, 0.3)))


def _counter(scene: Furnished, fronts: Material, worktop: Material) -> None:
    """Lower cupboards with worktop, sink, hob and splashback along the north wall."""
    rng = scene.rng
    width = SIZE[0] - 0.1
    body = furniture.cabinet(width, TOP - 0.04, DEPTH - 0.03, things.WHITE, fronts, 6)
    rooms.against_wall(scene, body, "north", SIZE[0] / 2)
    surface = rooms.surface_frame(scene, "north", SIZE[0] / 2, TOP)
    scene.put(_plates_with_sink(width, worktop), surface)
    tile_color = prints.muted(rng, 0.6, 0.9) if rng.random() < 0.4 else (230.0, 230.0, 226.0)
    kinds = [(4, 8, 0.6), (6, 6, 0.6), (4, 4, 0.6)]
    columns, rows, size = kinds[int(rng.integers(3))]
    back = textured(surfaces.tiles(rng, tile_color, columns, rows, size), 0.12)
    scene.put([upright(sheet(SIZE[0], 0.56)).moved(0, -0.004, 0.28).piece("splashback", back)],
              scene.wall("north", SIZE[0] / 2, TOP))  # fmt: skip
    _hob(scene, surface)
    scene.stage("worktop left", surface, (-1.98, -0.57), (-1.3, -0.16), 0.5)
    scene.stage("worktop right", surface, (1.2, -0.57), (1.95, -0.2), 0.5)
    scene.stage("worktop middle", surface, (-0.35, -0.56), (0.12, -0.2), 0.5)
    kit = [things.kettle(rng), things.jar(rng), things.bottle(rng), things.packet(rng), things.can(rng)]
    scene.scatter(kit, surface, (-2.0, -0.17), (-1.2, -0.02), 25)
    scene.scatter([things.dish_soap(rng), things.mug(rng)], surface, (-0.42, -0.19), (-0.1, -0.02))
    kit = [things.knife_block(rng), things.spice_rack(rng), things.fruit_bowl(rng), things.jar(rng), things.bottle(rng)]
    scene.scatter(kit, surface, (1.0, -0.19), (2.03, -0.02), 15)


SINK = (-0.85, -0.31, 0.5, 0.38)
"""Middle x, y, width and depth of the basin."""


def _plates_with_sink(width: float, worktop: Material) -> Thing:
    """The worktop in four parts around a steel basin with a tap."""
    x, y, w, d = SINK
    left, right, half = x - w / 2, x + w / 2, width / 2
    parts = [
        box(left + half, DEPTH, 0.04, 0.004).moved((left - half) / 2, -DEPTH / 2, -0.04),
        box(half - right, DEPTH, 0.04, 0.004).moved((right + half) / 2, -DEPTH / 2, -0.04),
        box(w, DEPTH + y - d / 2, 0.04, 0.002).moved(x, (y - d / 2 - DEPTH) / 2, -0.04),
        box(w, -(y + d / 2), 0.04, 0.002).moved(x, (y + d / 2) / 2, -0.04),
    ]
    depth, t = 0.16, 0.006
    walls = [
        box(w, d, t).moved(x, y, -depth),
        box(t, d, depth).moved(left + t / 2, y, -depth),
        box(t, d, depth).moved(right - t / 2, y, -depth),
        box(w, t, depth).moved(x, y - d / 2 + t / 2, -depth),
        box(w, t, depth).moved(x, y + d / 2 - t / 2, -depth),
    ]
    rim = [box(w + 0.03, 0.02, 0.003).moved(x, y + s * d / 2) for s in (-1, 1)]
    rim += [box(0.02, d + 0.03, 0.003).moved(x + s * w / 2, y) for s in (-1, 1)]
    tap = tube(
        np.array([[0, 0, 0], [0, 0, 0.24], [0, -0.03, 0.3], [0, -0.09, 0.32], [0, -0.15, 0.29], [0, -0.16, 0.24]]),
        0.011,
    )
    lever = box(0.018, 0.09, 0.012, 0.004).moved(0.03, -0.02, 0.09)
    drain = cylinder(0.035, 0.004).moved(x, y, -depth + t)
    steel = paint(190, 190, 188, roughness=0.25, metallic=1.0)
    shiny = joined([tap.moved(x, -0.06), lever.moved(x, -0.06), cylinder(0.024, 0.06).moved(x, -0.06)])
    return [
        joined(parts).piece("worktop", worktop),
        joined([*walls, *rim, drain]).piece("sink", steel),
        shiny.piece("tap", paint(214, 214, 212, roughness=0.1, metallic=1.0)),
    ]


def _hob(scene: Furnished, surface: np.ndarray) -> None:
    """A black glass hob with rings, a pan on it."""
    rng = scene.rng
    glass = box(0.58, 0.5, 0.006, 0.003).moved(0.62, -0.3)
    rings = [(0.48, -0.2, 0.075), (0.77, -0.2, 0.095), (0.48, -0.42, 0.095), (0.77, -0.42, 0.075)]
    marks = [cylinder(r, 0.0004, 0.0001).moved(x, y, 0.006) for x, y, r in rings]
    scene.put([glass.piece("hob", paint(14, 14, 16, roughness=0.06))], surface)
    scene.put([joined(marks).piece("hob ring", paint(44, 44, 48, roughness=0.25))], surface)
    for x, y, _ in [rings[k] for k in rng.permutation(4)[: int(rng.integers(1, 3))]][:1]:
        scene.put(things.pan(rng), surface @ frame(x, y, 0.0064, float(rng.uniform(-120, -60))))


def _above(scene: Furnished, fronts: Material) -> None:
    """Wall cupboards, a hood, a strip of light under the cupboards."""
    rng = scene.rng
    for x, w, columns in ((-1.25, 1.6, 3), (1.5, 1.1, 2)):
        hung = furniture.cabinet(w, 0.7, 0.34, things.WHITE, fronts, columns, plinth=0.0)
        scene.put(hung, scene.wall("north", SIZE[0] / 2 + x, 1.48) @ frame(0.0, -0.001))
    steel = textured(surfaces.brushed_metal(rng), 0.3, 0.5, 1.0)
    hood = [box(0.58, 0.45, 0.06).moved(0, -0.225), box(0.26, 0.26, 0.88).moved(0, -0.14, 0.06)]
    scene.put([joined(hood).piece("hood", steel)], scene.wall("north", SIZE[0] / 2 + 0.62, 1.55))
    strip = scene.wall("north", SIZE[0] / 2 - 1.25, 1.478)
    centre = strip @ np.array([0.0, -0.2, 0.0, 1.0])
    if rng.random() < 0.7:
        glow = rooms.light(rng.uniform(2900, 4500), rng.uniform(6, 16))
        x, y, z = (float(value) for value in centre[:3])
        scene.lights.append(AreaLight((x, y, z), (0.7, 0.0, 0.0), (0.0, -0.02, 0.0), glow))


def _island(scene: Furnished, fronts: Material, worktop: Material) -> None:
    """A free-standing block with a top; two free places."""
    rng = scene.rng
    at = frame(1.75, 1.62, turn_deg=float(rng.uniform(-2, 2)))
    block = furniture.cabinet(1.5, 0.88, 0.7, things.WHITE, fronts, 3)
    scene.put(block, at @ frame(0.0, 0.35))
    top = worktop if rng.random() < 0.5 else _worktop(scene)
    scene.put([box(1.62, 0.82, 0.04, 0.005, rounds=2).moved(z=0.88).piece("island top", top)], at)
    surface = at @ frame(z=TOP)
    scene.stage("island left", surface, (-0.76, -0.36), (-0.08, 0.2), 0.7)
    scene.stage("island right", surface, (0.2, -0.36), (0.76, 0.1), 0.7)
    kit = [things.fruit_bowl(rng), things.cutting_board(rng), things.plates(rng), things.bottle(rng), things.mug(rng)]
    kit += [things.bowl(rng), things.packet(rng), things.jar(rng)]
    scene.scatter(kit, surface, (-0.78, -0.38), (0.78, 0.39))
    scene.stage("floor", frame(3.15, 1.72), (-0.3, -0.3), (0.3, 0.35), 1.0)


def _breakfast(scene: Furnished) -> None:
    """A small round table with stools at the south wall, and a fridge."""
    rng = scene.rng
    at = frame(3.35, 0.6)
    wood = textured(surfaces.wood(rng, str(rng.choice(["oak", "birch", "walnut", "pine"]))), 0.4)
    scene.put(furniture.round_table(0.42, 0.74, wood, wood), at)
    scene.stage("breakfast table", at @ frame(z=0.74), (-0.24, -0.24), (0.24, 0.2), 0.6)
    scene.scatter([things.mug(rng), things.plate(rng)], at @ frame(z=0.74), (-0.3, 0.2), (0.3, 0.36))
    for x, y in ((2.7, 0.42), (3.86, 1.05)):
        scene.put(furniture.stool(wood, furniture.BLACK, 0.46), frame(x, y, turn_deg=float(rng.uniform(0, 90))))
    steel = textured(surfaces.brushed_metal(rng), 0.35, 0.5, 1.0)
    fridge = [box(0.66, 0.62, 1.86, 0.008), box(0.65, 0.02, 1.28, 0.006).moved(0, -0.325, 0.56)]
    fridge += [box(0.65, 0.02, 0.5, 0.006).moved(0, -0.325, 0.04), box(0.02, 0.03, 0.5).moved(0.27, -0.35, 0.7)]
    scene.put([joined(fridge).moved(0, -0.31).piece("fridge", steel if rng.random() < 0.5 else things.WHITE)],
              scene.wall("west", 0.6) @ frame(0.0, -0.02))  # fmt: skip
    scene.put(rooms.door(rng, rooms.WHITE_PAINT), scene.wall("south", 2.9))
    rooms.on_wall(scene, things.clock(rng), "west", 1.9, 1.9)
    rooms.on_wall(scene, things.picture_frame(rng, 0.5, 0.4), "south", 1.2, 1.45)
