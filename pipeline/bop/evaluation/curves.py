"""Recall over thresholds of correctness and over visibility, as in the thesis's curves (sec. bop17_results, T-LESS)."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.bop.evaluation.scores import FoundInstances, recalls
from pipeline.bop.evaluation.siso import SisoTargets

VISIBILITY = np.arange(11) / 10
"""Limits of the bins of the visible fraction; the upper one belongs to the next bin, but 1 to the last."""

SISO_THETAS = np.arange(1, 21) / 20
"""Thresholds of the curves of 2017: 0.05, 0.10, ..., 1."""


@dataclass(frozen=True, eq=False)
class Curves:
    """Recalls, 0..1, of some instances."""

    count: int
    """Number of instances."""
    mssd: Float[np.ndarray, "t"]
    """At each of `scores.THETAS`."""
    mspd: Float[np.ndarray, "t"]
    """At each of `scores.MSPD_THETAS_PX`."""
    vsd: Float[np.ndarray, "tau t"] | None
    """At each of `vsd.TAUS` and each of `scores.THETAS`; None where VSD is not known."""
    per_visibility: Int[np.ndarray, "b"]
    """Number of instances in each bin of the visible fraction; those of unknown visibility are in none."""
    mssd_by_visibility: Float[np.ndarray, "b"]
    """Average recall of the instances of each bin; NaN where there are none."""
    mspd_by_visibility: Float[np.ndarray, "b"]
    vsd_by_visibility: Float[np.ndarray, "b"] | None

    def as_dict(self) -> dict[str, Any]:
        """Lists of numbers by the names of the fields."""
        return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(self).items()}


def curves(instances: FoundInstances, rows: Bool[np.ndarray, "n"] | None = None) -> Curves:
    """Curves over all instances, or over some of them."""
    rows = np.ones(len(instances), bool) if rows is None else rows
    bins = visibility_bins(instances.visible_fraction)

    def over_visibility(found: Bool[np.ndarray, "n *t"]) -> Float[np.ndarray, "b"]:
        return mean_by_bin(bins[rows], lambda of_bin: float(recalls(found[rows][of_bin]).mean()))

    vsd = instances.vsd
    return Curves(
        count=int(np.count_nonzero(rows)),
        mssd=recalls(instances.mssd[rows]),
        mspd=recalls(instances.mspd[rows]),
        vsd=None if vsd is None else recalls(vsd[rows]),
        per_visibility=np.bincount(bins[rows & (bins >= 0)], minlength=len(VISIBILITY) - 1),
        mssd_by_visibility=over_visibility(instances.mssd),
        mspd_by_visibility=over_visibility(instances.mspd),
        vsd_by_visibility=None if vsd is None else over_visibility(vsd),
    )


def curves_by(instances: FoundInstances, ids: Int[np.ndarray, "n"]) -> dict[int, Curves]:
    """Curves over the instances of each id, such as those of `instances.obj_id` or `instances.scene_id`."""
    return {int(i): curves(instances, ids == i) for i in np.unique(ids)}


@dataclass(frozen=True, eq=False)
class SisoCurves:
    """Recalls, 0..1, of some targets of 2017."""

    count: int
    vsd: Float[np.ndarray, "tau t"]
    """At each of `siso.TAUS` and each of `SISO_THETAS`."""
    per_visibility: Int[np.ndarray, "b"]
    """Number of targets in each bin of the visible fraction, of the instance seen best."""
    by_visibility: Float[np.ndarray, "b"]
    """Recall of the targets of each bin; NaN where there are none."""

    def as_dict(self) -> dict[str, Any]:
        """Lists of numbers by the names of the fields."""
        return {name: value.tolist() if isinstance(value, np.ndarray) else value for name, value in vars(self).items()}


def siso_curves(targets: SisoTargets, rows: Bool[np.ndarray, "n"] | None = None) -> SisoCurves:
    """Curves over all targets of 2017, or over some of them."""
    rows = np.ones(len(targets), bool) if rows is None else rows
    bins = visibility_bins(targets.visible_fraction)
    return SisoCurves(
        count=int(np.count_nonzero(rows)),
        vsd=recalls(targets.vsd[rows][:, :, None] < SISO_THETAS),
        per_visibility=np.bincount(bins[rows & (bins >= 0)], minlength=len(VISIBILITY) - 1),
        by_visibility=mean_by_bin(bins[rows], lambda of_bin: float(targets.found[rows][of_bin].mean())),
    )


def visibility_bins(fractions: Float[np.ndarray, "n"]) -> Int[np.ndarray, "n"]:
    """Bin of each visible fraction; -1 where it is unknown."""
    last = len(VISIBILITY) - 2
    known = np.isfinite(fractions)
    places = np.searchsorted(VISIBILITY, np.where(known, fractions, 0.0), side="right") - 1
    return np.where(known, np.clip(places, 0, last), -1)


def mean_by_bin(bins: Int[np.ndarray, "n"], mean: Callable[[Bool[np.ndarray, "n"]], float]) -> Float[np.ndarray, "b"]:
    """A mean over the rows of each bin of visibility; NaN where there are none."""
    per_bin = [bins == b for b in range(len(VISIBILITY) - 1)]
    return np.array([mean(of_bin) if of_bin.any() else np.nan for of_bin in per_bin])
