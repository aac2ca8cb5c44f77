"""The room that the turntable stands in: a plain laboratory with a table, a window, lamps and some furniture."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from pipeline.synth.materials import Material, paint, textured
from pipeline.synth.worlds import furniture, rooms, surfaces, things
from pipeline.synth.worlds.layout import Furnished, frame
from pipeline.synth.worlds.rooms import Opening
from pipeline.synth.worlds.world import RGB

SIZE = (4.6, 4.2, 2.8)
WINDOW = Opening(1.1, 2.7, 0.95, 2.25)
TABLE = (1.7, 1.1, 0.74)
MOST_RADIUS = 0.5
"""Of the turntable's disc, in metres: what the table has room for."""


def room(rng: np.random.Generator, radius: float) -> tuple[Furnished, Float[np.ndarray, "4 4"]]:
    """The room, and the frame of its table's surface at the axis of a turntable whose disc has this radius (metres).

    A camera has its place to the south of the table, and sees the north side of the room.
    """
    scene = Furnished(SIZE, rng)
    floor = textured(surfaces.speckled(rng, (150, 152, 150)), float(rng.uniform(0.3, 0.6)), 0.4)
    if rng.random() < 0.4:
        floor = textured(surfaces.planks(rng, "oak"), float(rng.uniform(0.35, 0.6)), 0.4)
    wall = textured(surfaces.plaster(rng, (222, 220, 214)), 0.95, 0.0)
    day = rooms.light(rng.uniform(5500, 7500), rng.uniform(4.0, 9.0))
    rooms.shell(scene, floor, wall, {"east": WINDOW}, day)
    kelvin, strength = rng.uniform(3600, 5500), rng.uniform(7, 12)
    for x in (1.5, 3.1):
        rooms.ceiling_panel(scene, x, 2.1, (0.3, 1.2), rooms.light(kelvin, strength))
    room_from_table = frame(2.3, 1.95)
    _table(scene, room_from_table, radius)
    _rest(scene)
    return scene, room_from_table @ frame(z=TABLE[2])


def _table(scene: Furnished, room_from_table: Float[np.ndarray, "4 4"], radius: float) -> None:
    rng = scene.rng
    tops = [
        textured(surfaces.wood(rng, "birch"), 0.5),
        textured(surfaces.wood(rng, "oak"), 0.5),
        paint(206, 207, 204, roughness=0.4),
    ]
    steel = paint(92, 95, 98, roughness=0.4, metallic=0.6)
    scene.put(furniture.table(*TABLE, tops[int(rng.integers(3))], steel, 0.035), room_from_table)
    surface = room_from_table @ frame(z=TABLE[2])
    kit = [things.tape_roll(rng), things.pen(rng), things.screwdriver(rng), things.mug(rng), things.screw_box(rng)]
    left, right = -TABLE[0] / 2 + 0.02, TABLE[0] / 2 - 0.02
    scene.scatter(kit[:3], surface, (left, -0.4), (-radius - 0.02, 0.5), 60)
    scene.scatter(kit[3:], surface, (radius + 0.04, 0.1), (right, 0.52), 60)


def _rest(scene: Furnished) -> None:
    """Cupboard and shelves at the north wall, a stool, a door."""
    rng = scene.rng
    wood = textured(surfaces.wood(rng, str(rng.choice(["beech", "oak", "gray oak"]))), 0.5)
    white = paint(222, 222, 218, roughness=0.4)
    rooms.against_wall(scene, furniture.cabinet(1.6, 0.9, 0.45, white, wood, 3), "north", 1.5)
    top = rooms.surface_frame(scene, "north", 1.5, 0.9)
    kit = [things.carton(rng), things.toolbox(rng), things.books(rng), things.plant(rng, 0.35), things.spray_can(rng)]
    scene.scatter(kit, top, (-0.76, -0.42), (0.76, -0.04), 15)
    metal = paint(150, 152, 156, roughness=0.4, metallic=0.6)
    rooms.against_wall(scene, furniture.metal_shelf(1.2, 1.9, 0.45, metal, 4), "north", 3.4)
    for k in range(3):
        level = rooms.surface_frame(scene, "north", 3.4, 0.115 + 1.78 * k / 3)
        boxes = [
            things.carton(rng),
            things.screw_box(rng),
            things.paint_pot(rng),
            things.toolbox(rng),
            things.carton(rng),
        ]
        scene.scatter(boxes, level, (-0.54, -0.42), (0.54, -0.03), 12)
    seat = textured(surfaces.wood(rng, "beech"), 0.5)
    scene.put(furniture.stool(seat, metal), frame(0.8, 2.6, turn_deg=float(rng.uniform(0, 90))))
    scene.put(rooms.door(rng, paint(196, 194, 188, roughness=0.5)), scene.wall("south", 1.2))
    rooms.on_wall(scene, things.clock(rng), "west", 2.0, 2.0)


def middle(rng: np.random.Generator) -> Material:
    """What the objects stand on: plywood as T-LESS's, cloth, or card."""
    kind = int(rng.integers(4))
    if kind < 2:
        return textured(surfaces.wood(rng, ("birch", "pine")[kind], 0.9), 0.65, 0.25)
    if kind == 2:
        return textured(surfaces.fabric(rng, (96, 104, 112)), 0.95, 0.0)
    return textured(surfaces.speckled(rng, (170, 171, 168)), 0.9, 0.25)


def white(scene: Furnished) -> RGB:
    """Colour of the light at large."""
    return rooms.finished("", 0, scene).white
