"""Compile the loops of fitting before they are needed: a scheme takes half a minute, once, and seconds from then on."""

from typing import get_args

import numpy as np

from pipeline.epos.fitting.config import FittingConfig, Scheme
from pipeline.epos.fitting.correspondences import correspondences_of_pixels
from pipeline.epos.fitting.fit import fit_poses


def warm_up(*schemes: Scheme) -> None:
    """Fit two instances to points of a cube, by each of the schemes; by all if none is named."""
    K = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
    points = np.stack(np.meshgrid(*[np.linspace(-0.05, 0.05, 4)] * 3), axis=-1).reshape(-1, 3)
    seen = np.concatenate([points + np.array([u, 0.0, 0.5]) for u in (-0.1, 0.1)]) @ K.T
    pixels, both = seen[:, :2] / seen[:, 2:], np.tile(points, (2, 1))
    pairs = correspondences_of_pixels(1, pixels, both, np.ones(len(both)))
    for scheme in schemes or get_args(Scheme):
        fit_poses(pairs, K, FittingConfig(scheme), instances=2)


def is_warm(scheme: Scheme) -> bool:
    """Tell whether the loops of a scheme are compiled and kept on disk."""
    from pipeline.epos.fitting.primitives.compiled import is_kept

    if scheme == "pooled":
        from pipeline.epos.fitting.pooled.scheme import solve

        return is_kept(solve)
    from pipeline.epos.fitting.progressive_x.prosac import find_better

    return is_kept(find_better)
