"""Tools, screws, cans and boxes of a workshop. Each thing stands on z = 0."""

from __future__ import annotations

import numpy as np

from pipeline.synth.materials import paint, textured
from pipeline.synth.worlds import prints, surfaces
from pipeline.synth.worlds.finishes import DARK, STEEL, plastic, without_hulls
from pipeline.synth.worlds.layout import Thing
from pipeline.synth.worlds.shapes import box, cylinder, joined, tube, turned


def screw_box(rng: np.random.Generator) -> Thing:
    """An open plastic bin, half full of bolts."""
    w, d, h, t = 0.1, 0.16, 0.07, 0.003
    walls = [box(w, d, t), box(t, d, h).moved(x=-w / 2), box(t, d, h).moved(x=w / 2)]
    walls += [box(w, t, h).moved(y=d / 2), box(w, t, 0.6 * h).moved(y=-d / 2)]
    bolts = []
    for _ in range(45):
        bolt = joined([cylinder(0.003, 0.03, 0.0005, 10), cylinder(0.006, 0.005, 0.001, 6)])
        x, y = rng.uniform(-0.44, 0.44, 2) * (w - 0.03, d - 0.04)
        bolt = bolt.tilted("yz", float(rng.uniform(60, 100)), float(rng.uniform(0, 360)))
        bolts.append(without_hulls(bolt.moved(x, y, float(rng.uniform(0.008, 0.03)))))
    color = [(40, 88, 160), (176, 44, 36), (206, 160, 40), (60, 64, 70)][int(rng.integers(4))]
    return [joined(walls).piece("bin", paint(*color, roughness=0.4)), joined(bolts).piece("bolts", STEEL)]


def hammer(rng: np.random.Generator) -> Thing:
    """A hammer that lies."""
    handle = tube(np.array([[0, 0, 0.016], [0.12, 0, 0.016], [0.27, 0, 0.015]]), 0.013)
    head = box(0.028, 0.105, 0.028, 0.004).moved(0.275, 0, 0.002)
    wood = textured(surfaces.wood(rng, "beech", 0.3), 0.5) if rng.random() < 0.6 else plastic(rng)
    return [
        handle.piece("hammer handle", wood),
        head.piece("hammer head", paint(70, 70, 74, roughness=0.35, metallic=1.0)),
    ]


def screwdriver(rng: np.random.Generator) -> Thing:
    """A screwdriver that lies."""
    grip = turned([(0, 0), (0.012, 0), (0.0145, 0.012), (0.0145, 0.06), (0.009, 0.078), (0.012, 0.095), (0, 0.1)], 24)
    blade = cylinder(0.003, 0.12, 0.0005, 14).moved(z=0.1)
    return [
        grip.tilted("y", 90.0).moved(z=0.0145).piece("grip", plastic(rng)),
        blade.tilted("y", 90.0).moved(z=0.0145).piece("blade", STEEL),
    ]


def spanner(rng: np.random.Generator) -> Thing:
    """A ring spanner that lies."""
    length = float(rng.uniform(0.14, 0.22))
    ring = [(0.009, 0), (0.016, 0), (0.016, 0.009), (0.009, 0.009), (0.009, 0)]
    ends = [turned(ring, 24).moved(x=s * length / 2) for s in (-1, 1)]
    bar = box(length - 0.026, 0.012, 0.005, 0.0015).moved(z=0.002)
    return [joined([*ends, bar]).piece("spanner", paint(176, 177, 180, roughness=0.25, metallic=1.0))]


def tape_roll(rng: np.random.Generator) -> Thing:
    """A roll of adhesive tape."""
    r, h = float(rng.uniform(0.04, 0.055)), float(rng.uniform(0.018, 0.05))
    tape = turned([(r - 0.014, 0), (r, 0), (r, h), (r - 0.014, h)])
    core = turned([(r - 0.014, h), (r - 0.016, h), (r - 0.016, 0), (r - 0.014, 0)])
    return [tape.piece("tape", plastic(rng)), core.piece("tape core", paint(190, 160, 120, roughness=0.9))]


def spray_can(rng: np.random.Generator) -> Thing:
    """A spray can."""
    r, h = 0.033, float(rng.uniform(0.16, 0.2))
    paper = textured(prints.label(rng, 2 * np.pi * r, h - 0.012), roughness=0.3)
    body = turned([(0, 0), (r, 0), (r, h), (0.75 * r, h + 0.014), (0, h + 0.014)]).piece("spray can", STEEL)
    band = turned([(r + 0.0004, 0.006), (r + 0.0004, h - 0.006)]).piece("label", paper)
    return [body, band, cylinder(0.026, 0.035).moved(z=h + 0.012).piece("cap", plastic(rng))]


def paint_pot(rng: np.random.Generator) -> Thing:
    """A tin of paint with drips of its colour on the lid."""
    r, h = float(rng.uniform(0.05, 0.085)), float(rng.uniform(0.09, 0.17))
    tin = turned([(0, 0), (r, 0), (r, h), (r - 0.004, h + 0.003), (r - 0.008, h - 0.004), (0, h - 0.004)])
    band = turned([(r + 0.0004, 0.01), (r + 0.0004, h - 0.01)])
    paper = textured(prints.label(rng, 2 * np.pi * r, h - 0.02), roughness=0.35)
    return [tin.piece("tin", STEEL), band.piece("label", paper)]


def toolbox(rng: np.random.Generator) -> Thing:
    """A closed toolbox with a handle."""
    body = box(0.42, 0.2, 0.16, 0.008)
    lid = box(0.43, 0.21, 0.05, 0.012, rounds=2).moved(z=0.16)
    path = np.array([[-0.09, 0, 0.2], [-0.09, 0, 0.24], [0.09, 0, 0.24], [0.09, 0, 0.2]])
    latch = [box(0.03, 0.008, 0.05).moved(x, -0.104, 0.135) for x in (-0.13, 0.13)]
    color = [(180, 36, 30), (40, 70, 120), (58, 62, 60), (208, 150, 30)][int(rng.integers(4))]
    return [
        joined([body, lid]).piece("toolbox", paint(*color, roughness=0.4)),
        joined([tube(path, 0.009), *latch]).piece("toolbox handle", DARK),
    ]
