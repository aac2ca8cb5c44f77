"""Symmetries as `models_info.json` lists them: `symmetries_discrete` and `symmetries_continuous`, millimetres."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from pipeline.bop.units import millimetres
from pipeline.exceptions import FormatError
from pipeline.symmetry import symmetry_transforms
from pipeline.symmetry_search.groups import Axis, SymmetryGroup, axis_of

DISCRETE, CONTINUOUS = "symmetries_discrete", "symmetries_continuous"


def entries_of(group: SymmetryGroup) -> dict[str, list[Any]]:
    """The two lists of BOP; one that would be empty is left out.

    A discrete symmetry is 16 numbers, row by row; the identity is not listed, and of those that differ by a
    continuous one only one, for `pipeline.symmetry.symmetry_transforms` combines them.
    """
    discrete = [_rounded(_with_millimetres(turn).ravel()) for turn in group.discrete]
    continuous = [
        {"axis": _rounded(axis.direction), "offset": _rounded(millimetres(np.round(axis.through, 9)))}
        for axis in group.continuous
    ]
    return {name: entries for name, entries in ((DISCRETE, discrete), (CONTINUOUS, continuous)) if entries}


def group_from(info: Mapping[str, Any]) -> SymmetryGroup:
    """The symmetries that an entry of `models_info.json` lists, metres. Raises FormatError for a bad entry."""
    discrete = symmetry_transforms({DISCRETE: info.get(DISCRETE) or ()})[1:]
    continuous = info.get(CONTINUOUS) or ()
    if not isinstance(continuous, list | tuple):
        raise FormatError(f"{CONTINUOUS} holds {continuous!r}; write it as a list of axes with their offsets")
    return SymmetryGroup(discrete, tuple(_axis(entry) for entry in continuous))


def _axis(entry: Any) -> Axis:
    quarter = symmetry_transforms({CONTINUOUS: [entry]}, max_step=np.pi / 4)[1]
    return axis_of(quarter)


def _with_millimetres(turn: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    turn = turn.copy()
    turn[:3, 3] = millimetres(np.round(turn[:3, 3], 9))
    return turn


def _rounded(values: Float[np.ndarray, "n"]) -> list[float]:
    """Plain numbers, as few digits as say it to 1e-12, no negative zeros."""
    return [float(value) + 0.0 for value in np.round(values, 12)]
