"""Scores of the BOP Challenge for 6D localization since 2019: from pose errors to recalls and average recalls.

An instance is found at a threshold if the greedy matching gives it an estimate whose error is below. A recall is the
share of found ones among all instances in question, whatever object or scene they are of; an average recall is its
mean over the thresholds (thesis sec. bop_accuracy_score).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.bop.evaluation.matching import match_at

THETAS = np.arange(0.05, 0.51, 0.05)
"""Thresholds of correctness for VSD, and for MSSD as fractions of the diameter.

Made as BOP's scripts make them: the third is just above 0.15, so a VSD of exactly 0.15 is below it.
"""

MSPD_THETAS_PX = np.arange(5.0, 51.0, 5.0)
"""Thresholds of correctness for MSPD, pixels in an image 640 wide."""


class Scores(NamedTuple):
    """Average recalls, 0..1."""

    vsd: float | None
    """Over misalignment tolerances tau and thresholds theta; None where VSD is not known."""
    mssd: float
    mspd: float

    @property
    def average(self) -> float | None:
        """AR, the mean of the three. A mean of two would be another measure, so it is None where VSD is not known."""
        return None if self.vsd is None else float(np.mean([self.vsd, self.mssd, self.mspd]))


@dataclass(frozen=True, eq=False)
class FoundInstances:
    """The instances that a method is asked for, and at which thresholds it has found them; a row each."""

    scene_id: Int[np.ndarray, "n"]
    im_id: Int[np.ndarray, "n"]
    obj_id: Int[np.ndarray, "n"]
    gt_index: Int[np.ndarray, "n"]
    """Index of the instance among the image's annotations."""
    visible_fraction: Float[np.ndarray, "n"]
    """NaN where unknown."""
    mssd: Bool[np.ndarray, "n t"]
    """At each of `THETAS`."""
    mspd: Bool[np.ndarray, "n t"]
    """At each of `MSPD_THETAS_PX`."""
    vsd: Bool[np.ndarray, "n tau t"] | None = None
    """At each misalignment tolerance and each of `THETAS`; None where VSD is not known."""
    ad: Bool[np.ndarray, "n"] | None = None
    """By the average distance (see `average_distance`); None where it was not asked for."""

    def __len__(self) -> int:
        return len(self.obj_id)


def most_visible(fractions: Sequence[float], count: int) -> list[int]:
    """Positions, ascending, of the `count` most visible instances; of equally visible ones the first count."""
    order = sorted(range(len(fractions)), key=lambda i: -fractions[i])
    return sorted(order[:count])


def found(errors: Float[np.ndarray, "e g"], thresholds: Float[np.ndarray, "t"]) -> Bool[np.ndarray, "g t"]:
    """Tell which instances are found at each threshold: those that `match_at` gives to an estimate.

    Args:
        errors: of each estimate, by descending score, against each instance; NaN and infinity never match.
        thresholds: an error must be strictly below.

    """
    if errors.shape == (1, 1):  # most targets by far
        return errors < thresholds
    matched = match_at(errors, thresholds)
    return (matched == np.arange(errors.shape[1])[:, None, None]).any(axis=1)


def recalls(found_at: Bool[np.ndarray, "n *t"]) -> Float[np.ndarray, "*t"]:
    """Share of the instances found at each threshold; 0 where there are none, as in BOP's scripts."""
    return np.count_nonzero(found_at, axis=0) / max(len(found_at), 1)


def average_recalls(instances: FoundInstances, rows: Bool[np.ndarray, "n"] | slice = slice(None)) -> Scores:
    """Average recalls over all instances, or over some of them."""

    def mean(found_at: Bool[np.ndarray, "n *t"]) -> float:
        return float(recalls(found_at[rows]).mean())

    return Scores(None if instances.vsd is None else mean(instances.vsd), mean(instances.mssd), mean(instances.mspd))


def average_recalls_by(instances: FoundInstances, ids: Int[np.ndarray, "n"]) -> dict[int, Scores]:
    """Average recalls over the instances of each id, such as those of `instances.obj_id` or `instances.scene_id`."""
    return {int(i): average_recalls(instances, ids == i) for i in np.unique(ids)}
