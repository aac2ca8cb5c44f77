"""A single instance as the thesis fits it: PROSAC, P3P, local optimization by graph cut (sec. single_instance_fitting)."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float

from pipeline.epos.fitting.config import FittingConfig
from pipeline.epos.fitting.primitives.hypothesis_log import make_log
from pipeline.epos.fitting.primitives.problem import Problem
from pipeline.epos.fitting.primitives.sampling import make_sampler
from pipeline.epos.fitting.progressive_x.labelling import label_inliers
from pipeline.epos.fitting.progressive_x.max_flow import Adjacency
from pipeline.epos.fitting.progressive_x.neighbourhood import make_neighbourhood
from pipeline.epos.fitting.progressive_x.non_minimal import ransac_of_opencv, solve_pnp
from pipeline.epos.fitting.progressive_x.prosac import Best, find_better, measure, prosac_sizes
from pipeline.epos.fitting.results import FittingTrace
from pipeline.epos.fitting.tracing import logged, single

_MOST_STEPS = 10
"""Local optimization steps for one hypothesis, at most."""


_ROOM = 4
"""Poses that a triplet can have."""


Pose = Float[np.ndarray, "3 4"]


PerCorrespondence = Float[np.ndarray, "n"]


@dataclass(frozen=True, eq=False)
class View:
    """One object's correspondences and how to fit them; poses are of points relative to the object's centre."""

    problem: Problem
    config: FittingConfig
    state: np.ndarray
    """(1,) uint64, of the random numbers."""
    counts: np.ndarray
    """(4,) as of `find_better`."""
    trace: FittingTrace | None

    @property
    def tau(self) -> float:
        """Inlier threshold tau_r, pixels; a float, as other types would be compiled anew."""
        return float(self.config.inlier_threshold_px)

    @cached_property
    def pixels(self) -> Float[np.ndarray, "n 2"]:
        """(u, v) of each correspondence."""
        return self.problem.pixels[self.problem.owner]

    @cached_property
    def nothing(self) -> PerCorrespondence:
        """What no pose explains: infinite errors."""
        return np.full(len(self.problem.points), np.inf)

    @cached_property
    def neighbours(self) -> Adjacency:
        """The 5D neighbourhood graph."""
        return make_neighbourhood(self.pixels, self.problem.points, float(self.config.neighbourhood_radius))

    def square_errors(self, pose: Pose) -> PerCorrespondence:
        """Squared re-projection errors."""
        return measure(self.problem, pose, self.nothing, self.tau)[0]

    def quality(self, pose: Pose, explained: PerCorrespondence) -> float:
        """The thesis's q, given the least squared errors by the other poses."""
        return float(measure(self.problem, pose, explained, self.tau)[1])

    def inliers(self, pose: Pose) -> Bool[np.ndarray, "n"]:
        """Correspondences with an error below tau_r."""
        return self.square_errors(pose) < self.tau**2

    def refined(self, chosen: Bool[np.ndarray, "n"]) -> Pose | None:
        """Pose from the chosen correspondences by the non-minimal solver."""
        return solve_pnp(self.problem.lens, self.pixels[chosen], self.problem.points[chosen], self.config.solver)


def propose(view: View, explained: PerCorrespondence, proposal: int) -> tuple[Pose, float] | None:
    """The best pose for what other poses do not explain, and its quality; None where no triplet gave any.

    Args:
        view: the correspondences.
        explained: least squared errors by other poses, infinite where there are none.
        proposal: its number, for the trace.

    """
    if view.config.ransac == "opencv":
        return _of_opencv(view, explained, proposal)
    config, problem = view.config, view.problem
    sizes = prosac_sizes(len(explained), config.max_iterations)
    sampler = make_sampler(problem, *map(float, config.neighbour_distance_px))
    best = Best(np.zeros((3, 4)), np.zeros(1))
    tried, better = 0, True
    while better and best.quality[0] < config.quality_threshold:
        log = make_log(min(_ROOM * (len(sizes) - tried), view.trace.room) if view.trace else 0)
        tried, better = find_better(
            problem, sampler, sizes, tried, explained, view.tau, float(config.min_triangle_area_px2),
            best, view.state, view.counts, log,
        )  # fmt: skip
        if view.trace:
            view.trace.hypotheses.append(logged(log, problem.centre, 1.0, proposal))
        if better and config.ransac == "gc":
            _optimize(view, best, explained, proposal)
    if best.quality[0] <= 0.0:
        return None
    _improve(view, best, view.inliers(best.pose), explained, "refined", proposal)
    return best.pose, float(best.quality[0])


def _optimize(view: View, best: Best, explained: PerCorrespondence, proposal: int) -> None:
    """Alternate between inliers by graph cut and a pose from them while the quality rises."""
    config = view.config
    for _ in range(_MOST_STEPS):
        square = view.square_errors(best.pose)
        chosen = label_inliers(view.neighbours, square, view.tau, float(config.spatial_coherence))
        if not _improve(view, best, chosen, explained, "optimized", proposal):
            break


def _improve(
    view: View, best: Best, chosen: Bool[np.ndarray, "n"], explained: PerCorrespondence, stage: str, proposal: int
) -> bool:
    """Replace the best pose by that of the chosen correspondences if its quality is higher; tell whether."""
    pose = view.refined(chosen)
    if pose is None:
        return False
    quality = view.quality(pose, explained)
    better = bool(quality > best.quality[0])
    if view.trace:
        view.trace.hypotheses.append(single(pose, view.problem.centre, quality, stage, better, proposal))
    if better:
        best.pose[:], best.quality[0] = pose, quality
    return better


def _of_opencv(view: View, explained: PerCorrespondence, proposal: int) -> tuple[Pose, float] | None:
    """Pose by OpenCV's RANSAC from the pixels that no pose explains."""
    problem, config = view.problem, view.config
    free = np.minimum.reduceat(explained, problem.first[:-1]) >= view.tau**2
    chosen = free[problem.owner]
    pose = ransac_of_opencv(problem.lens, view.pixels[chosen], problem.points[chosen], view.tau, config.max_iterations)
    view.counts[0] += config.max_iterations
    if pose is None:
        return None
    quality = view.quality(pose, explained)
    if view.trace:
        view.trace.hypotheses.append(single(pose, problem.centre, quality, "refined", True, proposal))
    return pose, quality
