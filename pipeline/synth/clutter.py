"""Things that lie about in the demo scenes and are no targets: a mug, a carton, blocks, a tape roll, a bin (mm)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float

from pipeline.synth import textures
from pipeline.synth.solids import Color, around_z, cylinder, facing, lathe, polygon, prism, rectangle, union

if TYPE_CHECKING:
    from manifold3d import Manifold

BIN_INSIDE_MM = (310.0, 220.0, 95.0)
BIN_WALL_MM = 7.0


@dataclass(frozen=True)
class Clutter:
    """A thing with its look."""

    build: Callable[[], Manifold]
    texture: textures.Texture | None = None
    roughness: float = 0.4


def _mug() -> Manifold:
    color: Color = (226, 226, 222)
    outer = [(0, 0), (33, 0), (37, 4), (39, 85), (36, 85), (34, 6), (0, 4)]
    handle = prism(rectangle(34, 52, 14) - rectangle(20, 38, 9), 10, color, 2.0)
    handle = facing(handle, "+y", (46, -5, 46))
    inside = lathe(polygon([(0, 4), (34, 6), (36, 90), (0, 90)]), color)
    return union(lathe(polygon(outer, 1.2), color), handle - inside)


def _carton() -> Manifold:
    box = prism(rectangle(105, 72, 1.0), 54, (186, 150, 108), 0.8)
    return box - prism(rectangle(104, 0.8), 2, (90, 70, 48)).translate((0, 0, 53.2))


def _wooden_block() -> Manifold:
    return prism(rectangle(78, 40, 2), 34, (206, 170, 120), 1.5)


def _tape_roll() -> Manifold:
    color: Color = (92, 96, 104)
    tape = lathe(polygon([(27, 0), (44, 0), (44, 24), (27, 24)], 0.8), color, 72)
    core = lathe(polygon([(25, 0.5), (27.5, 0.5), (27.5, 23.5), (25, 23.5)]), (196, 168, 128), 72)
    return union(tape, core)


def _notebook() -> Manifold:
    pages = prism(rectangle(143, 203, 1), 11, (232, 228, 218)).translate((0.8, 0, 1.5))
    cover = prism(rectangle(148, 208, 3), 2, (58, 66, 78), 0.7)
    back = prism(rectangle(3, 206), 13, (58, 66, 78)).translate((-72, 0, 0.5))
    return union(pages, cover, cover.translate((0, 0, 12)), back)


def _screwdriver() -> Manifold:
    blue: Color = (52, 70, 92)
    steel: Color = (178, 178, 176)
    outline = polygon([(0, 0), (11, 0), (13, 12), (13, 60), (9, 72), (12, 84), (7, 92), (0, 92)], 2.5)
    handle = lathe(outline, blue, 48)
    flutes = around_z(cylinder(3.0, 8, 64, blue).translate((15, 0, 0)), 6)
    blade = union(cylinder(3.0, 90, 180, steel), prism(rectangle(7, 1.2), 10, steel).translate((0, 0, 175)))
    return facing(union(handle - flutes, blade), "+x", (-92, 0, 13))


def open_bin() -> Manifold:
    """A plastic stacking bin that stands at z = 0, open at the top."""
    length, width, height = BIN_INSIDE_MM
    wall, color = BIN_WALL_MM, (112, 128, 142)
    shell = prism(rectangle(length + 2 * wall, width + 2 * wall, 14), height + wall, color, 1.5)
    rim = prism(rectangle(length + 4 * wall, width + 4 * wall, 18), 10, color, 2.0)
    inside = prism(rectangle(length, width), height + 40, color).translate((0, 0, wall))
    return union(shell, rim.translate((0, 0, height + wall - 10))) - inside


def _dark_wood(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 3"]:
    return textures.oak_planks(points * (1, 0.15, 1) + 0.07, seed=31) * (0.62, 0.45, 0.34)


CLUTTER = {
    "mug": Clutter(_mug, roughness=0.18),
    "carton": Clutter(_carton, textures.cardboard, 0.9),
    "wooden block": Clutter(_wooden_block, _dark_wood, 0.6),
    "tape roll": Clutter(_tape_roll, roughness=0.3),
    "notebook": Clutter(_notebook, roughness=0.55),
    "screwdriver": Clutter(_screwdriver, roughness=0.25),
}
