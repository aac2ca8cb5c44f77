"""Books, papers and what stands on desks. Each thing stands on z = 0."""

from __future__ import annotations

import numpy as np

from pipeline.synth.materials import paint, textured
from pipeline.synth.worlds import prints
from pipeline.synth.worlds.finishes import BLACK, DARK, PAGES, WHITE, glaze, plastic, without_hulls
from pipeline.synth.worlds.layout import Thing, stacked
from pipeline.synth.worlds.shapes import box, cylinder, joined, sheet, tube, turned, upright


def book(rng: np.random.Generator) -> Thing:
    """A closed book that lies flat: cover, pages, printed front."""
    w, d, h = rng.uniform(0.12, 0.21), rng.uniform(0.18, 0.28), rng.uniform(0.012, 0.042)
    binding = paint(*prints.vivid(rng, 0.2, 0.75), roughness=float(rng.uniform(0.3, 0.7)))
    boards = [box(w, d, 0.0025, 0.0008), box(w, d, 0.0025, 0.0008).moved(z=h - 0.0025)]
    boards.append(box(0.003, d, h, 0.001).moved(x=-w / 2 + 0.0015))
    pages = box(w - 0.006, d - 0.008, h - 0.005, 0.0005).moved(x=-0.001, z=0.0025)
    front = sheet(w - 0.002, d - 0.002).moved(z=h + 2e-4)
    return [
        joined(boards).piece("book", binding),
        pages.piece("pages", PAGES),
        front.piece("cover", textured(prints.cover(rng, w - 0.002, d - 0.002), roughness=0.4)),
    ]


def books(rng: np.random.Generator) -> Thing:
    """A pile of books."""
    pile = sorted((book(rng) for _ in range(int(rng.integers(2, 5)))), key=lambda b: -np.ptp(b[0].vertices[:, 1]))
    return stacked(pile, rng)


def book_row(rng: np.random.Generator, width: float) -> Thing:
    """Books that stand side by side, backs to the front (-y), from x = 0 to about `width`; their back ends at y = 0."""
    blocks, x = [], 0.0
    while x < width - 0.06:
        count = int(rng.integers(2, 6))
        span = min(count * float(rng.uniform(0.022, 0.036)), width - x)
        h, d = float(rng.uniform(0.19, 0.27)), float(rng.uniform(0.14, 0.2))
        spine = textured(prints.spines(rng, count, span, h), roughness=0.5)
        front = upright(sheet(span, h)).moved(x + span / 2, -d - 3e-4, h / 2)
        blocks.append(box(span, d, h, 0.002).moved(x + span / 2, -d / 2).piece("books", PAGES))
        blocks.append(front.piece("book spines", spine))
        x += span + (float(rng.uniform(0.05, 0.12)) if rng.random() < 0.15 else 0.0005)
    return blocks


def papers(rng: np.random.Generator) -> Thing:
    """Some printed sheets, one on the other."""
    sheets = []
    for k in range(int(rng.integers(2, 6))):
        paper = textured(prints.page(rng), roughness=0.9, specular=0.0)
        x, y, turn = rng.uniform(-1, 1, 3) * (0.02, 0.02, 12.0)
        sheets.append(sheet(0.21, 0.297).moved(x, y, 0.0008 * (k + 1), turn).piece("paper", paper))
    return sheets


def pen_pot(rng: np.random.Generator) -> Thing:
    """A pot with pens."""
    r, h = 0.038, 0.1
    profile = [(0, 0), (r, 0), (r, h), (r - 0.003, h), (r - 0.003, 0.004), (0, 0.004)]
    pieces = [turned(profile).piece("pen pot", glaze(rng) if rng.random() < 0.5 else DARK)]
    for _ in range(5):
        tilt, turn = rng.uniform(4, 12), rng.uniform(0, 360)
        shape = cylinder(0.004, rng.uniform(0.13, 0.17), segments=10).moved(x=0.008).tilted("y", tilt)
        pieces.append(shape.moved(z=0.008, turn_deg=turn).piece("pen", plastic(rng)))
    return pieces


def pen(rng: np.random.Generator) -> Thing:
    """A pen that lies."""
    rod = turned([(0, 0), (0.001, 0.0), (0.0045, 0.014), (0.0045, 0.135), (0.003, 0.14), (0, 0.14)], 14)
    return [rod.tilted("x", 90.0).moved(z=0.0046).piece("pen", plastic(rng) if rng.random() < 0.7 else BLACK)]


def keyboard(rng: np.random.Generator) -> Thing:
    """A keyboard with single keys."""
    dark = rng.random() < 0.6
    body, caps = (paint(44), paint(28, roughness=0.45)) if dark else (paint(214), paint(236, roughness=0.4))
    keys = [box(0.0165, 0.0165, 0.008, 0.002).moved(-0.2 + 0.0185 * c + 0.004 * r, 0.046 - 0.0188 * r, 0.013)
            for r in range(6) for c in range(22) if not (r == 5 and 4 <= c <= 9)]  # fmt: skip
    keys.append(box(0.108, 0.0165, 0.008, 0.002).moved(-0.2 + 0.0185 * 6.5 + 0.02, 0.046 - 0.0188 * 5, 0.013))
    plain = [without_hulls(key) for key in keys]
    return [box(0.44, 0.135, 0.014, 0.004).piece("keyboard", body), joined(plain).piece("keys", caps)]


def mouse(rng: np.random.Generator) -> Thing:
    """A computer mouse on a mat or without."""
    body = box(0.06, 0.105, 0.034, 0.016, rounds=4).piece("mouse", BLACK if rng.random() < 0.6 else WHITE)
    wheel = cylinder(0.008, 0.006).tilted("y", 90.0).moved(-0.003, 0.03, 0.03).piece("wheel", DARK)
    return [body, wheel]


def monitor(rng: np.random.Generator, width: float = 0.56) -> Thing:
    """A monitor on its foot, looking to -y."""
    height = width * 9 / 16
    foot = box(0.24, 0.18, 0.012, 0.005)
    neck = box(0.05, 0.03, 0.2, 0.006).moved(y=0.03, z=0.01)
    case = box(width + 0.02, 0.028, height + 0.03, 0.006).moved(y=0.0, z=0.12)
    glass = textured(prints.screen(rng, width, height), roughness=0.25, specular=0.6)
    face = upright(sheet(width, height)).moved(y=-0.0145, z=0.12 + 0.018 + height / 2)
    return [joined([foot, neck, case]).piece("monitor", BLACK), face.piece("screen", glass)]


def laptop(rng: np.random.Generator) -> Thing:
    """An open laptop, looking to -y."""
    metal = paint(188, 189, 192, roughness=0.35, metallic=0.9) if rng.random() < 0.6 else DARK
    base = box(0.33, 0.23, 0.014, 0.004)
    keys = sheet(0.28, 0.1).moved(y=0.035, z=0.0143)
    lid = box(0.33, 0.008, 0.22, 0.003).moved(y=0.004)
    glass = textured(prints.screen(rng, 0.31, 0.195), roughness=0.2, specular=0.6)
    face = upright(sheet(0.31, 0.195)).moved(y=-0.0006, z=0.11)
    open_lid = [part.tilted("x", -float(rng.uniform(10, 28))).moved(y=0.112, z=0.012) for part in (lid, face)]
    return [
        joined([base, open_lid[0]]).piece("laptop", metal),
        keys.piece("laptop keys", paint(30, roughness=0.6)),
        open_lid[1].piece("screen", glass),
    ]


def desk_lamp(rng: np.random.Generator) -> Thing:
    """A lamp with two arms and a conical shade (its light is added by the scene)."""
    color = paint(*prints.vivid(rng, 0.3, 0.9), roughness=0.3) if rng.random() < 0.5 else BLACK
    arms = tube(np.array([[0, 0, 0.02], [0.02, 0, 0.05], [0.11, 0, 0.3], [0.1, 0, 0.33], [-0.1, 0, 0.42]]), 0.007)
    shade = turned([(0.075, 0), (0.07, 0.02), (0.035, 0.085), (0.02, 0.1), (0, 0.1)])
    inside = turned([(0, 0.095), (0.03, 0.083), (0.068, 0.018), (0.073, 0)])
    at = {"x": -0.12, "z": 0.35}
    return [
        joined([cylinder(0.085, 0.02, 0.006), arms, shade.moved(**at)]).piece("desk lamp", color),
        inside.moved(**at).piece("lamp inside", WHITE),
    ]
