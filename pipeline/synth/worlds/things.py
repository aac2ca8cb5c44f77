"""All small things that lie about in rooms, under one name; and any one of them as a distractor."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from pipeline.synth.materials import random_material
from pipeline.synth.worlds.finishes import BLACK, DARK, PAGES, STEEL, WHITE, glaze, plastic
from pipeline.synth.worlds.home_things import (
    candle,
    clock,
    cushion,
    picture_frame,
    plant,
    vase,
)
from pipeline.synth.worlds.kitchen_things import (
    bottle,
    bowl,
    can,
    carton,
    cutting_board,
    dish_soap,
    fruit_bowl,
    jar,
    kettle,
    knife_block,
    mug,
    packet,
    pan,
    plate,
    plates,
    printed_box,
    spice_rack,
)
from pipeline.synth.worlds.layout import Thing
from pipeline.synth.worlds.office_things import (
    book,
    book_row,
    books,
    desk_lamp,
    keyboard,
    laptop,
    monitor,
    mouse,
    papers,
    pen,
    pen_pot,
)
from pipeline.synth.worlds.workshop_things import (
    hammer,
    paint_pot,
    screw_box,
    screwdriver,
    spanner,
    spray_can,
    tape_roll,
    toolbox,
)

__all__ = [
    "BLACK",
    "DARK",
    "PAGES",
    "STEEL",
    "WHITE",
    "book",
    "book_row",
    "books",
    "bottle",
    "bowl",
    "can",
    "candle",
    "carton",
    "clock",
    "cushion",
    "cutting_board",
    "desk_lamp",
    "dish_soap",
    "distractor",
    "fruit_bowl",
    "glaze",
    "hammer",
    "jar",
    "kettle",
    "keyboard",
    "knife_block",
    "laptop",
    "monitor",
    "mouse",
    "mug",
    "packet",
    "paint_pot",
    "pan",
    "papers",
    "pen",
    "pen_pot",
    "picture_frame",
    "plant",
    "plastic",
    "plate",
    "plates",
    "printed_box",
    "screw_box",
    "screwdriver",
    "spanner",
    "spice_rack",
    "spray_can",
    "tape_roll",
    "toolbox",
    "vase",
]


def distractor(rng: np.random.Generator) -> Thing:
    """Any small thing, as it is or in one plain random material."""
    makers: tuple[Callable[[np.random.Generator], Thing], ...] = (
        mug, bowl, bottle, can, jar, packet, carton, kettle, pan, book, books, pen_pot, vase, candle, screw_box,
        tape_roll, spray_can, paint_pot, hammer, screwdriver, spanner, dish_soap, mouse, plates, knife_block,
    )  # fmt: skip
    thing = makers[int(rng.integers(len(makers)))](rng)
    if rng.random() < 0.35:
        plain = random_material(rng)
        return [replace(piece, material=plain) for piece in thing]
    return thing
