"""How well a pose can explain correspondences that mean nothing."""

from pipeline.epos.fitting.config import FittingConfig


def chance_support(pixels: int, correspondences: int, tau_px: float) -> float:
    """Quality, as a sum over pixels, of the best pose that a search finds among random correspondences.

    Fitted to what was measured (`benchmarks/fitting_chance.py`): the largest of 10 searches with 30 to 2000 pixels, each with 1
    to 12 random points of a surface, at inlier thresholds of 2 to 8 pixels. The fit is off by 15 % (one standard
    deviation), and by a third at most. It hardly grows with the number of pixels: more of them are not explained by more.

    Args:
        pixels: with correspondences.
        correspondences: on all of them.
        tau_px: inlier threshold tau_r.

    """
    return 1.6 * pixels**0.13 * (correspondences / pixels) ** 0.44 * tau_px**0.82


_ENOUGH = 0.75
"""Share of the pixels that is enough however few they are: poses of nonsense reached 0.5."""


def least_support(config: FittingConfig, pixels: int, correspondences: int) -> float:
    """Quality, as a sum over pixels, that a pose must have to be returned; arguments as of `chance_support`."""
    better = config.min_over_chance * chance_support(pixels, correspondences, config.inlier_threshold_px)
    return max(float(config.min_inliers), min(better, _ENOUGH * pixels))
