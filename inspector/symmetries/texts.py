"""How axes of symmetries are written for people."""

import numpy as np

from pipeline.symmetry_search.groups import Axis, Candidate

EXACTLY_DEGREES, NEARLY_DEGREES = 0.02, 3.0
"""Axes that are tilted by less against x, y or z are called so, or nearly so."""


def axis_text(candidate: Candidate) -> str:
    """The direction of an axis for reading: a letter where it is one or nearly so, else three numbers."""
    if candidate.kind == "sphere":
        return "any axis"
    direction = candidate.axis.direction
    for name, unit in zip("xyz", np.eye(3), strict=True):
        tilt = np.degrees(np.arcsin(min(float(np.linalg.norm(np.cross(direction, unit))), 1.0)))
        if tilt < NEARLY_DEGREES:
            return name if tilt < EXACTLY_DEGREES else f"≈ {name}"
    return " ".join(f"{value + 0.0:.2f}" for value in np.round(direction, 2))


def offset_text(axis: Axis) -> str:
    """The axis's point nearest to the model's origin, millimetres; empty where the axis goes through the origin."""
    offset = axis.through * 1000
    return "" if np.abs(offset).max() < 5e-4 else " ".join(f"{value:.2f}" for value in offset)
