"""Objects on a stage: what is asked for, what comes of it, and why it cannot be had."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from pipeline.exceptions import InputError
from pipeline.scene import Model
from pipeline.synth.worlds.world import Stage


class EmptyStageError(InputError):
    """Nothing rests on the stage, or nothing can."""


class NoRestError(InputError):
    """No try came to rest free of interpenetration."""


class NothingToArrangeError(InputError):
    """There is no object, or one that is no body."""


@dataclass(frozen=True)
class Falling:
    """Objects fall onto the stage, collide and come to rest (thesis sec. synth_composition)."""

    heights: tuple[float, float] = (0.05, 0.5)
    """Metres from the stage to the lowest point of an object at first, uniform."""
    orientation: Literal["canonical", "random"] = "random"
    """At first: any, or upright (z of the model frame up) and turned about the vertical at random."""
    instances: tuple[int, int] = (1, 1)
    """Of each model, uniform, both included."""
    spread: float | None = None
    """Metres across the part of the stage above which objects start, somewhere on it: less makes a denser pile; None
    for all of the stage."""
    kept_in: bool = True
    """Whether walls about that part keep objects in while they fall, to be taken away before the end."""
    tries: int = 6
    """Times to start anew when an arrangement is not sound."""


@dataclass(frozen=True)
class Standing:
    """Objects stand upright, densely placed by collision checks (thesis sec. synth_bop20, as for LM)."""

    instances: tuple[int, int] = (1, 1)
    """Of each model, uniform, both included."""
    gap: tuple[float, float] = (0.001, 0.015)
    """Metres kept free about an object, uniform."""
    tries: int = 4
    """Times to start anew when an arrangement is not sound."""


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Objects that rest on a stage."""

    stage: Stage
    models: tuple[Model, ...]
    """One per object: a model with several instances is there several times."""
    world_from_models: tuple[Float[np.ndarray, "4 4"], ...]
    """Rigid, metres."""
    left_off: tuple[int, ...] = ()
    """Object ids of those that fell off the stage or found no room, one per object."""
    fallen: bool = True
    """Whether physics brought them to rest; what only stands is not asked whether it would fall over."""


@dataclass(frozen=True)
class Soundness:
    """How far an arrangement is from what cannot be."""

    overlap: float
    """Metres: how deep any point of an object lies inside another object or in the world; 0 for none."""
    between: str
    """What overlaps so: "objects 3 and 5", "object 3 and the world"; empty for nothing."""
    lowest: float
    """Metres of the lowest point of all objects above the plane of the stage; below it: negative."""
    speed: float | None
    """Metres per second of the fastest point of an object on average while the simulation goes on for a second; None
    for objects that only stand."""

    @property
    def faults(self) -> list[str]:
        """What is wrong, one short text each; none for a sound arrangement at rest."""
        found = []
        if self.overlap > MAX_OVERLAP:
            found.append(f"{self.between} overlap by {1000 * self.overlap:.1f} mm")
        if self.lowest < -MAX_OVERLAP:
            found.append(f"an object reaches {-1000 * self.lowest:.1f} mm below the stage")
        if self.speed is not None and not self.speed <= REST_SPEED:
            found.append(f"an object moves at {1000 * self.speed:.1f} mm/s")
        return found


MAX_OVERLAP = 0.001
"""Metres of interpenetration that are let pass."""
REST_SPEED = 0.0005
"""Metres per second: what is slower is at rest, and goes at most half a millimetre within a second."""
