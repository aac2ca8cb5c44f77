"""Applying d_c = a d + b to depth as it is stored: whole numbers of 16 bits, `depth_scale` millimetres each."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from jaxtyping import Num, UInt16

from pipeline.exceptions import InputError

LARGEST = np.iinfo(np.uint16).max


class Corrected(NamedTuple):
    """A corrected depth image, and what did not fit."""

    raw: Num[np.ndarray, "h w"]
    """Of the same type and scale as the image that was corrected."""
    too_near: int
    """Pixels that would come out at 0 or less; they become 0, not measured."""
    too_far: int
    """Pixels that would come out beyond the range of 16 bits; they take its end."""


def correct_raw(raw: Num[np.ndarray, "h w"], depth_scale_mm: float, a: float, b: float) -> Corrected:
    """Correct a stored depth image; `b` is in metres, `a` above 0. What was not measured (0) stays so.

    16-bit images are looked up in a table of all their values. Images of floating-point numbers keep their type. Raises
    InputError for other types.
    """
    offset = b * 1000.0 / depth_scale_mm
    if raw.dtype == np.uint16:
        table, nearest, farthest = _table(a, offset)
        too_near = int(np.count_nonzero(raw < nearest) - np.count_nonzero(raw == 0))
        return Corrected(table.take(raw), too_near, int(np.count_nonzero(raw > farthest)))
    if np.issubdtype(raw.dtype, np.floating):
        exact = a * raw.astype(np.float64) + offset
        measured = np.isfinite(raw) & (raw > 0)
        fits = measured & (exact > 0)
        return Corrected(np.where(fits, exact, 0.0).astype(raw.dtype), int((measured & ~fits).sum()), 0)
    raise InputError(f"depth image of {raw.dtype}: only 16-bit and floating-point depth can be corrected; export it so")


class _Table(NamedTuple):
    """Corrected value by value."""

    values: UInt16[np.ndarray, "65536"]
    nearest: int
    """Least value, not 0, that is corrected to 1 or more."""
    farthest: int
    """Largest value that is corrected to one of 16 bits."""


@lru_cache(maxsize=8)
def _table(a: float, offset: float) -> _Table:
    exact = np.rint(a * np.arange(LARGEST + 1) + offset)
    exact[0] = 0.0
    nearest = 1 + int(np.searchsorted(exact[1:], 1.0))
    farthest = int(np.searchsorted(exact[1:], LARGEST, "right"))
    return _Table(np.clip(exact, 0, LARGEST).astype(np.uint16), nearest, farthest)


def check_correction(a: float, b: float) -> None:
    """Raise InputError for a and b (metres) that can be no correction of a depth sensor."""
    if not 0.5 < a < 2.0:
        raise InputError(f"a = {a:g}: the factor of a depth correction is near 1, from 0.5 to 2; check it")
    if not abs(b) < 1.0:
        raise InputError(f"b = {1000 * b:g} mm: the offset of a depth correction is below 1 m; give millimetres")
    if a == 1.0 and b == 0.0:
        raise InputError("a = 1 and b = 0 change nothing; give the correction, or estimate it with --from")
