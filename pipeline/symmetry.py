"""Global symmetry transforms of an object from its entry in `models_info.json` (thesis sec. symmetries, S_M)."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.exceptions import FormatError
from pipeline.geometry import transform


def symmetry_transforms(model_info: Mapping[str, Any], max_step: float = 0.01) -> Float[np.ndarray, "s 4 4"]:
    """All symmetry transforms of an object, model frame to model frame, metres, identity first.

    Every discrete symmetry (and the identity) is followed by every discretized continuous one, as in BOP.
    A continuous symmetry has ceil(pi / max_step) rotations, so that the vertex farthest from the axis travels
    at most `max_step` diameters between two of them; 315 at BOP's 0.01. Raises FormatError for a bad entry.
    """
    discrete = [np.eye(4), *map(_discrete, model_info.get("symmetries_discrete", ()))]
    continuous = [_continuous(entry, max_step) for entry in model_info.get("symmetries_continuous", ())]
    if not continuous:
        return np.stack(discrete)
    rotations = np.concatenate(continuous)
    return np.concatenate([rotations @ symmetry for symmetry in discrete])


def _discrete(entry: Any) -> Float[np.ndarray, "4 4"]:
    """One entry of `symmetries_discrete`: 16 numbers, row by row, translation in millimetres."""
    matrix = _numbers(entry, 16, "symmetries_discrete").reshape(4, 4)
    matrix[:3, 3] /= 1000.0
    return matrix


def _continuous(entry: Any, max_step: float) -> Float[np.ndarray, "n 4 4"]:
    """One entry of `symmetries_continuous`: rotations about `axis` through `offset` (millimetres)."""
    if not isinstance(entry, Mapping) or "axis" not in entry:
        raise FormatError(f"symmetries_continuous holds {entry!r}; write it as an axis and an offset of 3 numbers each")
    axis = _numbers(entry["axis"], 3, "axis of symmetries_continuous")
    offset = _numbers(entry.get("offset", (0, 0, 0)), 3, "offset of symmetries_continuous") / 1000.0
    if not np.linalg.norm(axis) > 0:
        raise FormatError(f"axis of symmetries_continuous is {axis.tolist()}; give a direction that is not zero")
    count = int(np.ceil(np.pi / max_step))
    angles = np.arange(count) * (2.0 * np.pi / count)
    rotations = _rotations(axis / np.linalg.norm(axis), angles)
    return np.stack([transform(R, offset - R @ offset) for R in rotations])


def _rotations(axis: Float[np.ndarray, "3"], angles: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n 3 3"]:
    """Rodrigues' formula for many angles about one unit axis."""
    cross = np.cross(np.eye(3), axis)
    cos, sin = np.cos(angles)[:, None, None], np.sin(angles)[:, None, None]
    return cos * np.eye(3) + sin * cross + (1.0 - cos) * np.outer(axis, axis)


def _numbers(values: Any, count: int, what: str) -> np.ndarray:
    try:
        array = np.array(values, dtype=float).ravel()
    except (TypeError, ValueError):
        array = np.empty(0)
    if len(array) != count or not np.isfinite(array).all():
        raise FormatError(f"{what} holds {values!r}; expected {count} finite numbers")
    return array
