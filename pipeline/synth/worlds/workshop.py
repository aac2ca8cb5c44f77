"""A workshop: benches with a vice and tools, a pegboard, metal shelves with boxes, bright lamps."""

from __future__ import annotations

import numpy as np

from pipeline.synth.materials import Material, paint, textured
from pipeline.synth.worlds import furniture, rooms, surfaces, things
from pipeline.synth.worlds.layout import Furnished, Thing, frame, tilt
from pipeline.synth.worlds.rooms import Opening
from pipeline.synth.worlds.shapes import box, cylinder, joined
from pipeline.synth.worlds.world import World

SIZE = (4.8, 3.8, 2.8)
WINDOW = Opening(1.2, 2.6, 1.3, 2.2)
BENCH = 0.9


def workshop(seed: int) -> World:
    """Stages: bench left, bench mat, assembly table (two), stool, floor."""
    rng = np.random.default_rng([seed, 4])
    scene = Furnished(SIZE, rng)
    floor = textured(surfaces.concrete(rng), float(rng.uniform(0.35, 0.7)), 0.4)
    if rng.random() < 0.4:
        wall = textured(surfaces.bricks(rng, (176, 116, 92) if rng.random() < 0.5 else (214, 210, 202)), 0.95, 0.0)
    else:
        wall = textured(surfaces.concrete(rng, (186, 184, 178)), 0.95, 0.0)
    day = rooms.light(rng.uniform(5500, 8500), rng.uniform(4.0, 12.0))
    rooms.shell(scene, floor, wall, {"east": WINDOW}, day, ceiling=paint(206, roughness=1.0, specular=0.0))
    _bench(scene)
    _assembly(scene)
    _storage(scene)
    kelvin, strength = rng.uniform(3800, 6500), rng.uniform(8, 18)
    for x in (1.5, 3.3):
        rooms.ceiling_panel(scene, x, 2.3, (0.16, 1.3), rooms.light(kelvin, strength))
    return rooms.finished("workshop", seed, scene)


def _bench(scene: Furnished) -> None:
    """The bench at the north wall under a pegboard."""
    rng = scene.rng
    kind = rng.integers(3)
    wood = textured(surfaces.wood(rng, "beech" if kind else "pine"), 0.6)
    top = wood if kind < 2 else textured(surfaces.worn_metal(rng, (140, 142, 144)), 0.4, 0.5, 0.6)
    metal = paint(58, 84, 102, roughness=0.45) if rng.random() < 0.5 else paint(64, 66, 70, roughness=0.45)
    rooms.against_wall(scene, furniture.workbench(2.4, 0.75, BENCH, top, metal), "north", 1.8)
    surface = rooms.surface_frame(scene, "north", 1.8, BENCH)
    scene.put(furniture.vice(), surface @ frame(-0.95, -0.52))
    mat_color = [(60, 92, 78), (58, 62, 70), (96, 98, 96)][int(rng.integers(3))]
    mat = textured(surfaces.speckled(rng, mat_color), 0.8, 0.3)
    scene.put([box(0.66, 0.46, 0.004, 0.001).moved(0.72, -0.47).piece("bench mat", mat)], surface)
    scene.stage("bench left", surface, (-0.72, -0.7), (0.3, -0.26), 0.6)
    scene.stage("bench mat", surface @ frame(z=0.004), (0.43, -0.68), (1.01, -0.26), 0.6)
    kit = [
        things.screw_box(rng),
        things.screw_box(rng),
        things.spray_can(rng),
        things.tape_roll(rng),
        things.paint_pot(rng),
    ]
    kit += [things.jar(rng), things.mug(rng), things.screwdriver(rng), things.spanner(rng)]
    scene.scatter(kit, surface, (-1.15, -0.24), (1.15, -0.02), 20)
    _pegboard(scene)


def _pegboard(scene: Furnished) -> None:
    """Tools that hang on a board of holes."""
    rng = scene.rng
    board = textured(surfaces.pegboard(rng), 0.8, 0.2)
    at = scene.wall("north", 1.8, BENCH + 0.28)
    scene.put([box(2.2, 0.012, 0.85, 0.001).moved(0, -0.01).piece("pegboard", board)], at)
    x = -1.0
    while x < 0.95:
        maker = [things.hammer, things.screwdriver, things.spanner, _saw, _square][int(rng.integers(5))]
        tool = maker(rng)
        vertices = np.concatenate([piece.vertices for piece in tool])
        length, width = np.ptp(vertices[:, 0]), np.ptp(vertices[:, 1])
        centre = (vertices.max(axis=0) + vertices.min(axis=0)) / 2
        hang = at @ frame(x + width / 2, -0.017, 0.78 - length / 2) @ tilt(90.0) @ frame(turn_deg=90.0)
        scene.put(tool, hang @ frame(-centre[0], -centre[1], -vertices[:, 2].min()))
        x += width + float(rng.uniform(0.04, 0.1))


def _saw(rng: np.random.Generator) -> Thing:
    blade = box(0.34, 0.09, 0.002, 0.0005).moved(0.17, z=0.009)
    grip = box(0.12, 0.11, 0.02, 0.008, rounds=2).moved(-0.05)
    return [blade.piece("saw blade", things.STEEL), grip.piece("saw grip", things.plastic(rng))]


def _square(rng: np.random.Generator) -> Thing:
    del rng
    parts = [box(0.25, 0.03, 0.003, 0.0005).moved(0.125, 0.0, 0.006), box(0.03, 0.16, 0.014).moved(0.0, 0.06)]
    return [joined(parts).piece("square", paint(168, 170, 172, roughness=0.3, metallic=1.0))]


def _assembly(scene: Furnished) -> None:
    """A free-standing table, a stool."""
    rng = scene.rng
    at = frame(2.75, 1.25, turn_deg=float(rng.uniform(-6, 6)))
    kind = rng.integers(3)
    tops: list[Material] = [textured(surfaces.wood(rng, "birch"), 0.5), paint(224, 224, 220, roughness=0.35)]
    top = tops[kind] if kind < 2 else textured(surfaces.worn_metal(rng), 0.35, 0.5, 0.5)
    steel = paint(90, 94, 98, roughness=0.4, metallic=0.7)
    scene.put(furniture.table(1.5, 0.8, 0.82, top, steel, 0.04), at)
    surface = at @ frame(z=0.82)
    scene.stage("table left", surface, (-0.7, -0.36), (-0.04, 0.24), 0.7)
    scene.stage("table right", surface, (0.1, -0.36), (0.7, 0.16), 0.7)
    kit = [
        things.carton(rng),
        things.tape_roll(rng),
        things.hammer(rng),
        things.screwdriver(rng),
        things.screw_box(rng),
    ]
    kit += [things.spanner(rng), things.pen(rng), things.papers(rng)]
    scene.scatter(kit, surface, (-0.73, -0.38), (0.73, 0.39))
    seat = frame(1.3, 1.1, turn_deg=float(rng.uniform(0, 90)))
    scene.put(furniture.stool(textured(surfaces.wood(rng, "beech"), 0.5), steel), seat)
    scene.stage("stool", seat @ frame(z=0.5), (-0.115, -0.115), (0.115, 0.115), 0.6)
    scene.stage("floor", frame(1.5, 2.1), (-0.35, -0.3), (0.35, 0.3), 1.0)


def _storage(scene: Furnished) -> None:
    """Metal shelves with boxes, a cupboard, a toolbox, a bucket, a door."""
    rng = scene.rng
    metal = paint(150, 152, 156, roughness=0.4, metallic=0.6)
    rooms.against_wall(scene, furniture.metal_shelf(1.4, 1.9, 0.45, metal, 4), "west", 1.9)
    for k in range(4):
        level = rooms.surface_frame(scene, "west", 1.9, 0.115 + (1.9 - 0.12) * k / 3)
        if k < 3:
            kit = [
                things.carton(rng),
                things.carton(rng),
                things.toolbox(rng),
                things.paint_pot(rng),
                things.spray_can(rng),
            ]
            kit += [things.screw_box(rng), things.screw_box(rng), things.paint_pot(rng)]
            scene.scatter(kit, level, (-0.64, -0.42), (0.64, -0.03), 12)
    cupboard = furniture.cabinet(
        0.9, 1.8, 0.45, paint(92, 108, 112, roughness=0.4), paint(104, 120, 124, roughness=0.4), 2
    )
    rooms.against_wall(scene, cupboard, "north", 3.9)
    scene.put(things.toolbox(rng), frame(4.3, 2.3, turn_deg=float(rng.uniform(60, 120))))
    bucket = cylinder(0.14, 0.26, 0.006).moved(4.35, 1.3)
    scene.put([bucket.piece("bucket", things.plastic(rng))])
    scene.put(rooms.door(rng, paint(120, 128, 124, roughness=0.5)), scene.wall("south", 1.2))
    rooms.on_wall(scene, things.clock(rng), "south", 3.0, 2.0)
