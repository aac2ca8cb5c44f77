"""The turntable: a disc on a base, and on it the block with the markers. Board frame: the board's upper side is z = 0."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from pipeline.geometry import transform
from pipeline.synth.boards.marker_board import MarkerBoard
from pipeline.synth.materials import Material, paint
from pipeline.synth.worlds.finishes import BLACK, STEEL, without_hulls
from pipeline.synth.worlds.layout import Thing
from pipeline.synth.worlds.shapes import Shape, box, cylinder, joined, sheet, tube, turned

PAPER = paint(232, 231, 227, roughness=0.8, specular=0.25)
INK = paint(30, 30, 32, roughness=0.7, specular=0.25)
LIFT = 2e-5
"""Metres by which ink, which lies where the board says, stands out from the paper: seen by rays, by nobody else."""
SHEET = 0.012
"""Metres: thickness of a block without markers on its sides."""
DISC, BASE = 0.018, 0.055
"""Metres: heights of the disc and of what it turns on."""
MOTOR_DEG = -32.0
"""Where the motor stands: in front, on the right, too low to hide markers."""
SCREEN_DEG = (195.0, -12.0)
"""From where to where the screen stands about the turntable, as azimuth."""


def block_height(board: MarkerBoard) -> float:
    """Of what lies on the disc, in metres."""
    return board.height or SHEET


def height_over_table(board: MarkerBoard) -> float:
    """Of the board's upper side, in metres."""
    return block_height(board) + DISC + BASE


def disc_radius(board: MarkerBoard) -> float:
    """Metres: the block's corners reach a little beyond the disc."""
    return 0.47 * float(np.hypot(*board.size))


def turning_part(board: MarkerBoard, middle: Material | None) -> Thing:
    """What turns: the block with its print, the free middle of a material of its own (None: paper), and the disc."""
    width, depth = board.size
    height = block_height(board)
    core = box(width - 2 * LIFT, depth - 2 * LIFT, height, 0.0004).moved(z=-height - LIFT)
    corners = np.array(
        [[x, y, z] for x in (-width / 2, width / 2) for y in (-depth / 2, depth / 2) for z in (-height, 0)]
    )
    thing = [replace(core, hulls=(corners,)).piece("marker board", PAPER), _ink(board).piece("markers", INK)]
    if middle is not None and min(board.free) > 0:
        thing.append(without_hulls(sheet(*board.free)).piece("board middle", middle))
    return [*thing, *_disc(disc_radius(board), -height)]


def _ink(board: MarkerBoard) -> Shape:
    """The black cells of all markers, exact at any resolution, as no picture of them would be."""
    return joined([_ink_of(board.corners(k), board.modules(k)) for k in board.ids])


def _ink_of(corners: Float[np.ndarray, "4 3"], black: np.ndarray) -> Shape:
    right, down = (corners[1] - corners[0]) / len(black), (corners[3] - corners[0]) / len(black)
    count = len(black) + 1
    row, column = np.divmod(np.arange(count**2), count)
    points = corners[0] + column[:, None] * right + row[:, None] * down
    r, c = np.nonzero(black)
    a = r * count + c
    faces = np.concatenate([np.stack([a, a + count, a + count + 1], 1), np.stack([a, a + count + 1, a + 1], 1)])
    normal = np.cross(down, right)
    return Shape(points, faces, np.tile(normal / np.linalg.norm(normal), (len(points), 1)), np.zeros((len(points), 2)))


def _disc(radius: float, top: float) -> Thing:
    """A black disc with a bright rim that is divided into degrees."""
    profile = [(0, 0), (radius - 0.002, 0), (radius, 0.002), (radius, DISC - 0.002), (radius - 0.002, DISC), (0, DISC)]
    disc = turned(profile, 120, crease_deg=50.0).moved(z=top - DISC)
    marks = []
    for k in range(72):
        long = k % 9 == 0
        mark = box(0.0016 if long else 0.0009, 0.02 if long else 0.01, 0.0003, 0.0001)
        marks.append(
            without_hulls(mark.moved(y=radius - 0.004 - (0.01 if long else 0.005)).moved(z=top, turn_deg=5.0 * k))
        )
    return [
        disc.piece("turntable disc", paint(34, 35, 37, roughness=0.45)),
        joined(marks).piece("turntable marks", paint(210, 208, 200, roughness=0.6)),
    ]


def standing_part(board: MarkerBoard) -> Thing:
    """What stands still: the base, a motor with its knob, and its cable."""
    radius, floor = disc_radius(board), -height_over_table(board)
    profile = [(0, 0), (0.62 * radius, 0), (0.62 * radius, 0.012), (0.5 * radius, BASE - 0.006), (0.5 * radius, BASE)]
    base = turned([*profile, (0, BASE)], 96).moved(z=floor)
    at = radius + 0.075
    motor = box(0.11, 0.09, 0.062, 0.006, rounds=2).moved(at, 0.0, floor)
    arm = box(0.62 * radius, 0.05, 0.03, 0.004).moved(at - 0.31 * radius, 0.0, floor)
    knob = cylinder(0.014, 0.016, 0.003).moved(at + 0.02, 0.0, floor + 0.062)
    s = np.linspace(0, 1, 30)
    path = [at + 0.05 + 0.14 * s, 0.05 * np.sin(2.6 * s) + 0.25 * s**2, np.full(30, floor + 0.0042)]
    cable = tube(np.stack(path, axis=1), 0.004)
    gray = paint(126, 129, 132, roughness=0.5)
    return [
        base.piece("turntable base", paint(52, 54, 57, roughness=0.5)),
        joined([motor, arm]).moved(turn_deg=MOTOR_DEG).piece("turntable motor", gray),
        knob.moved(turn_deg=MOTOR_DEG).piece("turntable knob", STEEL),
        without_hulls(cable).moved(turn_deg=MOTOR_DEG).piece("cable", BLACK),
    ]


def screen(board: MarkerBoard) -> Thing:
    """A black screen behind the turntable, on the side away from the camera (thesis sec. tless_acquisition_setup)."""
    away, floor = disc_radius(board) + 0.03, -height_over_table(board)
    angle = np.radians(np.linspace(*SCREEN_DEG, 25))
    path = np.stack([np.cos(angle), np.sin(angle)], axis=1) * away
    panels = []
    for (x0, y0), (x1, y1) in pairwise(path):
        length, turn = np.hypot(x1 - x0, y1 - y0), np.arctan2(y1 - y0, x1 - x0)
        panel = box(length + 0.0002, 0.004, 0.8, 0.0005)
        world_from_panel = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1.0]])
        panels.append(panel.placed(transform(world_from_panel, np.array([(x0 + x1) / 2, (y0 + y1) / 2, floor]))))
    return [joined(panels).piece("screen", paint(16, 16, 17, roughness=1.0, specular=0.0))]
