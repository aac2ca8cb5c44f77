"""Objects arranged on stages: fallen and come to rest by physics, or standing side by side (thesis sec. synth_composition)."""

from pipeline.synth.arranging.arrangement import (
    Arrangement,
    EmptyStageError,
    Falling,
    NoRestError,
    NothingToArrangeError,
    Soundness,
    Standing,
)
from pipeline.synth.arranging.arranging import arrange, check

__all__ = [
    "Arrangement",
    "EmptyStageError",
    "Falling",
    "NoRestError",
    "NothingToArrangeError",
    "Soundness",
    "Standing",
    "arrange",
    "check",
]
