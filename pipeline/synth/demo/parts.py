"""Eight texture-less electrical parts of our own, modelled by code, in the spirit of T-LESS (thesis ch. T-LESS).

One has a continuous, one a 2-fold and one a 4-fold symmetry; five have none, of which two are near twins and one is
composed of two others. Millimetres; the model frame has its origin at the centre of the bounding box and z along
the axis of symmetry.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from pipeline.synth.demo import solids
from pipeline.synth.demo.solids import PartMesh, cylinder, facing, hole, polygon, prism, rectangle, screw, union

if TYPE_CHECKING:
    from manifold3d import CrossSection, Manifold

IVORY = (231, 225, 208)
LIGHT_GRAY = (205, 206, 203)
GRAY = (150, 152, 152)
DARK_GRAY = (74, 76, 79)
STEEL = (168, 168, 164)


@dataclass(frozen=True)
class Part:
    """A part: how to build it, and under which rotations about z it looks the same."""

    obj_id: int
    name: str
    build: Callable[[], Manifold]
    fold: int = 1
    """Turning by 360/fold degrees about z changes nothing; 0 means any angle (continuous symmetry)."""
    preview_turn_deg: float = 35.0
    """Turn about z that shows the part well from the front."""
    edge_length_mm: float = 7.0
    """Longest edge of the exported triangles, about."""


def lamp_holder() -> Manifold:
    """A screw-in lamp holder: lathed body with thread rings, collar, and an open socket with its contact."""
    outer = [(0, 0), (17, 0), (17, 9), (21, 15), (21, 31), (24, 31), (24, 36), (21, 36)]
    for z in range(38, 54, 5):
        outer += [(21, z), (23.5, z + 1.25), (23.5, z + 2.25), (21, z + 3.5)]
    inner = [(21, 61), (16.5, 61), (16.5, 18), (0, 18)]
    body = solids.lathe(polygon(outer + inner, 0.55, 12), IVORY, 48)
    shell = solids.lathe(polygon([(14.9, 17), (17, 17), (17, 52), (14.9, 52)], 0.3, 8), STEEL, 48)
    contact = solids.lathe(polygon([(0, 17), (5, 17), (5, 22), (0, 23.5)]), STEEL, 32)
    nipple = solids.lathe(polygon([(0, -9), (7, -9), (9, -7), (9, 1), (0, 1)], 0.4, 8), GRAY, 48)
    return union(body, shell, contact, nipple)


def terminal_block() -> Manifold:
    """A strip of five screw terminals with wire entries on both long sides and fixing holes in between."""
    pitch, height = 17.0, 27.0
    base = prism(rectangle(5 * pitch + 3, 24, 3.0), 13, LIGHT_GRAY, 0.8)
    tower = prism(rectangle(14.4, 20, 2.6), height, LIGHT_GRAY, 0.9)
    solid = union(base, *(tower.translate((pitch * k, 0, 0)) for k in range(-2, 3)))
    entry = solids.around_z(facing(hole(4.0, 8.0, LIGHT_GRAY), "+y", (0, 10, 18.4)), 2)
    well = hole(3.5, 7.0, LIGHT_GRAY).translate((0, 0, height))
    clamp = prism(rectangle(9, 5), 9.0, STEEL).translate((0, 0, 14)) + screw(3.0, STEEL).translate((0, 0, height - 4))
    fixing = union(hole(1.9, 30, LIGHT_GRAY), cylinder(3.4, -2, 1, LIGHT_GRAY)).translate((0, 0, 13))
    for k in range(-2, 3):
        x = pitch * k
        solid = solid - entry.translate((x, 0, 0)) - well.translate((x, 0, 0)) + clamp.translate((x, 0, 0))
    for x in (-pitch, pitch):
        for y in (-10.6, 10.6):
            groove = cylinder(1.6, -1, 14, LIGHT_GRAY).translate((1.5 * x, 1.2 * y, 0))
            solid = solid - groove
        solid = solid - fixing.translate((x / 2, 0, 0))
    return solid


def junction_box() -> Manifold:
    """A square surface box: lid with four screws, a cable grommet on each side."""
    base = prism(rectangle(76, 76, 9), 30, LIGHT_GRAY, 1.5)
    lid = prism(rectangle(80, 80, 10), 11, IVORY, 2.0).translate((0, 0, 28.5))
    recess = prism(rectangle(50, 50, 6), 4, IVORY, 0.0).translate((0, 0, 38.3))
    pad = prism(rectangle(42, 42, 5), 4, IVORY, 0.8).translate((0, 0, 36.5))
    well = hole(5.2, 4.0, IVORY).translate((31, 31, 39.5))
    head = screw(4.6, STEEL, 45.0).translate((31, 31, 37.2))
    ring = [(0, -4), (15, -4), (15, 0.5), (13, 1.5), (13, 3.5), (10.5, 4.5), (10.5, 6.5), (7, 7.5), (7, 6), (0, 6)]
    grommet = facing(solids.lathe(polygon(ring, 0.35, 8), DARK_GRAY, 32), "+x", (38, 0, 15.5))
    foot = prism(rectangle(16, 12, 4), 3, LIGHT_GRAY).translate((25, 25, -1.5))
    foot = union(foot, prism(rectangle(12, 16, 4), 3, LIGHT_GRAY).translate((25, 25, -1.5)))
    solid = union(base, lid) - recess + pad
    solid = solid - solids.around_z(well, 4) + solids.around_z(union(head, grommet), 4)
    return solid - solids.around_z(foot, 4)


def _din_module(outline: list[tuple[float, float]], width: float, color: solids.Color) -> Manifold:
    """The housing of a rail-mounted device: side outline (front, length) with seam, rivets and shallow vents."""
    side = polygon(outline, 0.9)
    body = prism(side, width, color, 0.8)
    seam = prism(side.offset(1.0) - side.offset(-0.5), 0.6, DARK_GRAY).translate((0, 0, width / 2 - 0.3))
    body = body - seam
    for x, y in ((9, -32), (9, 31), (36, -20), (36, 12)):
        for z, direction in ((0.0, "-z"), (width, "+z")):
            body = body - facing(hole(2.6, 0.9, color, 0.3), direction, (x, y, z))
            body = body + facing(cylinder(1.9, -2, -0.3, STEEL), direction, (x, y, z))
    for x in (17.0, 21.5, 26.0):
        for z in (0.0, width):
            body = body - prism(rectangle(2.2, 26, 1.09), 1.6, color).translate((x, -3, z - 0.8))
    return body


def _terminal(front: float, y: float, end: float, width: float, color: solids.Color) -> tuple[Manifold, Manifold]:
    """What a terminal at one end takes away from the housing (screw well, wire entry), and what it adds (metal)."""
    outwards = "+y" if end > 0 else "-y"
    inner = end - np.sign(end) * 8.0
    well = facing(hole(4.1, 11.0, color), "+x", (front, y, width / 2))
    entry = facing(prism(rectangle(10, 11, 1.5), 10.5, color).translate((0, 0, -10)), outwards, (19.0, end, width / 2))
    head = facing(screw(3.6, STEEL, 25.0), "+x", (front - 8.2, y, width / 2))
    clamp = prism(rectangle(12, 4.6), 11.0, STEEL).translate((19.0, inner, width / 2 - 5.5))
    return union(well, entry), union(head, clamp)


def _breaker(nose: float, lever_y: float) -> Manifold:
    """Body of the two breakers; the front frame is turned to z at the very end by `_front_up`."""
    width = 27.0
    outline = [(0, -43), (45, -43), (45, -26), (nose, -24), (nose, 17), (40, 19), (40, 41), (0, 41), (0, 20)]
    solid = _din_module([*outline, (4.5, 18.5), (4.5, -15.5), (0, -17.0)], width, IVORY)
    for front, y, end in ((45.0, -35.0, -43.0), (40.0, 31.0, 41.0)):
        cut, metal = _terminal(front, y, end, width, IVORY)
        solid = solid - cut + metal
    slot = prism(rectangle(16, 22, 1.5), 11, IVORY).translate((nose, lever_y, width / 2 - 5.5))
    drum = cylinder(9.5, 0, 10, DARK_GRAY).translate((nose - 6.0, lever_y, width / 2 - 5))
    arm = prism(polygon([(-2, -4.6), (17, -2.8), (17, 2.8), (-2, 4.6)], 1.2), 10, DARK_GRAY, 0.8)
    arm = arm.rotate((0, 0, 32)).translate((nose - 6.0, lever_y, width / 2 - 5))
    return solid - slot + drum + arm


def _front_up(solid: Manifold) -> Manifold:
    """Turn the front (x of the outline) to z, and the length to y."""
    return solid.rotate((0, -90, 0))


def breaker() -> Manifold:
    """A one-pole circuit breaker with a tilted lever and a label recess."""
    label = prism(rectangle(2.0, 11, 0.6), 19, IVORY).translate((61.0, -14.5, 4.0))
    return _front_up(_breaker(61.0, 4.0) - label)


def breaker_with_test_button() -> Manifold:
    """The breaker's near twin: a slightly longer nose, the lever further up, and a test button."""
    button = facing(union(cylinder(4.4, -2, 1.2, GRAY), cylinder(4.4, 1.2, 1.8, GRAY, 3.8)), "+x", (63.0, -15.5, 13.5))
    collar = facing(hole(5.4, 1.2, IVORY, 0.4), "+x", (63.0, -15.5, 13.5))
    return _front_up(_breaker(63.0, 5.5) - collar + button)


def fuse_holder() -> Manifold:
    """A rail-mounted fuse holder with its drawer swung open."""
    width = 22.0
    outline = [(0, -39), (30, -39), (37, -31), (37, -22), (50, -16), (50, 26), (30, 41), (0, 41), (0, 20)]
    solid = _din_module([*outline, (4.5, 18.5), (4.5, -15.5), (0, -17.0)], width, LIGHT_GRAY)
    for front, y, end in ((36.0, -28.0, -39.0), (34.0, 33.5, 41.0)):
        cut, metal = _terminal(front, y, end, width, LIGHT_GRAY)
        solid = solid - cut + metal
    outline = [(0, -24), (11, -24), (13, -12), (13, 20), (9, 38), (3, 38), (5, 24), (0, 22)]
    drawer = prism(polygon(outline, 1.2), 17, GRAY, 0.9)
    window = prism(rectangle(3.0, 13, 1.4), 7, DARK_GRAY).translate((13.0, 4, 5.0))
    grip = [cylinder(1.0, 1.5, 15.5, GRAY).translate((12.6 - 0.6 * k, 22.0 + 2.7 * k, 0)) for k in range(5)]
    drawer = union(drawer - window, *grip)
    return _front_up(solid + drawer.rotate((0, 0, -20)).translate((46.5, 2.0, width / 2 - 8.5)))


def limit_switch() -> Manifold:
    """A limit switch: housing with cover and gland, a turning head, and a lever with a roller."""
    body = prism(rectangle(36, 28, 4), 58, GRAY, 1.2)
    cover = facing(prism(rectangle(31, 51, 3), 4, LIGHT_GRAY, 0.9), "-y", (0, -12, 29))
    solid = union(body, cover)
    for x, z in ((-11, 49), (11, 9)):
        solid = solid - facing(hole(3.0, 1.4, LIGHT_GRAY, 0.3), "-y", (x, -16, z))
        solid = solid + facing(screw(2.6, STEEL, 20.0), "-y", (x, -15.3, z))
    head = prism(rectangle(27, 25, 3), 21, DARK_GRAY, 1.0).translate((2, 0, 56.5))
    nut = prism(solids.fillet(_hexagon(11.5), 0.6), 7, DARK_GRAY, 0.7).translate((-5, 0, -6.5))
    neck = solids.lathe(polygon([(0, -17), (7, -17), (9, -15), (9, -6), (0, -6)], 0.5), DARK_GRAY, 40)
    neck = neck.translate((-5, 0, 0))
    bore = cylinder(4.5, -18, -8, DARK_GRAY).translate((-5, 0, 0))
    shaft = facing(cylinder(5.0, -2, 9, STEEL), "-y", (2, -12, 67))
    arm = prism(polygon([(-6, -6), (50, -4), (50, 4), (-6, 6)], 3.4), 3.4, STEEL, 0.5)
    roller = solids.lathe(polygon([(0, 3), (10, 3), (10, 12), (0, 12)], 0.8), IVORY, 40).translate((46, 0, 0))
    pin = cylinder(2.6, -0.8, 13, STEEL).translate((46, 0, 0))
    lever = facing(union(arm, roller, pin).rotate((0, 0, -28)), "-y", (2, -17.2, 67))
    return union(solid, head, nut, neck, shaft, lever) - bore


def _hexagon(radius: float) -> CrossSection:
    angles = np.radians(np.arange(0, 360, 60))
    return polygon([(radius * np.cos(a), radius * np.sin(a)) for a in angles])


FUSE_HOLDER_BESIDE_MM = -26.8
"""In the composition, the fuse holder stands here along x: beside the 27 mm wide breaker, touching it."""


def switch_fuse() -> Manifold:
    """The composition: a breaker and a fuse holder side by side on one rail."""
    return union(breaker(), fuse_holder().translate((FUSE_HOLDER_BESIDE_MM, 0, 0)))


PARTS: tuple[Part, ...] = (
    Part(1, "lamp holder", lamp_holder, fold=0, edge_length_mm=9.0),
    Part(2, "terminal block", terminal_block, fold=2),
    Part(3, "junction box", junction_box, fold=4, edge_length_mm=10.0),
    Part(4, "fuse holder", fuse_holder),
    Part(5, "limit switch", limit_switch),
    Part(6, "breaker", breaker),
    Part(7, "breaker with test button", breaker_with_test_button),
    Part(8, "switch and fuse", switch_fuse, edge_length_mm=11.0),
)


@cache
def part_solid(obj_id: int) -> Manifold:
    """A part as a solid in its model frame (mm)."""
    return solids.centred(solids.without_voids(PARTS[obj_id - 1].build()))


@cache
def part_mesh(obj_id: int) -> PartMesh:
    """The exported mesh of a part."""
    return solids.mesh_of(part_solid(obj_id), PARTS[obj_id - 1].edge_length_mm)


def symmetry_info(part: Part) -> dict:
    """The part's symmetries in the form of BOP's `models_info.json`: the identity is left out."""
    if part.fold == 0:
        return {"symmetries_continuous": [{"axis": [0, 0, 1], "offset": [0, 0, 0]}]}
    turns = [_turn_about_z(2 * np.pi * k / part.fold).ravel() for k in range(1, part.fold)]
    return {"symmetries_discrete": [[float(x) for x in turn] for turn in turns]} if turns else {}


def _turn_about_z(angle: float) -> Float[np.ndarray, "4 4"]:
    cosine, sine = round(float(np.cos(angle)), 12), round(float(np.sin(angle)), 12)
    return np.array([[cosine, -sine, 0, 0], [sine, cosine, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]]) + 0.0
