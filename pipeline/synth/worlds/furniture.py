"""Furniture: tables, chairs, shelves, cupboards, a sofa, a workbench. Each stands on z = 0.

Tables and seats are centred; what belongs against a wall has its back at y = 0 and reaches to -y, its middle at x = 0.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.synth.materials import Material, paint
from pipeline.synth.worlds.layout import Thing
from pipeline.synth.worlds.shapes import Shape, box, cylinder, joined, tube, turned
from pipeline.synth.worlds.things import BLACK, STEEL


def table(width: float, depth: float, height: float, top: Material, legs: Material, thickness: float = 0.032) -> Thing:
    """A table with four legs and an apron."""
    plate = box(width, depth, thickness, 0.004, rounds=2).moved(z=height - thickness)
    x, y, low = width / 2 - 0.06, depth / 2 - 0.06, height - thickness
    posts = [box(0.06, 0.06, low, 0.005).moved(sx * x, sy * y) for sx in (-1, 1) for sy in (-1, 1)]
    apron = [box(2 * x - 0.06, 0.022, 0.08).moved(0, s * y, low - 0.08) for s in (-1, 1)]
    apron += [box(0.022, 2 * y - 0.06, 0.08).moved(s * x, 0, low - 0.08) for s in (-1, 1)]
    return [plate.piece("table top", top), joined([*posts, *apron]).piece("table legs", legs)]


def round_table(radius: float, height: float, top: Material, legs: Material) -> Thing:
    """A round table on three slanted legs."""
    plate = turned([(0, height - 0.026), (radius - 0.012, height - 0.026), (radius, height - 0.012), (radius, height - 0.004),
                    (radius - 0.004, height), (0, height)], 72)  # fmt: skip
    plate = replace(plate, uv=plate.vertices[:, :2])  # boards, not rings
    ends = [(0.55 * radius, 0.82 * radius)] * 3
    posts = [tube(np.array([[a, 0, height - 0.02], [b, 0, 0.0]]), 0.02).moved(turn_deg=120.0 * k + 30)
             for k, (a, b) in enumerate(ends)]  # fmt: skip
    return [plate.piece("table top", top), joined(posts).piece("table legs", legs)]


SEAT = 0.45
"""Height of chairs' seats."""


def chair(seat: Material, frame: Material, seat_size: float = 0.42) -> Thing:
    """A chair that looks to -y."""
    half = seat_size / 2
    plate = box(seat_size, seat_size, 0.028, 0.008, rounds=2).moved(z=SEAT - 0.028)
    legs = [tube(np.array([[sx * (half - 0.04), sy * (half - 0.04), SEAT - 0.02], [sx * half, sy * half, 0.0]]), 0.016)
            for sx in (-1, 1) for sy in (-1, 1)]  # fmt: skip
    posts = [tube(np.array([[s * (half - 0.04), half - 0.03, SEAT - 0.03], [s * (half - 0.04), half + 0.05, 0.86]]), 0.013)
             for s in (-1, 1)]  # fmt: skip
    backs = [box(seat_size - 0.05, 0.018, 0.09, 0.007).tilted("x", -10.0).moved(0, half - 0.03 + 0.08 * t, z)
             for t, z in ((0.55, 0.66), (0.85, 0.78))]  # fmt: skip
    return [joined([plate, *backs]).piece("chair seat", seat), joined([*legs, *posts]).piece("chair frame", frame)]


def stool(seat: Material, frame: Material, height: float = 0.5) -> Thing:
    """A round stool with four legs and a ring."""
    plate = cylinder(0.18, 0.035, 0.008).moved(z=height - 0.035)
    plate = replace(plate, uv=plate.vertices[:, :2])
    legs = [
        tube(np.array([[0.11, 0, height - 0.03], [0.17, 0, 0.0]]), 0.013).moved(turn_deg=90.0 * k + 45)
        for k in range(4)
    ]
    angle = np.linspace(0, 2 * np.pi, 25)
    ring = tube(np.stack([0.148 * np.cos(angle), 0.148 * np.sin(angle), 0 * angle + 0.18], axis=1), 0.008)
    return [plate.piece("stool seat", seat), joined([*legs, ring]).piece("stool frame", frame)]


def office_chair(cloth: Material) -> Thing:
    """A swivel chair that looks to -y."""
    spokes = [box(0.3, 0.045, 0.03, 0.008).moved(x=0.16, z=0.06).moved(turn_deg=72.0 * k) for k in range(5)]
    wheels = [
        cylinder(0.028, 0.03).tilted("x", 90.0).moved(0.29, 0.015, 0.028).moved(turn_deg=72.0 * k) for k in range(5)
    ]
    post = cylinder(0.03, 0.36).moved(z=0.06)
    arm = tube(np.array([[0, 0.18, 0.44], [0, 0.27, 0.46], [0, 0.28, 0.6]]), 0.02)
    seat = box(0.48, 0.46, 0.08, 0.035, rounds=3).moved(z=0.42)
    back = box(0.44, 0.07, 0.52, 0.033, rounds=3).tilted("x", -8.0).moved(y=0.25, z=0.58)
    return [
        joined([*spokes, *wheels, post, arm]).piece("chair foot", BLACK),
        joined([seat, back]).piece("chair seat", cloth),
    ]


def bookcase(width: float, height: float, depth: float, material: Material, rows: int = 5) -> Thing:
    """An open bookcase."""
    t = 0.022
    sides = [box(t, depth, height).moved(s * (width - t) / 2, -depth / 2) for s in (-1, 1)]
    boards = [box(width - 2 * t, depth - 0.01, t).moved(0, -depth / 2, z) for z in shelf_heights(height, rows)]
    lid = box(width - 2 * t, depth, t).moved(0, -depth / 2, height - t)
    back = box(width - 2 * t, 0.008, height - 0.06, 0.001).moved(0, -0.004, 0.06)
    return [joined([*sides, *boards, lid, back]).piece("bookcase", material)]


def shelf_heights(height: float, rows: int) -> list[float]:
    """Lower sides of the boards of a bookcase, from the lowest up; each board is 22 mm thick."""
    return [0.06 + (height - 0.06 - 0.022) * k / rows for k in range(rows)]


def cabinet(width: float, height: float, depth: float, body: Material, doors: Material, columns: int, rows: int = 1,
            plinth: float = 0.08) -> Thing:  # fmt: skip
    """A closed cupboard with doors or drawers and bar handles."""
    corpus = box(width, depth - 0.02, height - plinth, 0.002).moved(0, -(depth - 0.02) / 2, plinth)
    foot = box(width - 0.02, depth - 0.07, plinth + 0.01).moved(0, -(depth - 0.06) / 2)
    fronts, handles = [], []
    w, h = width / columns, (height - plinth) / rows
    for c in range(columns):
        for r in range(rows):
            x, z = -width / 2 + w * (c + 0.5), plinth + h * r
            fronts.append(box(w - 0.005, 0.019, h - 0.005, 0.002).moved(x, -depth + 0.0095, z + 0.0025))
            handles.append(_bar_handle(min(0.16, 0.5 * w)).moved(x, -depth, z + h - 0.05))
    return [
        joined([corpus, foot]).piece("cabinet", body),
        joined(fronts).piece("cabinet front", doors),
        joined(handles).piece("handle", STEEL),
    ]


def _bar_handle(length: float) -> Shape:
    bar = cylinder(0.005, length, 0.001, 16).tilted("y", 90.0).moved(-length / 2, -0.03)
    posts = [cylinder(0.004, 0.032, 0.001, 12).tilted("x", 90.0).moved(s * 0.38 * length, 0.0) for s in (-1, 1)]
    return joined([bar, *posts])


def sofa(width: float, cloth: Material, feet: Material) -> Thing:
    """A sofa with its back at y = 0 that looks to -y."""
    depth, seat = 0.88, 0.42
    base = box(width, depth - 0.06, 0.24, 0.03, rounds=3).moved(0, -depth / 2, 0.1)
    arms = [box(0.18, depth, 0.52, 0.06, rounds=4).moved(s * (width / 2 - 0.09), -depth / 2, 0.1) for s in (-1, 1)]
    back = box(width - 0.3, 0.24, 0.62, 0.08, rounds=4).moved(0, -0.14, 0.2)
    count = 3 if width > 1.9 else 2
    w = (width - 0.36) / count
    seats = [box(w - 0.008, depth - 0.22, 0.15, 0.045, rounds=4).moved((k - (count - 1) / 2) * w, -depth / 2 - 0.11, seat - 0.13)
             for k in range(count)]  # fmt: skip
    legs = [cylinder(0.02, 0.1).moved(sx * (width / 2 - 0.1), -depth / 2 + sy * (depth / 2 - 0.1)) for sx in (-1, 1)
            for sy in (-1, 1)]  # fmt: skip
    return [joined([base, *arms, back, *seats]).piece("sofa", cloth), joined(legs).piece("sofa feet", feet)]


def workbench(width: float, depth: float, height: float, top: Material, metal: Material) -> Thing:
    """A heavy bench on a metal frame, with a shelf below and drawers on one side; back at y = 0."""
    plate = box(width, depth, 0.05, 0.005, rounds=2).moved(0, -depth / 2, height - 0.05)
    x, y = width / 2 - 0.05, depth / 2 - 0.05
    posts = [box(0.06, 0.06, height - 0.05).moved(sx * x, -depth / 2 + sy * y) for sx in (-1, 1) for sy in (-1, 1)]
    rails = [box(width - 0.1, 0.04, 0.06).moved(0, -depth / 2 + s * y, height - 0.12) for s in (-1, 1)]
    board = box(width - 0.16, depth - 0.1, 0.025).moved(0, -depth / 2, 0.18)
    chest = box(0.46, depth - 0.08, 0.46, 0.004).moved(width / 2 - 0.33, -depth / 2, height - 0.53)
    drawers = [box(0.44, 0.02, 0.14).moved(width / 2 - 0.33, -depth + 0.03, height - 0.52 + 0.15 * k) for k in range(3)]
    grips = [_bar_handle(0.2).moved(width / 2 - 0.33, -depth + 0.02, height - 0.44 + 0.15 * k) for k in range(3)]
    red = paint(150, 40, 34, roughness=0.4)
    return [
        plate.piece("bench top", top),
        joined([*posts, *rails, board, chest]).piece("bench frame", metal),
        joined(drawers).piece("drawers", red),
        joined(grips).piece("handle", STEEL),
    ]


def vice() -> Thing:
    """A bench vice, its jaws towards -y."""
    body = [
        box(0.14, 0.12, 0.03),
        box(0.09, 0.16, 0.06, 0.01, rounds=2).moved(z=0.03),
        box(0.13, 0.03, 0.09).moved(0, -0.04, 0.06),
    ]
    front = [box(0.13, 0.03, 0.09).moved(0, -0.12, 0.06), box(0.08, 0.08, 0.05, 0.01).moved(0, -0.15, 0.04)]
    spindle = cylinder(0.011, 0.12).tilted("x", 90.0).moved(0, -0.18, 0.06)
    bar = cylinder(0.006, 0.17).tilted("y", 90.0).moved(-0.085, -0.285, 0.06)
    blue = paint(44, 84, 130, roughness=0.4, metallic=0.3)
    return [joined([*body, *front]).piece("vice", blue), joined([spindle, bar]).piece("vice spindle", STEEL)]


def metal_shelf(width: float, height: float, depth: float, material: Material, rows: int) -> Thing:
    """A warehouse shelf of posts and boards; back at y = 0."""
    posts = [box(0.035, 0.035, height, 0.002).moved(sx * (width / 2 - 0.0175), -depth / 2 + sy * (depth / 2 - 0.0175))
             for sx in (-1, 1) for sy in (-1, 1)]  # fmt: skip
    boards = [box(width - 0.01, depth - 0.01, 0.035, 0.003).moved(0, -depth / 2, 0.08 + (height - 0.12) * k / (rows - 1))
              for k in range(rows)]  # fmt: skip
    return [joined([*posts, *boards]).piece("metal shelf", material)]
