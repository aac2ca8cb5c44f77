"""From the detections of an object to refined poses that may be instances of it."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Integer

from pipeline.hashmatch.detector import Detector, Matching
from pipeline.hashmatch.evidence import NOTHING, Evidence, gather
from pipeline.hashmatch.pose_search import PoseSearch, boxes_of
from pipeline.hashmatch.pso import Swarm
from pipeline.scene import Model

PLACE_PX = 24
"""Pixels of the image; detections are taken from all squares of this side, or the best places would use up all."""


@dataclass(frozen=True, eq=False)
class Instance:
    """A pose that is proposed for an object."""

    position: int
    """Of the object in the detector's list."""
    row: int
    """Of the detection in the matching that it came from."""
    rough: Float[np.ndarray, "4 4"]
    """P_{t,w}, at the distance that the depth image says (see `Detector.pose`)."""
    pose: Float[np.ndarray, "4 4"]
    """After refinement."""
    score: float
    swarm: Swarm | None = None
    evidence: Evidence = NOTHING
    """What speaks for the pose, whatever else is in the image."""
    rescan: int = 0
    """Number of the matching that it came from, from 0."""

    @property
    def pixels(self) -> Integer[np.ndarray, "n"]:
        """Pixels of the image that the pose explains, numbered row by row."""
        return self.evidence.pixels


def rows_to_refine(detector: Detector, matching: Matching, position: int) -> Integer[np.ndarray, "n"]:
    """The best detections of an object, of all places of the image alike.

    Those that non-maxima suppression removes are among them where poses are refined: they differ in orientation, and
    the depth image tells better than the score which one is right. Without refinement only what is kept counts.
    """
    found, config = matching.detections, detector.config
    if not config.refine:
        return _kept(matching, position)
    rows = np.flatnonzero(found.objects == position)
    return rows[first_of_each_place(found.centers[rows], config.starts)]


def _kept(matching: Matching, position: int) -> Integer[np.ndarray, "n"]:
    found = matching.detections
    return found.kept[found.objects[found.kept] == position]


def first_of_each_place(centers: Float[np.ndarray, "n 2"], count: int) -> Integer[np.ndarray, "k"]:
    """So many rows: the first ones of each square of PLACE_PX pixels, then the second ones, and so on."""
    cells = np.floor(centers / PLACE_PX).astype(np.int64)
    order = np.lexsort((cells[:, 1], cells[:, 0]))  # stable: rows of a square stay in order
    _, first, sizes = np.unique(cells[order], axis=0, return_index=True, return_counts=True)
    turn = np.empty(len(cells), np.int64)
    turn[order] = np.arange(len(cells)) - np.repeat(first, sizes)
    return np.sort(np.argsort(turn, kind="stable")[:count])


def rough_instances(detector: Detector, matching: Matching, position: int) -> list[Instance]:
    """The detections of an object that non-maxima suppression keeps, as they are."""
    rows, ranking = _kept(matching, position), matching.detections.ranking
    poses = [detector.pose(matching, int(row), measured=True) for row in rows]
    return [
        Instance(position, int(row), pose, pose, float(ranking[row])) for row, pose in zip(rows, poses, strict=True)
    ]


def propose(
    detector: Detector,
    matching: Matching,
    position: int,
    model: Model,
    count: int,
    keep_particles: bool = False,
    taken: Bool[np.ndarray, "h w"] | None = None,
    rescan: int = 0,
) -> list[Instance]:
    """Refined poses of an object, best first, some more than the `count` sought; before any is chosen.

    Rough poses are compared with the depth image. The best of them are drawn to the measured surface, the best of these
    once more at more pixels, and the best of those move as swarms. Where surfaces are claimed by others (`taken`), none
    fits. The score of what they come to is taken at all pixels and half the tolerance, which tells similar objects apart.
    """
    rows = rows_to_refine(detector, matching, position)
    if not len(rows):
        return []
    poses = np.array([detector.pose(matching, int(row), measured=True) for row in rows])
    search = PoseSearch(detector.config, model, matching.base, taken, poses, count, rescan)
    origins, moved = search.by_alignment(poses)
    kept, moved = search.by_fine_alignment(moved)
    origins = origins[kept]
    final, moved = search.by_swarms(moved, keep_particles)
    whole = search.fit(1, 0.5)
    scores, evidence = (
        whole.scores(moved, boxes_of(whole, moved)),
        gather(whole, moved, detector.config.hue_tolerance_deg),
    )
    found = []
    for i, (row, pose) in enumerate(zip(rows[origins].tolist(), moved, strict=True)):
        rough = detector.pose(matching, row, measured=True)
        found.append(Instance(position, row, rough, pose, float(scores[i]), final[i], evidence[i], rescan))
    return sorted(found, key=lambda instance: -instance.score)
