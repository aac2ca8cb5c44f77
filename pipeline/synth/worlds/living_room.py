"""A living room: dining table with chairs, sofa and coffee table, sideboard, bookcase, pictures, plants."""

from __future__ import annotations

import numpy as np

from pipeline.synth.materials import Material, paint, textured
from pipeline.synth.worlds import furniture, prints, rooms, surfaces, things
from pipeline.synth.worlds.layout import Furnished, frame, tilt
from pipeline.synth.worlds.rooms import Opening
from pipeline.synth.worlds.shapes import box
from pipeline.synth.worlds.world import World

SIZE = (5.0, 4.2, 2.55)
WINDOW = Opening(1.1, 3.1, 0.85, 2.15)
WALLS = ((236, 232, 222), (222, 226, 226), (228, 218, 200), (206, 214, 204), (214, 206, 200))


def living_room(seed: int) -> World:
    """Stages: dining table (two), coffee table, sideboard, chair, rug."""
    rng = np.random.default_rng([seed, 1])
    scene = Furnished(SIZE, rng)
    floor = textured(surfaces.planks(rng, str(rng.choice(["oak", "walnut", "gray oak", "pine"]))), 0.42)
    color = WALLS[int(rng.integers(len(WALLS)))]
    wall = textured(surfaces.plaster(rng, color), 0.9, 0.0)
    accent = textured(surfaces.plaster(rng, prints.muted(rng, 0.4, 0.75)), 0.9, 0.0)
    day = rooms.light(rng.uniform(5200, 8000), rng.uniform(5.0, 14.0))
    rooms.shell(scene, floor, wall, {"west": WINDOW}, day, ("north", accent) if rng.random() < 0.5 else None)
    cloth = textured(surfaces.fabric(rng, prints.muted(rng, 0.4, 0.9), 0.003), 0.95, 0.0)
    scene.put(rooms.curtains(rng, WINDOW, cloth, drop=0.8), scene.wall("west"))
    _dining(scene)
    _sitting(scene)
    _walls(scene)
    if rng.random() < 0.4:
        sun = rooms.light(4800, rng.uniform(12, 30))
        rooms.sunbeam(scene, "west", WINDOW, (rng.uniform(1.2, 2.2), rng.uniform(1.0, 3.0), 0.4), sun)
    return rooms.finished("living_room", seed, scene)


def _wood(scene: Furnished, *kinds: str) -> Material:
    kind = str(scene.rng.choice(list(kinds)))
    return textured(surfaces.wood(scene.rng, kind), float(scene.rng.uniform(0.25, 0.55)))


def _dining(scene: Furnished) -> None:
    """Table under a pendant lamp, with chairs, crockery and two free places."""
    rng = scene.rng
    at = frame(1.6, 1.25, turn_deg=float(rng.uniform(-3, 3)))
    top = _wood(scene, "oak", "walnut", "beech", "birch", "cherry")
    scene.put(furniture.table(1.5, 0.9, 0.75, top, _wood(scene, "oak", "walnut") if rng.random() < 0.5 else top), at)
    surface = at @ frame(z=0.75)
    scene.stage("dining table left", surface, (-0.66, -0.36), (-0.06, 0.24), 0.6)
    scene.stage("dining table right", surface, (0.08, -0.36), (0.62, 0.14), 0.6)
    kit = [things.fruit_bowl(rng), things.vase(rng), things.mug(rng), things.mug(rng), things.candle(rng)]
    kit += [things.bottle(rng), things.papers(rng), things.plates(rng)]
    scene.scatter(kit, surface, (-0.72, -0.42), (0.72, 0.43))
    seat, legs = _wood(scene, "oak", "beech", "walnut"), furniture.BLACK if rng.random() < 0.5 else top
    for x, y, turn in ((-0.4, -0.72, 180), (0.38, -0.62, 180), (-0.36, 0.66, 0), (0.42, 0.78, 0)):
        place = at @ frame(x, y, turn_deg=turn + float(rng.uniform(-12, 12)))
        scene.put(furniture.chair(seat, legs), place)
        if (x, y) == (-0.4, -0.72):
            scene.stage("chair", place @ frame(z=furniture.SEAT), (-0.17, -0.18), (0.17, 0.14), 0.55)
    lamp = rooms.light(rng.uniform(2600, 3800), rng.uniform(14, 40))
    shade = things.plastic(rng) if rng.random() < 0.5 else furniture.BLACK
    rooms.pendant_lamp(scene, 1.6, 1.25, 1.5 + float(rng.uniform(0, 0.2)), shade, lamp)


def _sitting(scene: Furnished) -> None:
    """Sofa at the east wall, coffee table on a rug before it."""
    rng = scene.rng
    color = [(118, 126, 134), (164, 148, 128), (70, 84, 98), (132, 86, 66), (98, 112, 90)][int(rng.integers(5))]
    cloth = textured(surfaces.fabric(rng, color), 0.95, 0.0)
    rooms.against_wall(scene, furniture.sofa(2.1, cloth, furniture.BLACK), "east", 1.9)
    for along in (1.15, 2.6):
        pillow = textured(surfaces.fabric(rng, prints.vivid(rng, 0.45, 0.85), 0.0022), 0.95, 0.0)
        lean = scene.wall("east", along, 0.44) @ frame(0.0, -0.42)
        scene.put(things.cushion(rng, pillow), lean @ tilt(62.0))
    carpet = textured(surfaces.carpet(rng, prints.muted(rng, 0.4, 0.85), int(rng.integers(0, 7))), 1.0, 0.0)
    scene.put([box(1.9, 2.3, 0.012, 0.004).moved(3.15, 2.35).piece("rug", carpet)])
    at = frame(3.2, 2.35, turn_deg=float(rng.uniform(-4, 4)))
    top = _wood(scene, "oak", "walnut", "wenge") if rng.random() < 0.6 else textured(surfaces.marble(rng), 0.15)
    scene.put(furniture.table(0.62, 1.1, 0.42, top, furniture.BLACK, 0.028), at @ frame(z=0.012))
    surface = at @ frame(z=0.432)
    scene.stage("coffee table", surface, (-0.27, -0.5), (0.27, 0.12), 0.7)
    kit = [things.books(rng), things.mug(rng), things.candle(rng), things.bowl(rng), things.pen(rng)]
    scene.scatter(kit, surface, (-0.29, 0.14), (0.29, 0.53))
    scene.stage("rug", frame(2.48, 2.7, 0.012), (-0.22, -0.3), (0.22, 0.3), 1.0)


def _walls(scene: Furnished) -> None:
    """Sideboard with free places, bookcase, pictures, plants, a door."""
    rng = scene.rng
    white = paint(238, 237, 233, roughness=0.4)
    wood = _wood(scene, "oak", "walnut", "cherry")
    board = furniture.cabinet(1.6, 0.78, 0.44, wood, white if rng.random() < 0.5 else wood, 3)
    rooms.against_wall(scene, board, "north", 1.35)
    surface = rooms.surface_frame(scene, "north", 1.35, 0.78)
    scene.stage("sideboard", surface, (-0.28, -0.41), (0.34, -0.08), 0.6)
    kit = [things.vase(rng), things.plant(rng, 0.32), things.books(rng), things.candle(rng), things.bottle(rng)]
    scene.scatter(kit[:3], surface, (-0.78, -0.42), (-0.3, -0.03))
    scene.scatter(kit[3:], surface, (0.36, -0.42), (0.78, -0.03))
    case = furniture.bookcase(0.9, 1.95, 0.3, wood)
    rooms.against_wall(scene, case, "north", 3.15)
    for z in furniture.shelf_heights(1.95, 5):
        row = scene.wall("north", 3.15 - 0.42, z + 0.022) @ frame(0.0, -0.06)
        scene.put(things.book_row(rng, float(rng.uniform(0.45, 0.82))), row)
    rooms.on_wall(scene, things.picture_frame(rng, 0.9, 0.62), "north", 1.35, 1.35)
    rooms.on_wall(scene, things.picture_frame(rng, 0.6, 0.8), "east", 1.9, 1.25)
    rooms.on_wall(scene, things.clock(rng), "south", 1.6, 1.9)
    scene.put(rooms.door(rng, white), scene.wall("south", 3.6))
    scene.put(things.plant(rng, 0.75), frame(4.55, 3.75))
    scene.put(things.plant(rng, 0.55), frame(0.4, 0.4))
