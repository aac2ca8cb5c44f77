"""Metres to BOP's millimetres such that reading the written number gives the same metres again."""

import numpy as np
from jaxtyping import Float


def millimetres(metres: Float[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """The shortest number of millimetres whose thousandth is the given number of metres, else the nearest one.

    Ground truth that was read and is written unchanged so gets the very digits back that its file had, unless they
    are finer than 1e-9 mm.
    """
    exact = np.asarray(metres, dtype=float) * 1000.0
    candidates = [np.round(exact, 9), exact, np.nextafter(exact, np.inf), np.nextafter(exact, -np.inf)]
    fits = [candidate / 1000.0 == metres for candidate in candidates]
    return np.select(fits, candidates, exact)
