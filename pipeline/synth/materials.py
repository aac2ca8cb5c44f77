"""What surfaces are made of: colour or texture, roughness, specular and metallic (thesis sec. synth_modeling).

The three numbers mean what they mean in the thesis and in Mitsuba's `principled` material: roughness is the width of
reflections, specular the reflectivity seen face-on, metallic blends from a non-metal (white reflections on a
coloured body) to a metal (coloured reflections only).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, UInt8

RGB = tuple[float, float, float]


@dataclass(frozen=True, eq=False)
class Texture:
    """A picture that repeats over a surface whose texture coordinates are metres."""

    image: UInt8[np.ndarray, "h w 3"]
    """sRGB; first row at the largest second texture coordinate."""
    size: tuple[float, float]
    """Metres that the picture covers, along the first and the second texture coordinate."""
    relief: Float[np.ndarray, "h w"] | None = None
    """Heights in 0..1, for bumps; None for a smooth surface."""
    relief_depth: float = 0.0
    """Metres between heights 0 and 1."""


@dataclass(frozen=True, eq=False)
class Material:
    """The same material properties for a whole surface, as in the thesis."""

    color: RGB | None = None
    """Linear RGB in 0..1; None for the surface's own colours (vertex colours or texture; mid-gray where it has none)."""
    texture: Texture | None = None
    """In place of `color`, on surfaces with texture coordinates."""
    roughness: float = 0.5
    """0 is a mirror, 1 is matt."""
    specular: float = 0.5
    """Reflectivity face-on: 0.5 is that of common plastics, 0 makes a purely diffuse surface."""
    metallic: float = 0.0
    """0 is a non-metal, 1 a metal."""

    def __post_init__(self) -> None:
        values = [self.roughness, self.specular, self.metallic, *(self.color or ())]
        if not all(0.0 <= value <= 1.0 for value in values):
            raise ValueError(f"material with values outside 0..1: {values}; give colours as linear RGB in 0..1")


LAMBERTIAN = Material(roughness=1.0, specular=0.0)
"""Matt, in the object's own colours: what the thesis gives to objects of cardboard."""


def linear(*srgb: float) -> RGB:
    """Linear RGB in 0..1 of an 8-bit sRGB colour, given as three numbers or as one gray value."""
    values = np.clip(np.array(srgb if len(srgb) == 3 else srgb * 3, float) / 255.0, 0.0, 1.0)
    red, green, blue = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)
    return float(red), float(green), float(blue)


def paint(*srgb: float, roughness: float = 0.5, specular: float = 0.5, metallic: float = 0.0) -> Material:
    """A surface of one 8-bit sRGB colour."""
    return Material(linear(*srgb), None, roughness, specular, metallic)


def textured(texture: Texture, roughness: float = 0.5, specular: float = 0.5, metallic: float = 0.0) -> Material:
    """A surface with a picture on it."""
    return Material(None, texture, roughness, specular, metallic)


PLASTIC, PAINTED_METAL, METAL = "plastic", "painted metal", "metal"

_METALS = {"steel": (196, 193, 188), "aluminium": (214, 215, 218), "brass": (222, 190, 116), "copper": (226, 160, 124)}


def fixed_material(kind: str = PLASTIC) -> Material:
    """The usual material of a texture-less object, in the colours of its model."""
    if kind == METAL:
        return Material(linear(*_METALS["steel"]), None, roughness=0.32, specular=0.5, metallic=1.0)
    return Material(
        roughness=0.38 if kind == PLASTIC else 0.28, specular=0.5, metallic=0.0 if kind == PLASTIC else 0.25
    )


def random_material(rng: np.random.Generator, kind: str | None = None) -> Material:
    """A material for an object without texture: plastic, painted metal or metal, of a random plain colour."""
    kind = kind or str(rng.choice([PLASTIC, PAINTED_METAL, METAL], p=[0.6, 0.25, 0.15]))
    if kind == METAL:
        srgb = _METALS[str(rng.choice(list(_METALS)))]
        return Material(linear(*srgb), None, roughness=float(rng.uniform(0.15, 0.5)), metallic=1.0)
    metallic = float(rng.uniform(0.1, 0.4)) if kind == PAINTED_METAL else 0.0
    color = random_color(rng)
    return Material(color, None, float(rng.uniform(0.15, 0.65)), float(rng.uniform(0.3, 0.7)), metallic)


def randomized(material: Material, rng: np.random.Generator) -> Material:
    """The same colours with random roughness, specular and metallic (BOP Challenge 2020, thesis sec. synth_bop20)."""
    return replace(
        material,
        roughness=float(rng.uniform(0.05, 1.0)),
        specular=float(rng.uniform(0.0, 1.0)),
        metallic=float(rng.uniform(0.0, 1.0)) if rng.random() < 0.25 else float(rng.uniform(0.0, 0.15)),
    )


def random_color(rng: np.random.Generator) -> RGB:
    """Linear RGB of a thing that people make: mostly white, gray or black, else of some hue, seldom garish."""
    import colorsys

    if rng.random() < 0.45:
        gray = float(rng.choice([rng.uniform(20, 70), rng.uniform(90, 170), rng.uniform(190, 238)]))
        return linear(gray + rng.uniform(-6, 6), gray, gray + rng.uniform(-8, 6))
    rgb = colorsys.hsv_to_rgb(rng.random(), rng.uniform(0.3, 0.85), rng.uniform(0.35, 0.85))
    return linear(*(255 * value for value in rgb))
