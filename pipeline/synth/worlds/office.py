"""An office: two desks with screens, drawers, a bookcase, a whiteboard, a wide window."""

from __future__ import annotations

import numpy as np

from pipeline.synth.materials import Material, paint, textured
from pipeline.synth.worlds import furniture, rooms, surfaces, things
from pipeline.synth.worlds.layout import Furnished, frame
from pipeline.synth.worlds.rooms import Opening
from pipeline.synth.worlds.shapes import box, joined, sheet, upright
from pipeline.synth.worlds.world import AreaLight, World

SIZE = (4.4, 3.6, 2.7)
WINDOW = Opening(0.8, 3.2, 0.9, 2.3)
DESK = 0.74


def office(seed: int) -> World:
    """Stages: main desk (two), second desk, drawer unit, window sill, meeting table, chair."""
    rng = np.random.default_rng([seed, 3])
    scene = Furnished(SIZE, rng)
    if rng.random() < 0.5:
        floor = textured(surfaces.carpet(rng, (96, 104, 114) if rng.random() < 0.5 else (120, 112, 104)), 1.0, 0.0)
    else:
        floor = textured(surfaces.planks(rng, "beech"), 0.4)
    wall = textured(surfaces.plaster(rng, (236, 236, 232)), 0.9, 0.0)
    day = rooms.light(rng.uniform(5500, 9000), rng.uniform(4.0, 13.0))
    rooms.shell(scene, floor, wall, {"north": WINDOW}, day)
    tops = _desk_top(scene)
    _main_desk(scene, tops)
    _second_desk(scene, tops)
    _rest(scene)
    strength = rng.uniform(5, 12)
    kelvin = rng.uniform(3600, 5600)
    for x in (1.3, 3.1):
        rooms.ceiling_panel(scene, x, 1.6, (0.3, 1.2), rooms.light(kelvin, strength))
    if rng.random() < 0.35:
        target = (float(rng.uniform(1.2, 3.0)), float(rng.uniform(1.8, 2.8)), 0.7)
        rooms.sunbeam(scene, "north", WINDOW, target, rooms.light(4900, rng.uniform(10, 24)))
    return rooms.finished("office", seed, scene)


def _desk_top(scene: Furnished) -> Material:
    rng = scene.rng
    if rng.random() < 0.5:
        return textured(surfaces.wood(rng, str(rng.choice(["beech", "birch", "oak", "cherry"]))), 0.4)
    gray = float(rng.choice([70.0, 190.0, 232.0]))
    return textured(surfaces.speckled(rng, (gray, gray, gray * 0.98)), 0.45)


def _main_desk(scene: Furnished, top: Material) -> None:
    """Under the window: screen, keyboard, lamp; free places left and right."""
    rng = scene.rng
    metal = paint(70, 72, 76, roughness=0.4, metallic=0.5)
    at = frame(1.75, 2.95)
    scene.put(furniture.table(1.9, 0.85, DESK, top, metal), at)
    surface = at @ frame(z=DESK)
    scene.put(things.monitor(rng), surface @ frame(0.05, 0.22, turn_deg=float(rng.uniform(-8, 8))))
    scene.put(things.keyboard(rng), surface @ frame(0.02, -0.2, turn_deg=float(rng.uniform(-4, 4))))
    scene.put(things.mouse(rng), surface @ frame(0.34, -0.2, turn_deg=float(rng.uniform(-12, 12))))
    scene.stage("desk left", surface, (-0.9, -0.38), (-0.28, 0.16), 0.7)
    scene.stage("desk right", surface, (0.42, -0.38), (0.9, 0.1), 0.7)
    _lamp(scene, surface @ frame(0.72, 0.28, turn_deg=float(rng.uniform(-30, 60))))
    kit = [things.pen_pot(rng), things.mug(rng), things.books(rng), things.plant(rng, 0.22), things.tape_roll(rng)]
    scene.scatter(kit, surface, (-0.92, 0.18), (-0.26, 0.4))
    scene.scatter([things.pen(rng), things.can(rng)], surface, (0.36, 0.12), (0.62, 0.4))
    chair_at = frame(1.7, 2.05, turn_deg=float(rng.uniform(150, 220)))
    scene.put(furniture.office_chair(textured(surfaces.fabric(rng, (52, 60, 72)), 0.95, 0.0)), chair_at)
    scene.stage("chair", chair_at @ frame(z=0.5), (-0.18, -0.18), (0.18, 0.12), 0.45)


def _lamp(scene: Furnished, place: np.ndarray) -> None:
    """A desk lamp that is switched on."""
    rng = scene.rng
    scene.put(things.desk_lamp(rng), place)
    x, y, z = (float(value) for value in (place @ np.array([-0.12, 0.0, 0.362, 1.0]))[:3])
    glow = rooms.light(rng.uniform(2700, 4200), rng.uniform(15, 60))
    scene.lights.append(AreaLight((x, y, z), (0.04, 0.0, 0.0), (0.0, -0.04, 0.0), glow))


def _second_desk(scene: Furnished, top: Material) -> None:
    """At the east wall with a laptop and papers; a drawer unit beside it."""
    rng = scene.rng
    at = scene.wall("east", 2.1) @ frame(0.0, -0.42)
    scene.put(furniture.table(1.5, 0.75, DESK, top, paint(225, roughness=0.4)), at)
    surface = at @ frame(z=DESK)
    scene.put(things.laptop(rng), surface @ frame(0.45, 0.05, turn_deg=float(rng.uniform(-15, 15))))
    scene.stage("second desk", surface, (-0.7, -0.34), (0.2, 0.12), 0.7)
    kit = [things.papers(rng), things.mug(rng), things.pen_pot(rng), things.books(rng)]
    scene.scatter(kit, surface, (-0.72, -0.35), (0.72, 0.36))
    unit = furniture.cabinet(0.45, 0.56, 0.55, paint(228, roughness=0.35), paint(228, roughness=0.35), 1, 3, 0.04)
    rooms.against_wall(scene, unit, "east", 0.95)
    scene.stage("drawer unit", rooms.surface_frame(scene, "east", 0.95, 0.56), (-0.2, -0.52), (0.2, -0.05), 0.8)


def _rest(scene: Furnished) -> None:
    """Bookcase, whiteboard, a meeting table, a sill, a bin, a door."""
    rng = scene.rng
    wood = textured(surfaces.wood(rng, str(rng.choice(["beech", "oak", "birch"]))), 0.45)
    rooms.against_wall(scene, furniture.bookcase(1.0, 2.0, 0.32, wood), "west", 2.9)
    for z in furniture.shelf_heights(2.0, 5):
        row = scene.wall("west", 2.9 - 0.47, z + 0.022) @ frame(0.0, -0.06)
        scene.put(things.book_row(rng, float(rng.uniform(0.4, 0.92))), row)
    board = upright(sheet(1.5, 0.9)).moved(0, -0.012, 0.45).piece("whiteboard", paint(246, roughness=0.15))
    rails = [box(1.54, 0.02, 0.02).moved(0, -0.01, z) for z in (-0.01, 0.9)]
    rails += [box(0.02, 0.02, 0.9).moved(s * 0.76, -0.01) for s in (-1, 1)]
    steel = paint(180, 180, 182, roughness=0.3, metallic=1.0)
    scene.put([board, joined(rails).piece("whiteboard rail", steel)], scene.wall("west", 1.3, 1.0))
    at = frame(1.05, 0.85)
    scene.put(furniture.table(1.1, 0.8, 0.73, textured(surfaces.speckled(rng, (226, 226, 222)), 0.35), steel), at)
    scene.stage("meeting table", at @ frame(z=0.73), (-0.5, -0.36), (0.3, 0.36), 0.8)
    kit = [things.mug(rng), things.papers(rng), things.bottle(rng)]
    scene.scatter(kit, at @ frame(z=0.73), (0.3, -0.38), (0.54, 0.38))
    sill = rooms.surface_frame(scene, "north", 2.0, WINDOW.bottom)
    scene.stage("window sill", sill, (0.5, -0.09), (1.05, 0.065), 0.6)
    scene.put(things.plant(rng, 0.3), sill @ frame(-0.9, -0.01))
    scene.put(rooms.door(rng, wood), scene.wall("south", 1.1))
    rooms.on_wall(scene, things.picture_frame(rng, 0.7, 0.5), "south", 3.2, 1.4)
    rooms.on_wall(scene, things.clock(rng), "east", 2.9, 2.1)
    scene.put(things.plant(rng, 0.8), frame(4.05, 0.45))
