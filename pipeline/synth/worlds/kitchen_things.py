"""Crockery, food, bottles and boxes. Each thing stands on z = 0."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from pipeline.synth.materials import Material, paint, textured
from pipeline.synth.worlds import prints, surfaces
from pipeline.synth.worlds.finishes import BLACK, STEEL, WHITE, glaze, plastic
from pipeline.synth.worlds.layout import Thing, frame, placed
from pipeline.synth.worlds.shapes import ball, box, cylinder, joined, sheet, tube, turned, upright


def mug(rng: np.random.Generator) -> Thing:
    """A cup with a handle."""
    r, h, material = rng.uniform(0.036, 0.044), rng.uniform(0.08, 0.105), glaze(rng)
    profile = [
        (0, 0),
        (0.8 * r, 0),
        (0.96 * r, 0.006),
        (r, 0.02),
        (r, h - 0.002),
        (r - 0.002, h),
        (r - 0.004, h - 0.002),
    ]
    body = turned([*profile, (r - 0.004, 0.012), (0, 0.008)])
    angle = np.linspace(-1.35, 1.35, 16)
    path = np.stack([r - 0.004 + 0.028 * np.cos(angle), 0 * angle, h / 2 + 0.32 * h * np.sin(angle)], axis=1)
    coffee = cylinder(r - 0.0045, 0.002).moved(z=0.7 * h)
    drink = paint(58, 36, 22, roughness=0.1) if rng.random() < 0.5 else material
    return [joined([body, tube(path, 0.0055)]).piece("mug", material), coffee.piece("drink", drink)]


def bowl(rng: np.random.Generator, radius: float | None = None, material: Material | None = None) -> Thing:
    """A round bowl."""
    r = radius or rng.uniform(0.07, 0.11)
    angle = np.linspace(0.35, np.pi / 2, 10)
    outer = [(r * np.sin(a), r * 0.62 * (1 - np.cos(a))) for a in angle]
    base = outer[0][1]
    outer = [(x, z - base) for x, z in outer]
    inner = [(max(x - 0.004, 0), z + 0.003) for x, z in outer[::-1]]
    return [turned([(0, 0), *outer, *inner, (0, 0.004)]).piece("bowl", material or glaze(rng))]


def plate(rng: np.random.Generator, material: Material | None = None) -> Thing:
    """A flat plate."""
    r = rng.uniform(0.095, 0.135)
    profile = [(0, 0), (0.6 * r, 0), (0.66 * r, 0.004), (r, 0.018), (r, 0.0205), (0.68 * r, 0.009), (0.6 * r, 0.006)]
    return [turned([*profile, (0, 0.006)], crease_deg=30).piece("plate", material or glaze(rng))]


def plates(rng: np.random.Generator) -> Thing:
    """A stack of plates."""
    material, state = glaze(rng), rng.integers(1 << 30)
    same = [plate(np.random.default_rng(state), material) for _ in range(int(rng.integers(3, 7)))]
    return [piece for k, one in enumerate(same) for piece in placed(one, frame(z=0.0085 * k))]


def bottle(rng: np.random.Generator) -> Thing:
    """A bottle with a label and a cap."""
    r, h = rng.uniform(0.03, 0.042), rng.uniform(0.2, 0.3)
    glass = [(24, 58, 34), (70, 40, 20), (28, 34, 40), (150, 60, 40), (226, 224, 214)][int(rng.integers(5))]
    s = 0.62 * h
    body = [(0, 0), (0.9 * r, 0), (r, 0.006), (r, s), (0.8 * r, s + 0.03), (0.38 * r, s + 0.06), (0.36 * r, h), (0, h)]
    paper = prints.label(rng, 2 * np.pi * r, 0.3 * h)
    band = turned([(r + 0.0004, 0.2 * h), (r + 0.0004, 0.5 * h)])
    cap = cylinder(0.42 * r, 0.028).moved(z=h - 0.02)
    return [
        turned(body).piece("bottle", paint(*glass, roughness=0.08, specular=0.7)),
        band.piece("label", textured(paper, roughness=0.5)),
        cap.piece("cap", plastic(rng)),
    ]


def can(rng: np.random.Generator) -> Thing:
    """A tin with a paper or a drink can."""
    r, h = rng.uniform(0.031, 0.05), rng.uniform(0.08, 0.13)
    rim = [
        (0, 0.002),
        (r - 0.003, 0.002),
        (r - 0.002, 0),
        (r, 0.003),
        (r, h - 0.003),
        (r - 0.002, h),
        (r - 0.004, h - 0.003),
    ]
    paper = prints.label(rng, 2 * np.pi * r, h - 0.014)
    band = turned([(r + 0.0004, 0.007), (r + 0.0004, h - 0.007)])
    tin = turned([*rim, (0, h - 0.003)]).piece("can", STEEL)
    return [tin, band.piece("label", textured(paper, roughness=float(rng.uniform(0.25, 0.6))))]


def jar(rng: np.random.Generator) -> Thing:
    """A jar with a coloured filling, a label and a lid."""
    r, h = rng.uniform(0.034, 0.046), rng.uniform(0.08, 0.13)
    filling = paint(*prints.vivid(rng, 0.2, 0.6), roughness=0.1, specular=0.7)
    body = turned([(0, 0), (0.92 * r, 0), (r, 0.008), (r, 0.82 * h), (0.86 * r, 0.92 * h), (0, 0.92 * h)])
    band = turned([(r + 0.0004, 0.25 * h), (r + 0.0004, 0.7 * h)])
    paper = textured(prints.label(rng, 2 * np.pi * r, 0.45 * h), roughness=0.5)
    lid = cylinder(0.92 * r, 0.016).moved(z=0.9 * h)
    return [body.piece("jar", filling), band.piece("label", paper), lid.piece("lid", plastic(rng))]


def packet(rng: np.random.Generator) -> Thing:
    """A printed cardboard box: cereal, tea, a game."""
    w, d, h = rng.uniform(0.07, 0.2), rng.uniform(0.035, 0.08), rng.uniform(0.1, 0.28)
    return printed_box(rng, w, d, h)


def printed_box(rng: np.random.Generator, w: float, d: float, h: float) -> Thing:
    """A box with a picture on front, back and sides."""
    gloss = float(rng.uniform(0.3, 0.7))
    front = textured(prints.cover(rng, w, h), gloss)
    side = textured(prints.cover(rng, d, h), gloss)
    top = paint(*prints.vivid(rng), roughness=gloss)
    face, flank = upright(sheet(w, h)).moved(z=h / 2), upright(sheet(d, h)).moved(z=h / 2)
    around = [face.moved(y=-d / 2 - 2e-4), face.moved(y=-d / 2 - 2e-4, turn_deg=0).moved(turn_deg=180)]
    flanks = [flank.moved(y=-w / 2 - 2e-4).moved(turn_deg=turn) for turn in (90, -90)]
    return [
        box(w, d, h, 0.001).piece("box", top),
        joined(around).piece("box front", front),
        joined(flanks).piece("box side", side),
    ]


def carton(rng: np.random.Generator) -> Thing:
    """A brown cardboard box with tape."""
    w, d, h = rng.uniform(0.12, 0.36), rng.uniform(0.1, 0.28), rng.uniform(0.07, 0.25)
    tape = box(w + 0.001, 0.048, 0.001, 0.0002).moved(z=h - 0.0002)
    ends = joined([box(0.001, 0.048, 0.06, 0.0002).moved(x=s * w / 2, z=h - 0.06) for s in (-1, 1)])
    brown = textured(surfaces.cardboard(rng), roughness=0.9, specular=0.0)
    tan = paint(190, 160, 118, roughness=0.25)
    return [box(w, d, h, 0.0025).piece("carton", brown), joined([tape, ends]).piece("tape", tan)]


def fruit_bowl(rng: np.random.Generator) -> Thing:
    """A bowl of fruit: apples, oranges or cherries."""
    r = float(rng.uniform(0.1, 0.125))
    kinds = {"apple": (0.036, (172, 40, 34)), "orange": (0.038, (226, 128, 34)), "lemon": (0.028, (232, 200, 50))}
    kinds |= {"cherry": (0.0125, (112, 14, 24)), "green apple": (0.036, (130, 170, 54))}
    name = str(rng.choice(list(kinds)))
    radius, color = kinds[name]
    pieces = bowl(rng, r)
    for at in _heap(rng, radius, r * 0.8, 26 if name == "cherry" else 6):
        skin = paint(*np.clip(np.array(color) + rng.normal(0, 12, 3), 0, 255), roughness=0.3)
        pieces += placed([ball(radius, rng.uniform(0.88, 1.05)).piece(name, skin)], frame(*at))
    return pieces


def _heap(rng: np.random.Generator, radius: float, reach: float, count: int) -> list[tuple[float, float, float]]:
    """Places of balls that lie on the bottom of a bowl and on each other, found greedily from below."""
    placed_at: list[np.ndarray] = []
    for _ in range(count):
        best: np.ndarray | None = None
        for _ in range(40):
            xy = rng.uniform(-1, 1, 2) * (reach - radius)
            if np.hypot(*xy) > reach - radius:
                continue
            z = 0.006 + 0.35 * float(np.hypot(*xy)) ** 2 / reach
            for other in placed_at:
                gap = (2 * radius) ** 2 - float(np.sum((other[:2] - xy) ** 2))
                z = max(z, other[2] + np.sqrt(gap)) if gap > 0 else z
            if best is None or z < best[2]:
                best = np.array([*xy, z])
        if best is not None:
            placed_at.append(best)
    return [(float(x), float(y), float(z)) for x, y, z in placed_at]


def kettle(rng: np.random.Generator) -> Thing:
    """A water kettle on its base."""
    body = [
        (0, 0.02),
        (0.078, 0.02),
        (0.08, 0.03),
        (0.072, 0.15),
        (0.055, 0.195),
        (0.02, 0.205),
        (0.016, 0.218),
        (0, 0.22),
    ]
    material = STEEL if rng.random() < 0.6 else glaze(rng)
    angle = np.linspace(-1.3, 1.45, 14)
    handle = tube(np.stack([0.058 + 0.05 * np.cos(angle), 0 * angle, 0.11 + 0.075 * np.sin(angle)], axis=1), 0.009)
    spout = tube(np.array([[-0.06, 0, 0.13], [-0.085, 0, 0.165], [-0.1, 0, 0.185]]), 0.014)
    return [
        cylinder(0.082, 0.02).piece("kettle base", BLACK),
        joined([turned(body), spout]).piece("kettle", material),
        handle.piece("kettle handle", BLACK),
    ]


def pan(rng: np.random.Generator) -> Thing:
    """A pot with a lid, or a frying pan."""
    r = float(rng.uniform(0.09, 0.12))
    if rng.random() < 0.5:
        profile = [(0, 0), (r * 0.85, 0), (r, 0.045), (r - 0.003, 0.045), (r * 0.83, 0.004), (0, 0.004)]
        handle = tube(np.array([[r - 0.01, 0, 0.038], [r + 0.05, 0, 0.05], [r + 0.19, 0, 0.058]]), 0.009)
        return [
            turned(profile).piece("pan", paint(40, 40, 43, roughness=0.3, metallic=0.6)),
            handle.piece("handle", BLACK),
        ]
    h = float(rng.uniform(0.09, 0.14))
    pot = turned(
        [(0, 0), (r - 0.004, 0), (r, 0.005), (r, h), (r + 0.004, h + 0.002), (0.9 * r, h + 0.012), (0, h + 0.026)]
    )
    ears = [tube(np.array([[s * r, -0.03, h - 0.02], [s * (r + 0.03), 0, h - 0.018], [s * r, 0.03, h - 0.02]]), 0.005)
            for s in (-1, 1)]  # fmt: skip
    knob = ball(0.014).moved(z=h + 0.024)
    return [joined([pot, *ears]).piece("pot", STEEL), knob.piece("knob", BLACK)]


def cutting_board(rng: np.random.Generator) -> Thing:
    """A wooden board."""
    wood = textured(surfaces.wood(rng, str(rng.choice(["beech", "oak", "walnut"])), 0.6), 0.55)
    return [box(rng.uniform(0.3, 0.4), rng.uniform(0.2, 0.26), 0.018, 0.005).piece("cutting board", wood)]


def knife_block(rng: np.random.Generator) -> Thing:
    """A block with knife handles."""
    wood = textured(surfaces.wood(rng, "beech", 0.5), 0.5)
    block = box(0.09, 0.12, 0.22, 0.006)
    handles = [box(0.02, 0.026, 0.1, 0.006).moved(x, y, 0.21) for x in (-0.026, 0.0, 0.026) for y in (-0.03, 0.025)]
    return [block.piece("knife block", wood), joined(handles).piece("knife handle", BLACK)]


def spice_rack(rng: np.random.Generator) -> Thing:
    """Some jars in a row on a little tray."""
    wood = textured(surfaces.wood(rng, "pine", 0.6), 0.6)
    pieces = [box(0.36, 0.1, 0.012).piece("tray", wood)]
    for k in range(4):
        pieces += placed(jar(rng), frame(-0.132 + 0.088 * k, 0.0, 0.012, rng.uniform(-60, 60)) @ _shrunk(0.8))
    return pieces


def _shrunk(factor: float) -> Float[np.ndarray, "4 4"]:
    return np.diag([factor, factor, factor, 1.0])


def dish_soap(rng: np.random.Generator) -> Thing:
    """A plastic bottle with a pump or a cap."""
    r, h = 0.032, float(rng.uniform(0.14, 0.2))
    body = turned([(0, 0), (0.9 * r, 0), (r, 0.01), (r, 0.72 * h), (0.45 * r, 0.86 * h), (0.4 * r, h), (0, h)])
    band = turned([(r + 0.0004, 0.16 * h), (r + 0.0004, 0.62 * h)])
    paper = textured(prints.label(rng, 2 * np.pi * r, 0.46 * h), roughness=0.35)
    cap = turned(
        [(0, h), (0.45 * r, h), (0.45 * r, h + 0.02), (0.15 * r, h + 0.03), (0.15 * r, h + 0.045), (0, h + 0.045)]
    )
    return [body.piece("soap", plastic(rng)), band.piece("label", paper), cap.piece("cap", WHITE)]
