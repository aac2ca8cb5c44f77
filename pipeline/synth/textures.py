"""Procedural surface colours of tables, floors and clutter: functions from points in metres to linear RGB in 0..1."""

from collections.abc import Callable

import numpy as np
from jaxtyping import Float, Num

Texture = Callable[[Float[np.ndarray, "n 3"]], Float[np.ndarray, "n 3"]]


def linear_from_srgb(color: Num[np.ndarray, "*n 3"] | tuple[int, int, int]) -> Float[np.ndarray, "*n 3"]:
    """Linear RGB in 0..1 of 8-bit colours (gamma 2.2)."""
    return (np.asarray(color, np.float32) / 255.0) ** np.float32(2.2)


def value_noise(points: Float[np.ndarray, "n 3"], seed: int) -> Float[np.ndarray, "n"]:
    """Smooth random values in 0..1 with a lattice of step 1: hashed corners, blended by a smooth step."""
    cell = np.floor(points).astype(np.int64)
    blend = points - cell
    blend = blend * blend * (3.0 - 2.0 * blend)
    value = np.zeros(len(points))
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(corner, blend, 1.0 - blend), axis=1)
        value += weight * _hash(cell + corner, seed)
    return value


def fractal_noise(points: Float[np.ndarray, "n 3"], seed: int, octaves: int = 4) -> Float[np.ndarray, "n"]:
    """Octaves of value noise, each twice as fine and half as strong; in 0..1 about 0.5."""
    total = np.zeros(len(points))
    for k in range(octaves):
        total += 0.5**k * value_noise(points * 2.0**k, seed + k)
    return total / (2.0 - 0.5 ** (octaves - 1))


def oak_planks(points: Float[np.ndarray, "n 3"], seed: int = 3) -> Float[np.ndarray, "n 3"]:
    """Planks of light oak along x: grain from stretched noise, year rings, thin joints."""
    plank = np.floor(points[:, 1] / 0.14)
    tone = _hash(np.stack([plank, plank * 0, plank * 0], -1).astype(np.int64), seed)
    fibre = fractal_noise(points * (9.0, 260.0, 260.0) + plank[:, None] * (7.3, 3.1, 0.0), seed)
    bend = fractal_noise(points * (1.5, 6.0, 6.0) + plank[:, None] * (11.7, 5.0, 0.0), seed + 9, 2)
    phase = (points[:, 1] * 45.0 + 7.0 * bend + 5 * tone) % 1.0  # early wood fades into late wood, then a sharp step
    pores = np.clip(fractal_noise(points * (28.0, 900.0, 900.0), seed + 3, 2) - 0.60, 0, 1) * 2.0
    shade = 0.45 * fibre + 0.30 * phase**2 + 0.6 * pores
    light, dark = linear_from_srgb((208, 180, 144)), linear_from_srgb((150, 116, 82))
    color = light + (dark - light) * np.clip(shade, 0, 1)[:, None]
    color *= (0.86 + 0.28 * tone)[:, None]
    joint = np.abs(points[:, 1] / 0.14 - plank - 0.5) > 0.4925
    return np.where(joint[:, None], 0.35 * color, color).astype(np.float32)


def laminate(points: Float[np.ndarray, "n 3"], seed: int = 5) -> Float[np.ndarray, "n 3"]:
    """A light gray desk top with a fine speckle and faint wide clouds."""
    speckle = value_noise(points * 900.0, seed)
    cloud = fractal_noise(points * 6.0, seed + 4, 3)
    tone = 0.93 + 0.05 * (speckle - 0.5) + 0.12 * (cloud - 0.5)
    return (linear_from_srgb((206, 207, 205)) * tone[:, None]).astype(np.float32)


def workbench(points: Float[np.ndarray, "n 3"], seed: int = 8) -> Float[np.ndarray, "n 3"]:
    """A gray-green rubber bench mat with scuffs and a fine grain."""
    grain = value_noise(points * 700.0, seed)
    cloud = fractal_noise(points * (14.0, 5.0, 5.0), seed + 1, 4)
    scuff = np.clip(fractal_noise(points * (120.0, 7.0, 7.0), seed + 5, 2) - 0.72, 0, 1) * 0.5
    tone = 0.9 + 0.10 * (grain - 0.5) + 0.25 * (cloud - 0.5) + scuff
    return (linear_from_srgb((126, 136, 134)) * tone[:, None]).astype(np.float32)


def floor_tiles(points: Float[np.ndarray, "n 3"], seed: int = 12) -> Float[np.ndarray, "n 3"]:
    """Floor tiles of 0.4 m with joints."""
    cell = np.floor(points / 0.4).astype(np.int64)
    cell[:, 2] = 0
    inside = np.abs(points[:, :2] / 0.4 - cell[:, :2] - 0.5).max(axis=1) < 0.492
    tone = 0.85 + 0.12 * _hash(cell, seed) + 0.15 * (fractal_noise(points * 20, seed, 3) - 0.5)
    tone *= np.where(inside, 1, 0.6)
    return (linear_from_srgb((150, 146, 140)) * tone[:, None]).astype(np.float32)


def cardboard(points: Float[np.ndarray, "n 3"], seed: int = 21) -> Float[np.ndarray, "n 3"]:
    """Brown cardboard with fibres and the faint corrugation below."""
    fibre = fractal_noise(points * (90.0, 25.0, 90.0), seed, 3)
    wave = np.sin(2 * np.pi * points[:, 0] / 0.007)
    tone = 0.95 + 0.22 * (fibre - 0.5) + 0.015 * wave
    return (linear_from_srgb((186, 150, 108)) * tone[:, None]).astype(np.float32)


def _hash(cell: np.ndarray, seed: int) -> Float[np.ndarray, "n"]:
    """Well mixed values in 0..1 of integer lattice points (a multiply-xorshift hash in 64 bits)."""
    with np.errstate(over="ignore"):
        x = cell.astype(np.uint64)
        mixed = x[:, 0] * np.uint64(0x9E3779B97F4A7C15) ^ x[:, 1] * np.uint64(0xC2B2AE3D27D4EB4F)
        mixed = mixed ^ x[:, 2] * np.uint64(0x165667B19E3779F9) ^ np.uint64((seed * 0x27D4EB2F165667C5) % 2**64)
        for shift, factor in ((29, 0xBF58476D1CE4E5B9), (32, 0x94D049BB133111EB)):
            mixed = (mixed ^ (mixed >> np.uint64(shift))) * np.uint64(factor)
        return ((mixed ^ (mixed >> np.uint64(31))) >> np.uint64(11)) / float(2**53)
