"""Poses of the instances of one object from potential correspondences (thesis sec. epos_fitting)."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from pipeline.epos.fitting.config import FittingConfig
from pipeline.epos.fitting.correspondences import PotentialCorrespondences, usable
from pipeline.epos.fitting.results import Fitting, FittingTrace
from pipeline.exceptions import InputError

_MINIMAL = 3
"""Pixels that a pose can be computed from."""


def fit_poses(
    correspondences: PotentialCorrespondences,
    K: Float[np.ndarray, "3 3"],
    config: FittingConfig | None = None,
    *,
    instances: int | None = 1,
    seed: int = 0,
    trace: FittingTrace | None = None,
) -> Fitting:
    """Fit the poses of one object's instances.

    Correspondences with numbers that are not finite, or with a negative confidence, are left out; where fewer than
    three pixels remain, there are no poses. The result depends on the arguments alone.

    Args:
        correspondences: of one object in one image.
        K: intrinsics, upper triangular.
        config: how to fit; None for the defaults.
        instances: how many to look for (6D localization); None to find out (6D detection).
        seed: of the random numbers.
        trace: filled with all hypotheses and decisions, where given.

    Raises:
        InputError: K is no matrix of intrinsics, the number of instances is negative, or the seed does not fit in 64 bits.

    """
    _check(K, instances, seed)
    rows = usable(correspondences)
    untouched = len(rows) == len(correspondences) and bool(np.all(np.diff(rows) == 1))
    good = correspondences if untouched else correspondences.at(rows)
    pixels = int(np.count_nonzero(np.diff(good.pixel_ids))) + 1 if len(good) else 0
    if pixels < _MINIMAL or instances == 0:
        stopped = "no instance was asked for" if instances == 0 else f"{pixels} pixels; a pose needs {_MINIMAL}"
        if trace:
            trace.tell("stopped", stopped)
        return Fitting((), pixels, 0, stopped)
    earlier = len(trace.hypotheses) if trace else 0
    fitting = _fit(good, K, config or FittingConfig(), instances, seed, trace)
    return fitting if untouched else _in_terms_of(rows, fitting, trace, earlier)


def _check(K: Float[np.ndarray, "3 3"], instances: int | None, seed: int) -> None:
    if not (
        np.isfinite(K).all() and K[0, 0] > 0 and K[1, 1] > 0 and K[1, 0] == K[2, 0] == K[2, 1] == 0 and K[2, 2] == 1
    ):
        raise InputError(
            f"fitting: K is {K.tolist()}; expected [[fx, s, cx], [0, fy, cy], [0, 0, 1]] with fx, fy above 0"
        )
    if instances is not None and instances < 0:
        raise InputError(f"fitting: {instances} instances asked for; expected 0 or more, or None to find out")
    if not 0 <= seed < 1 << 64:
        raise InputError(f"fitting: seed is {seed}; expected 0 to 2^64 - 1")


def _fit(
    correspondences: PotentialCorrespondences,
    K: Float[np.ndarray, "3 3"],
    config: FittingConfig,
    instances: int | None,
    seed: int,
    trace: FittingTrace | None,
) -> Fitting:
    """Hand over to the scheme asked for; each imports numba, and what else it needs."""
    if config.scheme == "pooled":
        from pipeline.epos.fitting.pooled.scheme import fit_pooled

        return fit_pooled(correspondences, K, config, instances, seed, trace)
    from pipeline.epos.fitting.progressive_x.scheme import fit_progressive_x

    return fit_progressive_x(correspondences, K, config, instances, seed, trace)


def _in_terms_of(rows: Int[np.ndarray, "m"], fitting: Fitting, trace: FittingTrace | None, earlier: int) -> Fitting:
    """Count inliers and triplets, also in the trace's new pieces, as positions in what was given to us."""
    if trace:
        for i, piece in enumerate(trace.hypotheses[earlier:], earlier):
            triplets = np.where(piece.triplets >= 0, rows[piece.triplets], -1)
            trace.hypotheses[i] = replace(piece, triplets=triplets)
    poses = tuple(replace(pose, inliers=np.sort(rows[pose.inliers])) for pose in fitting.poses)
    return replace(fitting, poses=poses)
