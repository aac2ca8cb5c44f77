"""The cube room of the BOP Challenge 2020 (thesis sec. synth_bop20): random walls, ceiling light, point light, distractors."""

from __future__ import annotations

import numpy as np

from pipeline.synth.materials import Material, textured
from pipeline.synth.worlds import prints, surfaces, things
from pipeline.synth.worlds.layout import Furnished, Thing, frame
from pipeline.synth.worlds.rooms import color_of_light, finished, shell
from pipeline.synth.worlds.world import AreaLight, PointLight, World

SIDE = 4.0
"""Metres."""


def cube_room(seed: int, distractors: int = 10) -> World:
    """An empty cube of one random material; one stage on its floor, with distractors about it."""
    rng = np.random.default_rng([seed, 20])
    scene = Furnished((SIDE, SIDE, SIDE), rng)
    material = random_wall(rng)
    shell(scene, material, material, {}, (0.0, 0.0, 0.0), ceiling=material)
    centre = frame(SIDE / 2, SIDE / 2)
    scene.stage("floor", centre, (-0.3, -0.3), (0.3, 0.3), 1.2)
    scene.scatter(_distractors(rng, distractors), centre, (-0.8, -0.8), (0.8, 0.8))
    _lights(scene)
    return finished("cube_room", seed, scene, sky=(0.02, 0.02, 0.02))


def random_wall(rng: np.random.Generator) -> Material:
    """One of the building materials in a random colour, more or less glossy."""
    gray = float(rng.uniform(70, 235))
    color = prints.vivid(rng, 0.3, 0.9) if rng.random() < 0.5 else (gray, gray, gray)
    makers = (surfaces.tiles, surfaces.stone, surfaces.marble, surfaces.fabric, surfaces.carpet, surfaces.concrete)
    makers += (surfaces.plaster, surfaces.bricks, surfaces.speckled, surfaces.worn_metal, surfaces.cardboard)
    kind = int(rng.integers(len(makers) + 3))
    if kind < len(makers):
        texture = makers[kind](rng, color)
    else:
        texture = (surfaces.wood if kind % 2 else surfaces.planks)(rng, str(rng.choice(list(surfaces.WOODS))))
    return textured(texture, roughness=float(rng.uniform(0.25, 0.95)), specular=float(rng.uniform(0.1, 0.6)))


def _distractors(rng: np.random.Generator, count: int) -> list[Thing]:
    """Things of other shapes, in plain random materials or as they are."""
    return [things.distractor(rng) for _ in range(count)]


def _lights(scene: Furnished) -> None:
    """The ceiling shines as a whole; a bulb hangs somewhere."""
    rng = scene.rng
    tint = np.array(color_of_light(rng.uniform(3000, 9000))) * rng.uniform(0.85, 1.15, 3)
    red, green, blue = (float(value) for value in tint * rng.uniform(1.5, 4.0))
    half = SIDE * 0.48
    centre = (SIDE / 2, SIDE / 2, SIDE - 0.01)
    scene.lights.append(AreaLight(centre, (half, 0.0, 0.0), (0.0, -half, 0.0), (red, green, blue)))
    bulb = np.array(color_of_light(rng.uniform(2500, 8000))) * rng.uniform(0.75, 1.25, 3) * rng.uniform(4.0, 22.0)
    red, green, blue = (float(value) for value in bulb)
    x, y = rng.uniform(-1.4, 1.4, 2) + SIDE / 2
    scene.lights.append(PointLight((float(x), float(y), float(rng.uniform(1.2, 2.6))), (red, green, blue)))
