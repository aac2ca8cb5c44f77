"""Numbers of the pooled search, from the parameters of fitting."""

from typing import NamedTuple

import numpy as np

from pipeline.epos.fitting.chance import least_support
from pipeline.epos.fitting.config import FittingConfig

_FEW_PIXELS = 400
"""Per instance: where there are fewer, a look at a few of them tells little, and the whole costs little."""

_SPARE_SLOTS, _SLOTS_PER_INSTANCE, _SLOTS_WITHOUT_NUMBER = 4, 3, 100


class Settings(NamedTuple):
    """Numbers of the search."""

    tau: float
    """Inlier threshold, pixels (thesis tau_r)."""
    raw_tau: float
    """The threshold for hypotheses that were not optimized yet, whose three pixels are noisy."""
    first_tau: float
    """The threshold that local optimization begins with."""
    steps: int
    """Of local optimization."""
    min_area: float
    """Of the triangle of pixels, square pixels (thesis tau_t)."""
    nearest: float
    """Least distance of a triplet's pixels, pixels."""
    farthest: float
    """Largest distance of a triplet's pixels, pixels."""
    coherence: float
    """Share of neighbours whose alternative is the one nearest in 3D."""
    anywhere: float
    """Share of triplets that are drawn by confidence alone."""
    anywhere_if_sparse: float
    """The same while most seeds have no neighbours."""
    early: float
    """Share of the best pose's density of inliers that a hypothesis must show around its triplet to be scored."""
    votes: int
    """A slot is settled when as many hypotheses have agreed with it."""
    wanted: int
    """Number of settled slots that ends the search; 0: never."""
    at_least: int
    """Triplets before the search may end."""
    enough: float
    """Quality (sum over pixels) that ends the search."""


class Rules(NamedTuple):
    """How much to search and what to accept."""

    slots: int
    draws: int
    """Triplets."""
    most: int
    """Instances at most."""
    least: float
    """Quality (sum over pixels) of an instance at least."""
    certainty: float
    """Probability of an instance at least."""
    twins: bool
    """Let several instances claim the same pixels."""


def settings_of(config: FittingConfig, instances: int | None, pixels: int) -> Settings:
    """Settings of a search; `instances` as of `fit_poses`, `pixels` the number of pixels."""
    tau = float(config.inlier_threshold_px)  # other types would be compiled anew
    return Settings(
        tau=tau,
        raw_tau=1.5 * tau,
        first_tau=4.0 * tau,
        steps=6,
        min_area=float(config.min_triangle_area_px2),
        nearest=float(config.neighbour_distance_px[0]),
        farthest=float(config.neighbour_distance_px[1]),
        coherence=0.7,
        anywhere=0.5 if instances == 1 else 0.0,
        anywhere_if_sparse=0.5,
        early=0.1 if pixels < _FEW_PIXELS * (instances or 1) else 0.3,
        votes=config.agreeing,
        wanted=instances or 0,
        at_least=50,
        enough=float(config.quality_threshold * pixels) if instances == 1 else np.inf,
    )


def rules_of(config: FittingConfig, instances: int | None, pixels: int, correspondences: int) -> Rules:
    """Rules of a search; arguments as of `settings_of`, and how many correspondences there are."""
    wanted = None if instances is None else min(instances, pixels)  # more could not each have a pixel
    slots = _SLOTS_WITHOUT_NUMBER if wanted is None else _SPARE_SLOTS + _SLOTS_PER_INSTANCE * wanted
    return Rules(
        slots=slots,
        draws=_draws(config, wanted, pixels),
        most=slots if wanted is None else wanted,
        least=least_support(config, pixels, correspondences),
        certainty=float(config.min_probability) if wanted is None else 0.0,
        twins=not config.reject_twins,
    )


def _draws(config: FittingConfig, wanted: int | None, pixels: int) -> int:
    least, most = (1, 10) if wanted is None else (min(wanted, 3), wanted)
    return int(min(max(config.draws_per_pixel * pixels, least * config.draws), most * config.draws))
