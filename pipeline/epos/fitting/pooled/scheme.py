"""One search for all instances of an object: the variant of fitting that measures best on many-to-many data.

Triplets are drawn near a seed pixel, since the image neighbours of a pixel are mostly of the same instance, and of their
alternatives those nearest in 3D, since alternatives by symmetry lie apart. A hypothesis is looked at in the few pixels
around its triplet, then scored by the thesis's quality in the window that the object projects into. What is the best at
its place in the image so far is locally optimized on the best correspondence per pixel and kept. In the end instances are
chosen greedily, each by the pixels that none before it has taken, and refined together.
"""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Float

from pipeline.epos.fitting.config import FittingConfig
from pipeline.epos.fitting.correspondences import PotentialCorrespondences
from pipeline.epos.fitting.pooled.joint import refine_together
from pipeline.epos.fitting.pooled.search import explore
from pipeline.epos.fitting.pooled.selection import select
from pipeline.epos.fitting.pooled.settings import rules_of, settings_of
from pipeline.epos.fitting.pooled.slots import make_slots
from pipeline.epos.fitting.primitives.blocks import pixel_weights
from pipeline.epos.fitting.primitives.compiled import compiled
from pipeline.epos.fitting.primitives.hypothesis_log import Log, make_log
from pipeline.epos.fitting.primitives.poses import copy_pose
from pipeline.epos.fitting.primitives.problem import plain_arrays, prepare
from pipeline.epos.fitting.results import FittedPose, Fitting, FittingTrace
from pipeline.epos.fitting.tracing import logged, single, with_origin


class Solution(NamedTuple):
    """k instances; poses are of points relative to `centre`."""

    centre: np.ndarray
    """(3,)."""
    pose: np.ndarray
    """(k, 3, 4)."""
    slot: np.ndarray
    """(k,) slot of each."""
    own: np.ndarray
    """(k,) quality at pixels not taken by instances before it."""
    inliers: np.ndarray
    """(k, p) inlier at each pixel, -1 for none."""
    quality: np.ndarray
    """(k,) sum over the inliers."""
    slot_quality: np.ndarray
    """(slots,) of all poses found."""
    refused: np.ndarray
    """(slots,) True where a pose was refused since its pixels were taken."""
    counts: np.ndarray
    """(4,) numbers of triplets, poses, poses scored and poses optimized."""
    over: bool
    """The search ended before all draws were made."""


@compiled()
@no_type_check
def solve(lens, pixels, points, confidence, group, seed, settings, rules, log):
    """Find the instances in correspondences that are sorted by pixel.

    Args:
        lens: (3, 3) K.
        pixels: (n, 2) u, v.
        points: (n, 3), model frame.
        confidence: (n,).
        group: (n,) equal at the same pixel.
        seed: (1,) uint64, changed.
        settings: of the search.
        rules: `Rules`.
        log: changed.

    """
    problem = prepare(lens, pixels, points, confidence, group, seed)
    weight = pixel_weights(problem.blocks)
    slots, counts = make_slots(rules.slots), np.zeros(4, np.int64)
    over = explore(problem, weight, seed, rules.draws, slots, settings, counts, log)
    chosen = select(problem, weight, slots, settings.tau, rules.most, rules.least, rules.certainty, rules.twins)
    pose = np.empty((len(chosen.slot), 3, 4))
    for k in range(len(pose)):
        copy_pose(slots.pose[chosen.slot[k]], pose[k])
    inliers, quality = refine_together(problem, pose, settings.tau)
    return Solution(
        problem.centre, pose, chosen.slot, chosen.own, inliers, quality, slots.quality, chosen.refused, counts, over
    )


def fit_pooled(
    correspondences: PotentialCorrespondences,
    K: Float[np.ndarray, "3 3"],
    config: FittingConfig,
    instances: int | None,
    seed: int,
    trace: FittingTrace | None,
) -> Fitting:
    """Fit instances to usable correspondences sorted by pixel; arguments as of `fit_poses`."""
    c, log = correspondences, make_log(trace.room if trace else 0)
    pixels = 1 + int(np.count_nonzero(np.diff(c.pixel_ids)))
    state = np.array([seed], np.uint64)
    settings, rules = settings_of(config, instances, pixels), rules_of(config, instances, pixels, len(c))
    solution = solve(*plain_arrays(c, K), state, settings, rules, log)
    poses = tuple(
        FittedPose(with_origin(pose[None], solution.centre)[0], float(quality) / pixels, np.sort(inliers[inliers >= 0]))
        for pose, quality, inliers in zip(solution.pose, solution.quality, solution.inliers, strict=True)
    )
    stopped = _why(solution, instances, rules.least)
    if trace:
        _tell(trace, solution, log, pixels, stopped)
    return Fitting(poses, pixels, int(solution.counts[0]), stopped)


def _why(solution: Solution, instances: int | None, least: float) -> str:
    count = len(solution.pose)
    if instances is not None and count == instances:
        return f"as many as wanted: {instances}"
    left = np.delete(solution.slot_quality, solution.slot)
    left = left[~np.delete(solution.refused, solution.slot)].max(initial=0.0)
    taken = int(solution.refused.sum())
    return (
        f"{count} found; {taken} others claim the same pixels, and the best of the rest explains {left:.0f} pixels "
        f"({least:.0f} are needed)"
    )


def _tell(trace: FittingTrace, solution: Solution, log: Log, pixels: int, stopped: str) -> None:
    """Write what the search did into the trace."""
    trace.hypotheses.append(logged(log, solution.centre, float(pixels), -1))
    for k, (pose, quality) in enumerate(zip(solution.pose, solution.quality, strict=True)):
        trace.hypotheses.append(single(pose, solution.centre, quality / pixels, "final", True, k))
    triplets, looked, scored, optimized = (int(number) for number in solution.counts)
    trace.tell("searched", f"{triplets} triplets, {looked} poses, {scored} scored, {optimized} optimized")
    for k, (own, slot) in enumerate(zip(solution.own, solution.slot, strict=True)):
        whole = solution.slot_quality[slot]
        trace.tell("taken", f"quality {whole / pixels:.3f}, of which {own / pixels:.3f} at pixels not taken before", k)
    for slot in np.flatnonzero(solution.refused):
        quality = solution.slot_quality[slot] / pixels
        trace.tell("refused", f"quality {quality:.3f}, mostly at pixels that an accepted instance covers")
    trace.tell("stopped", stopped)
