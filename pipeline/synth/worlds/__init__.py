"""Furnished scenes modelled by code, and the cube room of the BOP Challenge 2020 (thesis sec. synth_modeling)."""

from __future__ import annotations

from collections.abc import Callable

from pipeline.exceptions import UnknownIdError
from pipeline.synth.worlds.world import AreaLight, Beam, Piece, PointLight, Sky, Stage, World

__all__ = ["WORLDS", "AreaLight", "Beam", "Piece", "PointLight", "Sky", "Stage", "World", "build_world"]

FURNISHED = ("living_room", "kitchen", "office", "workshop", "storage_shelf")
WORLDS = (*FURNISHED, "cube_room")
"""Names of all scenes; the first five are furnished."""


def build_world(name: str, seed: int = 0) -> World:
    """Build a scene; the seed decides on its materials, clutter and light. Raises `UnknownIdError`, listing names."""
    from importlib import import_module

    if name not in WORLDS:
        raise UnknownIdError("scene", name, "the scenes", WORLDS)
    build: Callable[[int], World] = getattr(import_module(f"pipeline.synth.worlds.{name}"), name)
    return build(seed)
