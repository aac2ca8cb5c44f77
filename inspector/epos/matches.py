"""Correspondences as the thresholds in force leave them, and how well a pose explains them."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Float64, Int

from inspector.epos.recording import EposRecording
from inspector.epos.thresholds import Thresholds
from pipeline.epos.config import CorrespondenceConfig
from pipeline.epos.fitting.correspondences import PotentialCorrespondences
from pipeline.epos.recomputing import correspondences_from, inliers, potential, residuals
from pipeline.exceptions import InputError


@dataclass(frozen=True, eq=False)
class Matches:
    """Correspondences of an object and a pose that may explain them."""

    links: PotentialCorrespondences
    recorded: bool
    """Whether they are those that the run has fitted poses to, and not computed again."""
    K: Float[np.ndarray, "3 3"]
    camera_from_model: Float[np.ndarray, "4 4"] | None
    tau_r: float

    @cached_property
    def residuals(self) -> Float64[np.ndarray, "n"]:
        """Re-projection errors, pixels; infinite without a pose."""
        if self.camera_from_model is None:
            return np.full(len(self.links), np.inf)
        return residuals(self.links, self.K, self.camera_from_model)

    @cached_property
    def inliers(self) -> Int[np.ndarray, "i"]:
        """Rows of the best correspondence of each pixel that the pose explains."""
        if self.camera_from_model is None:
            return np.zeros(0, np.int64)
        return inliers(self.links, self.K, self.camera_from_model, self.tau_r)

    @cached_property
    def is_inlier(self) -> Bool[np.ndarray, "n"]:
        """Whether each is one of `inliers`."""
        found = np.zeros(len(self.links), bool)
        found[self.inliers] = True
        return found

    @cached_property
    def pixels(self) -> int:
        """How many different pixels there are."""
        return len(np.unique(self.links.pixel_ids))

    @cached_property
    def unexplained(self) -> Int[np.ndarray, "m"]:
        """Rows of the most confident correspondence of each pixel that has no inlier."""
        rows = np.flatnonzero(~np.isin(self.links.pixel_ids, self.links.pixel_ids[self.inliers]))
        by_pixel = rows[np.lexsort((-self.links.confidence[rows], self.links.pixel_ids[rows]))]
        return np.sort(by_pixel[np.unique(self.links.pixel_ids[by_pixel], return_index=True)[1]])

    @cached_property
    def quality(self) -> float:
        """Quality q of the pose (thesis eq. pose_quality_single)."""
        found = 1 - (self.residuals[self.inliers] / self.tau_r) ** 2
        return float(found.sum() / max(self.pixels, 1))


def established(
    recording: EposRecording, now: Thresholds, of_run: Thresholds
) -> tuple[PotentialCorrespondences, bool] | None:
    """Correspondences at the thresholds in force, and whether they are the recorded ones; None where nothing tells.

    Where the thresholds are those of the run, what it has recorded counts: the maps are rounded in a recording.
    """
    fragments, links = recording.fragments, recording.correspondences
    unmoved = now[:2] == of_run[:2]
    if links is not None and (unmoved or not can_recompute(recording)):
        return potential(links), True
    if fragments is None or not can_recompute(recording):
        return None
    regression = fragments.points_in_model is not None
    config = CorrespondenceConfig(now.tau_a, now.tau_b, regression)
    objects = recording.objects
    known = objects is not None and str(recording.obj_id) in objects.labels and objects.grid == fragments.grid
    try:
        found = correspondences_from(
            fragments,
            recording.obj_id,
            objects=objects if known else None,
            centers=None if regression else recording.centers,
            config=config,
        )
    except InputError:
        return None
    return found, False


def can_recompute(recording: EposRecording) -> bool:
    """Whether other thresholds lead to other correspondences: there are fragments, with points or centres."""
    fragments = recording.fragments
    return fragments is not None and (fragments.points_in_model is not None or recording.centers is not None)
