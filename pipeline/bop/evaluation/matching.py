"""Which estimate stands for which ground-truth pose: the greedy matching of BOP.

Estimates are taken by descending score; each takes the ground-truth pose of lowest error among those that are valid
and still free, if that error is below the threshold (thesis sec. bop_accuracy_score; BOP's scripts do the same).
"""

import numpy as np
from jaxtyping import Bool, Float, Int


def match(
    errors: Float[np.ndarray, "e g"],
    threshold: float,
    scores: Float[np.ndarray, "e"] | None = None,
    valid: Bool[np.ndarray, "g"] | None = None,
) -> Int[np.ndarray, "e"]:
    """Match estimates to ground-truth poses of the same object in the same image.

    Args:
        errors: of each estimate against each ground-truth pose; NaN and infinity never match.
        threshold: an error must be strictly below it.
        scores: of the estimates; None where they are in descending order of score already. Equal scores keep their order.
        valid: ground-truth poses that may be matched; None for all.

    Returns:
        For each estimate the position of its ground-truth pose, -1 where it has none.

    """
    order = np.arange(len(errors)) if scores is None else np.argsort(-np.asarray(scores), kind="stable")
    candidates = np.where(np.isfinite(errors) & (errors < threshold), errors, np.inf)
    if valid is not None:
        candidates[:, ~np.asarray(valid)] = np.inf
    ground_truth_of = np.full(len(errors), -1)
    for estimate in order if candidates.size else ():
        best = int(np.argmin(candidates[estimate]))
        if np.isfinite(candidates[estimate, best]):
            ground_truth_of[estimate] = best
            candidates[:, best] = np.inf
    return ground_truth_of


def match_at(errors: Float[np.ndarray, "e g"], thresholds: Float[np.ndarray, "t"]) -> Int[np.ndarray, "e t"]:
    """Match estimates, given by descending score, at many thresholds at once; see `match`."""
    estimates, instances = errors.shape
    if instances == 1 == estimates:  # most targets by far
        return np.where(errors[0] < thresholds, 0, -1)[None]
    ground_truth_of = np.full((estimates, len(thresholds)), -1)
    free = np.ones((len(thresholds), instances), bool)
    for estimate, row in enumerate(errors if instances else ()):
        candidates = np.where(free & (row < thresholds[:, None]), row, np.inf)
        best = candidates.argmin(axis=1)
        matched = np.flatnonzero(np.isfinite(candidates.min(axis=1)))
        free[matched, best[matched]] = False
        ground_truth_of[estimate, matched] = best[matched]
    return ground_truth_of


def assign(errors: Float[np.ndarray, "e g"], scores: Float[np.ndarray, "e"] | None = None) -> Int[np.ndarray, "g"]:
    """Give each ground-truth pose the estimate to compare it with: the same matching with no threshold.

    Arguments are as for `match`; a good error for this is MSSD, which is finite for every finite pose.

    Returns:
        For each ground-truth pose the position of its estimate, -1 where none was left.

    """
    estimate_of = np.full(errors.shape[1], -1)
    for estimate, ground_truth in enumerate(match(errors, np.inf, scores)):
        if ground_truth >= 0:
            estimate_of[ground_truth] = estimate
    return estimate_of
