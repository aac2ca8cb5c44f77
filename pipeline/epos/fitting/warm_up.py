"""Compile the loops of fitting before they are needed: both schemes on a few correspondences."""

import numpy as np

from pipeline.epos.fitting.config import FittingConfig
from pipeline.epos.fitting.correspondences import correspondences_of_pixels
from pipeline.epos.fitting.fit import fit_poses


def warm_up() -> None:
    """Fit two instances to points of a cube, by each scheme; seconds where the machine code is kept, else a minute."""
    K = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
    points = np.stack(np.meshgrid(*[np.linspace(-0.05, 0.05, 4)] * 3), axis=-1).reshape(-1, 3)
    seen = np.concatenate([points + np.array([u, 0.0, 0.5]) for u in (-0.1, 0.1)]) @ K.T
    pixels, both = seen[:, :2] / seen[:, 2:], np.tile(points, (2, 1))
    pairs = correspondences_of_pixels(1, pixels, both, np.ones(len(both)))
    fit_poses(pairs, K, instances=2)
    fit_poses(pairs, K, FittingConfig("progressive_x"), instances=2)
