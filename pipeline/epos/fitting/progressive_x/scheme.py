"""Several instances as the thesis fits them: Progressive-X (sec. multi_instance_fitting; Barath & Matas 2019)."""

import numpy as np
from jaxtyping import Bool, Float

from pipeline.epos.fitting.chance import least_support
from pipeline.epos.fitting.config import FittingConfig
from pipeline.epos.fitting.correspondences import PotentialCorrespondences
from pipeline.epos.fitting.primitives.blocks import pixel_weights
from pipeline.epos.fitting.primitives.claims import make_table, quality_outside, take
from pipeline.epos.fitting.primitives.problem import plain_arrays, prepare
from pipeline.epos.fitting.progressive_x.gc_ransac import PerCorrespondence, Pose, View, propose
from pipeline.epos.fitting.progressive_x.pearl import consolidate
from pipeline.epos.fitting.results import FittedPose, Fitting, FittingTrace
from pipeline.epos.fitting.tracing import single, with_origin

_VAIN_PROPOSALS = 3
"""Proposals in a row that bring nothing new, after which the search ends."""


def fit_progressive_x(
    correspondences: PotentialCorrespondences,
    K: Float[np.ndarray, "3 3"],
    config: FittingConfig,
    instances: int | None,
    seed: int,
    trace: FittingTrace | None,
) -> Fitting:
    """Fit instances to usable correspondences sorted by pixel; arguments as of `fit_poses`."""
    state = np.array([seed], np.uint64)
    view = View(prepare(*plain_arrays(correspondences, K), state), config, state, np.zeros(4, np.int64), trace)
    poses: list[Pose] = []
    stopped, vain, proposal, most = "", 0, 0, 0
    while not stopped:
        _extend(view, poses, proposal)
        vain = 0 if len(poses) > most else vain + 1  # PEARL may remove instances for each that comes
        proposal, most = proposal + 1, max(most, len(poses))
        stopped = _reason(view, poses, instances, vain)
    if trace:
        trace.tell("stopped", stopped)
    return _result(view, poses, stopped)


def _extend(view: View, poses: list[Pose], proposal: int) -> None:
    """Propose a pose, and take it if it is new: `poses` is changed."""
    proposed = propose(view, _explained(view, poses), proposal)
    if proposed is None:
        _tell(view, "proposed", f"proposal {proposal}: no pose")
        return
    pose, quality = proposed
    inliers = view.inliers(pose)
    text = f"proposal {proposal}: quality {quality:.3f}, {np.count_nonzero(inliers)} inliers"
    objection = _objection(view, poses, pose, inliers)
    if objection:
        _tell(view, "refused", f"{text}; {objection}")
        return
    _tell(view, "proposed", text, len(poses))
    poses.append(pose)
    if len(poses) > 1:
        _consolidate(view, poses)


def _least_errors(view: View, poses: list[Pose]) -> PerCorrespondence:
    """Least squared error of each correspondence over the poses, e' squared of the thesis."""
    return np.min([view.square_errors(pose) for pose in poses], axis=0) if poses else view.nothing


def _explained(view: View, poses: list[Pose]) -> PerCorrespondence:
    """The least errors; where twins are rejected, each is that of its whole pixel.

    Else the correspondences of twins, which nothing explains, would make each proposal a twin.
    """
    square = _least_errors(view, poses)
    if not view.config.reject_twins:
        return square
    return np.minimum.reduceat(square, view.problem.first[:-1])[view.problem.owner]


def _objection(view: View, poses: list[Pose], pose: Pose, inliers: Bool[np.ndarray, "n"]) -> str:
    """Why a pose is no new instance; empty if it is one."""
    if len(np.unique(view.problem.owner[inliers])) < view.config.min_inliers:
        return f"fewer than {view.config.min_inliers} pixels"
    pixels = len(view.problem.pixels)
    support, least = pixels * view.quality(pose, view.nothing), least_support(view.config, pixels, len(inliers))
    if support < least:
        return f"explains {support:.0f} pixels; {least:.0f} are needed to be better than chance"
    if not poses:
        return ""
    known = _least_errors(view, poses) < view.tau**2
    similarity = np.count_nonzero(inliers & known) / np.count_nonzero(inliers | known)
    if similarity >= view.config.max_similarity:
        return f"Jaccard similarity {similarity:.2f} with the instances found"
    if view.config.reject_twins and not _is_elsewhere(view, poses, pose):
        return "most of its pixels are covered by the instances found"
    return ""


def _is_elsewhere(view: View, poses: list[Pose], pose: Pose) -> bool:
    """Tell whether at least half of a pose's quality is at pixels that the instances found do not take."""
    table, tau = make_table(view.problem, pixel_weights(view.problem.blocks)), view.tau
    for known in poses:
        take(view.problem, known, tau, table)
    whole, own = quality_outside(view.problem, pose, tau, table)
    return own >= 0.5 * whole


def _consolidate(view: View, poses: list[Pose]) -> None:
    """Replace the poses by those that PEARL keeps."""
    found, kept, energies = consolidate(view, poses)
    steps = ", ".join(f"{energy:.1f}" for energy in energies)
    _tell(view, "merged", f"PEARL: energy {steps}; {len(found)} of {len(poses)} instances kept")
    for k in sorted(set(range(len(poses))) - set(kept)):
        _tell(view, "removed", "no correspondence was assigned to it", k)
    poses[:] = found


def _reason(view: View, poses: list[Pose], instances: int | None, vain: int) -> str:
    """Why to stop; empty to go on."""
    if instances is not None and len(poses) >= instances:
        return f"as many as wanted: {instances}"
    if vain >= _VAIN_PROPOSALS:
        return f"{vain} proposals in a row brought nothing new"
    if instances is None and poses:
        probability = _probability_of_another(view, poses)
        if probability < view.config.min_probability:
            return f"the probability of finding another instance is {probability:.2f}"
    return ""


def _probability_of_another(view: View, poses: list[Pose]) -> float:
    """Probability that tau_i triplets hit another instance as large as the smallest known, if there is one."""
    tau = view.tau
    free = np.count_nonzero(_explained(view, poses) >= tau**2)
    smallest = min(np.count_nonzero(view.inliers(pose)) for pose in poses)
    share = min(1.0, smallest / free) if free >= smallest else 0.0
    return 1.0 - (1.0 - share**3) ** view.config.max_iterations


def _result(view: View, poses: list[Pose], stopped: str) -> Fitting:
    """Poses with their inliers: at each pixel the best correspondence of the pose that explains it best."""
    pixels, tau = len(view.problem.pixels), view.tau
    square = np.stack([view.square_errors(pose) for pose in poses]) if poses else np.zeros((0, len(view.nothing)))
    fitted = []
    for k, pose in enumerate(poses):
        mine = np.flatnonzero((square[k] < tau**2) & (square[k] <= square.min(0)))
        order = mine[np.lexsort((square[k][mine], view.problem.owner[mine]))]
        inliers = order[np.unique(view.problem.owner[order], return_index=True)[1]]
        quality = float(np.sum(1.0 - square[k][inliers] / tau**2)) / pixels
        fitted.append(FittedPose(with_origin(pose[None], view.problem.centre)[0], quality, np.sort(inliers)))
        if view.trace:
            view.trace.hypotheses.append(single(pose, view.problem.centre, quality, "final", True, k))
    return Fitting(tuple(fitted), pixels, int(view.counts[0]), stopped)


def _tell(view: View, kind: str, text: str, instance: int = -1) -> None:
    if view.trace:
        view.trace.tell(kind, text, instance)
