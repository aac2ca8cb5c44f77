"""Materials that many small things share."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pipeline.synth.materials import Material, paint
from pipeline.synth.worlds import prints
from pipeline.synth.worlds.shapes import Shape

STEEL = paint(200, 199, 196, roughness=0.28, metallic=1.0)
DARK = paint(38, 38, 42, roughness=0.4)
BLACK = paint(22, 22, 24, roughness=0.35)
WHITE = paint(238, 236, 230, roughness=0.25)
PAGES = paint(236, 230, 214, roughness=0.95, specular=0.0)


def glaze(rng: np.random.Generator) -> Material:
    """Glazed pottery."""
    white = rng.random() < 0.45
    color = (236, 233, 226) if white else prints.vivid(rng, 0.35, 0.85)
    return paint(*color, roughness=float(rng.uniform(0.08, 0.35)), specular=0.6)


def plastic(rng: np.random.Generator) -> Material:
    """Coloured plastic."""
    return paint(*prints.vivid(rng, 0.3, 0.85), roughness=float(rng.uniform(0.25, 0.5)))


def without_hulls(shape: Shape) -> Shape:
    """A small part that nothing needs to collide with."""
    return replace(shape, hulls=())
