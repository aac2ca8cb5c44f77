"""Where windows lie: from a pixel of the image to a window of a level and back."""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Integer

from pipeline.hashmatch.config import TEMPLATE_SIZE
from pipeline.hashmatch.detector import LevelMatches
from pipeline.hashmatch.views import CENTER


@runtime_checkable
class Placed(Protocol):
    """A level of the pyramid: `pipeline.hashmatch.pyramid.Level`, or what a recording says about one."""

    @property
    def scale(self) -> float: ...  # noqa: D102
    @property
    def overhang(self) -> int: ...  # noqa: D102


def corner_at(level: Placed, center: Float[np.ndarray, "*n 2"]) -> Integer[np.ndarray, "*n 2"]:
    """First pixel (x, y), in the padded maps of a level, of the window with this centre in the image."""
    return np.rint((np.asarray(center) + 0.5) * level.scale - 0.5 - CENTER + level.overhang).astype(int)


def center_of(level: Placed, corner: Integer[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 2"]:
    """(u_w, v_w): the centre in the image of a window that begins at (x, y) in the padded maps of a level."""
    return (np.asarray(corner) - level.overhang + CENTER + 0.5) / level.scale - 0.5


def window_box(center: Float[np.ndarray, "2"], scale: float) -> tuple[float, float, float, float]:
    """x0, y0, x1, y1 of a window in the image, pixels."""
    half = TEMPLATE_SIZE / 2 / scale
    return float(center[0] - half), float(center[1] - half), float(center[0] + half), float(center[1] + half)


def row_of_corner(matched: LevelMatches, corner: Integer[np.ndarray, "2"]) -> int:
    """Row of the window that begins at (x, y) among the windows of a level."""
    return int(np.flatnonzero((matched.windows == corner).all(axis=1))[0])
