"""The shell of a room: floor, ceiling, walls, windows with daylight, doors, lamps; and a camera's white balance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from pipeline.geometry import transform_points
from pipeline.synth.materials import RGB, Material, paint
from pipeline.synth.worlds import prints
from pipeline.synth.worlds.layout import Furnished, Thing, frame, placed
from pipeline.synth.worlds.shapes import Shape, box, cylinder, sheet, surface, turned, upright
from pipeline.synth.worlds.world import AreaLight, Beam, Piece, PointLight, Sky, World

WHITE_PAINT = paint(240, 239, 235, roughness=0.35)


@dataclass(frozen=True)
class Opening:
    """A window in a wall: from `left` to `right` along the wall, from `bottom` to `top`."""

    left: float
    right: float
    bottom: float
    top: float


def shell(
    scene: Furnished,
    floor: Material,
    walls: Material,
    windows: dict[str, Opening],
    daylight: RGB,
    accent: tuple[str, Material] | None = None,
    ceiling: Material | None = None,
) -> None:
    """Build the room; every window shines with the radiance `daylight`, varied by the view outside."""
    width, depth, height = scene.size
    scene.put([_slab("floor", width, depth, floor)])
    over = ceiling or paint(244, 243, 240, roughness=0.95, specular=0.0)
    scene.put([_slab("ceiling", width, depth, over, height)])
    for side, length in (("north", width), ("east", depth), ("south", width), ("west", depth)):
        material = accent[1] if accent and accent[0] == side else walls
        opening = windows.get(side)
        for panel in _panels(length, height, opening):
            scene.put([_wall_panel(panel, material)], scene.wall(side))
        scene.put(_skirting(length), scene.wall(side))
        if opening:
            scene.put(_window_frame(scene.rng, opening), scene.wall(side))
            scene.lights.append(_pane(scene, side, opening, daylight))


def _slab(name: str, width: float, depth: float, material: Material, height: float | None = None) -> Piece:
    """The floor, or the ceiling at a height, both with some thickness to collide with."""
    flat = sheet(width, depth)
    shape = flat if height is None else flat.tilted("x", 180.0)
    shape = shape.moved(width / 2, depth / 2, height or 0.0)
    thick = 0.1 if height else -0.1
    hull = np.concatenate([shape.vertices, shape.vertices + np.array([0, 0, thick])])
    return replace(shape, hulls=(hull,)).piece(name, material)


def _panels(length: float, height: float, opening: Opening | None) -> list[Opening]:
    if opening is None:
        return [Opening(0.0, length, 0.0, height)]
    o = opening
    return [
        Opening(0.0, o.left, 0.0, height),
        Opening(o.right, length, 0.0, height),
        Opening(o.left, o.right, 0.0, o.bottom),
        Opening(o.left, o.right, o.top, height),
    ]


def _wall_panel(panel: Opening, material: Material) -> Piece:
    """A rectangle of wall whose texture goes on from panel to panel."""
    shape = upright(sheet(panel.right - panel.left, panel.top - panel.bottom))
    shape = shape.moved((panel.left + panel.right) / 2, 0.0, (panel.bottom + panel.top) / 2)
    hull = np.concatenate([shape.vertices, shape.vertices + np.array([0, 0.1, 0])])
    return replace(shape, uv=shape.vertices[:, [0, 2]], hulls=(hull,)).piece("wall", material)


def _skirting(length: float) -> Thing:
    return [box(length, 0.015, 0.07, 0.004).moved(length / 2, -0.0075).piece("skirting", WHITE_PAINT)]


REVEAL = 0.14
"""How deep a window lies in its wall."""


def _window_frame(rng: np.random.Generator, opening: Opening) -> Thing:
    """Reveal, frame, a bar or two, and a sill."""
    width, height = opening.right - opening.left, opening.top - opening.bottom
    x, z = (opening.left + opening.right) / 2, opening.bottom
    sides = [
        box(0.02, REVEAL, height, 0.001).moved(opening.left - 0.01, REVEAL / 2, z),
        box(0.02, REVEAL, height, 0.001).moved(opening.right + 0.01, REVEAL / 2, z),
        box(width, REVEAL, 0.02, 0.001).moved(x, REVEAL / 2, opening.top),
    ]
    y = REVEAL - 0.045
    bars = [
        box(0.06, 0.05, height, 0.006).moved(opening.left + 0.03, y, z),
        box(0.06, 0.05, height, 0.006).moved(opening.right - 0.03, y, z),
        box(width, 0.05, 0.06, 0.006).moved(x, y, z),
        box(width, 0.05, 0.06, 0.006).moved(x, y, opening.top - 0.06),
    ]
    for k in range(1, int(rng.integers(2, 4))):
        bars.append(box(0.05, 0.05, height, 0.006).moved(opening.left + width * k / 2, y, z) if k == 1
                    else box(width, 0.04, 0.04, 0.006).moved(x, y, z + 0.68 * height))  # fmt: skip
    sill = box(width + 0.1, REVEAL + 0.12, 0.03, 0.006).moved(x, (REVEAL - 0.12) / 2, z - 0.03)
    return [shape.piece("window frame", WHITE_PAINT) for shape in [*sides, *bars, sill]]


def _pane(scene: Furnished, side: str, opening: Opening, daylight: RGB) -> AreaLight:
    """The bright rectangle behind the frame."""
    world_from_wall = scene.wall(side)
    middle = ((opening.left + opening.right) / 2, REVEAL, (opening.bottom + opening.top) / 2)
    centre = transform_points(world_from_wall, np.array(middle))
    right, up = world_from_wall[:3, 0], world_from_wall[:3, 2]
    half_u = right * (opening.right - opening.left) / 2
    half_v = up * (opening.top - opening.bottom) / 2
    picture = prints.outdoors(scene.rng).astype(np.float32)
    return AreaLight(_point(centre), _point(half_u), _point(half_v), daylight, picture)


def _point(vector: np.ndarray) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in vector)
    return x, y, z


def curtains(rng: np.random.Generator, opening: Opening, material: Material, drop: float = 0.35) -> Thing:
    """A curtain on either side of a window, in folds, on a rod; for the frame of its wall."""
    rod_z, bottom = opening.top + 0.12, max(0.03, opening.bottom - drop)
    pieces = []
    for left, right in ((opening.left - 0.22, opening.left + 0.1), (opening.right - 0.1, opening.right + 0.22)):
        s, t = np.meshgrid(np.linspace(0, 1, 64), np.linspace(0, 1, 10))
        fold = 0.028 * np.sin(2 * np.pi * (s * 5.5 + rng.random())) * (0.7 + 0.5 * t) + 0.006 * np.sin(9 * s + 5 * t)
        points = np.stack([left + (right - left) * s, -0.07 - fold, rod_z + (bottom - rod_z) * t], axis=-1)
        pieces.append(surface(points).piece("curtain", material))
    width = opening.right - opening.left + 0.6
    rod = cylinder(0.012, width).tilted("y", 90.0).moved((opening.left + opening.right) / 2 - width / 2, -0.07, rod_z)
    return [*pieces, rod.piece("curtain rod", paint(90, 84, 78, roughness=0.3, metallic=0.8))]


def door(rng: np.random.Generator, material: Material) -> Thing:
    """A closed door with its frame and handle, 0.9 m wide, centred."""
    metal = paint(190, 188, 184, roughness=0.3, metallic=1.0)
    leaf = box(0.86, 0.02, 2.02, 0.003).moved(0, -0.01, 0.005)
    panels = [box(0.6, 0.012, h, 0.005).moved(0, -0.026, z) for z, h in ((0.2, 0.62), (1.05, 0.8))]
    jambs = [box(0.07, 0.04, 2.08, 0.004).moved(x, -0.02) for x in (-0.465, 0.465)]
    lintel = box(1.0, 0.04, 0.07, 0.004).moved(0, -0.02, 2.03)
    side = float(rng.choice([-0.37, 0.37]))
    knob = box(0.12, 0.018, 0.018, 0.006).moved(side * 0.88, -0.07, 1.03)
    stem = box(0.02, 0.06, 0.02, 0.006).moved(side, -0.05, 1.03)
    pieces = [shape.piece("door", material) for shape in [leaf, *panels, *jambs, lintel]]
    return [*pieces, knob.piece("handle", metal), stem.piece("handle", metal)]


def ceiling_panel(scene: Furnished, x: float, y: float, size: tuple[float, float], radiance: RGB) -> None:
    """A flat luminous panel on the ceiling."""
    height = scene.size[2]
    housing = box(size[0] + 0.03, size[1] + 0.03, 0.03).moved(x, y, height - 0.031)
    scene.put([housing.piece("lamp", WHITE_PAINT)])
    scene.lights.append(AreaLight((x, y, height - 0.0325), (size[0] / 2, 0.0, 0.0), (0.0, -size[1] / 2, 0.0), radiance))


def pendant_lamp(scene: Furnished, x: float, y: float, z: float, shade: Material, radiance: RGB) -> None:
    """A shade on a cord, open downwards, whose mouth shines."""
    height = scene.size[2]
    profile = [(0.18, z), (0.165, z + 0.05), (0.12, z + 0.13), (0.04, z + 0.19), (0.025, z + 0.2)]
    inner = [(0.02, z + 0.19), (0.115, z + 0.125), (0.16, z + 0.05), (0.176, z)]
    cord = cylinder(0.003, height - z - 0.2).moved(x, y, z + 0.2)
    scene.put([turned(profile).moved(x, y).piece("lamp", shade), cord.piece("lamp", paint(30))])
    scene.put([turned(inner[::-1]).moved(x, y).piece("lamp", WHITE_PAINT)])
    scene.lights.append(AreaLight((x, y, z + 0.02), (0.1, 0.0, 0.0), (0.0, -0.1, 0.0), radiance))


def sunbeam(scene: Furnished, side: str, opening: Opening, target: tuple[float, float, float], sun: RGB) -> None:
    """A patch of sun near a target, as if it came in by a window."""
    at = np.array([(opening.left + opening.right) / 2, -0.02, opening.top - 0.05])
    position = transform_points(scene.wall(side), at)
    pattern = prints.beam_pattern(scene.rng, (int(scene.rng.integers(1, 3)), int(scene.rng.integers(1, 4))))
    angle = float(scene.rng.uniform(26, 40))
    scene.lights.append(Beam(_point(position), target, angle, sun, pattern))


def color_of_light(kelvin: float) -> RGB:
    """Linear RGB, green 1, of a black body (a fit that is good to some percent from 2000 to 12000 K)."""
    t = np.clip(kelvin, 1500.0, 15000.0) / 6500.0
    red = float(t**-0.95 if t < 1 else t**-0.55)
    blue = float(np.clip(t**1.35 if t < 1 else t**0.75, 0.02, 3.0))
    return red, 1.0, blue


def light(kelvin: float, radiance: float) -> RGB:
    """A colour temperature and a strength as linear radiance."""
    red, green, blue = color_of_light(kelvin)
    return red * radiance, green * radiance, blue * radiance


def finished(name: str, seed: int, scene: Furnished, sky: RGB = (0.0, 0.0, 0.0)) -> World:
    """The scene as a world."""
    width, depth, height = scene.size
    lights = [*scene.lights, Sky(sky)] if max(sky) > 0 else scene.lights
    room = np.array([[0.03, 0.03, 0.05], [width - 0.03, depth - 0.03, height - 0.05]])
    return World(name, seed, tuple(scene.pieces), tuple(lights), tuple(scene.stages), room, _white(scene))


def _white(scene: Furnished) -> RGB:
    """Mean colour of the light, by power."""
    total = np.zeros(3)
    for lamp in scene.lights:
        if isinstance(lamp, AreaLight):
            total += 4 * np.linalg.norm(lamp.half_u) * np.linalg.norm(lamp.half_v) * np.pi * np.array(lamp.radiance)
        elif isinstance(lamp, PointLight):
            total += 4 * np.pi * np.array(lamp.intensity)
    if not total.any():
        return (1.0, 1.0, 1.0)
    red, green, blue = (float(value) for value in total / total[1])
    return red, green, blue


def against_wall(scene: Furnished, thing: Thing, side: str, along: float, turn_deg: float = 0.0) -> None:
    """Put furniture with its back to a wall, its middle at `along`."""
    scene.put(placed(thing, frame(turn_deg=turn_deg)), scene.wall(side, along, 0.0) @ frame(0.0, -0.02))


def on_wall(scene: Furnished, shapes: Sequence[tuple[Shape, Material]], side: str, along: float, z: float) -> None:
    """Hang something on a wall."""
    scene.put([shape.piece("on wall", material) for shape, material in shapes], scene.wall(side, along, z))


def surface_frame(scene: Furnished, side: str, along: float, z: float) -> Float[np.ndarray, "4 4"]:
    """Frame of a surface of furniture that stands against a wall: origin at its back, -y into the room."""
    return scene.wall(side, along, z) @ frame(0.0, -0.02)
