"""The refinement of an estimate by particle swarm, as it was recorded."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.bop.errors import rotation_error, translation_error
from pipeline.recording import Hypotheses, RecordingReader, Series, Table
from pipeline.scene import PoseEstimate

SAME_POSE = 1e-4
"""Poses whose entries differ by less are the same; a results file holds fewer digits than a recording."""


@dataclass(frozen=True, eq=False)
class Refinement:
    """How the pose of an estimate was refined."""

    number: int
    """Of the estimate in its image."""
    estimate: PoseEstimate
    """Refined."""
    rough: Float[np.ndarray, "4 4"] | None
    """camera_from_model before; None where it was not recorded."""
    swarm: Hypotheses | None
    """All particles of all iterations; None where no swarm was made or recorded."""
    best_scores: Float[np.ndarray, "n"]
    """Of the swarm so far, by iteration; empty without a swarm."""
    detection: int | None
    """Row of the detection that it began with; None where it is not among those recorded."""

    @cached_property
    def steps(self) -> Int[np.ndarray, "n"]:
        """Iteration of each particle, from 0 (where they began)."""
        if self.swarm is None:
            return np.zeros(0, int)
        return np.zeros(len(self.swarm.quality), int) if self.swarm.steps is None else self.swarm.steps

    @property
    def last(self) -> int:
        """The last iteration."""
        return int(self.steps.max()) if len(self.steps) else 0

    def iteration(self, chosen: int | None) -> int:
        """The iteration that is shown."""
        return self.last if chosen is None else min(max(chosen, 0), self.last)

    def particles(self, iteration: int) -> Bool[np.ndarray, "n"]:
        """Those of an iteration."""
        return self.steps == iteration

    @cached_property
    def scores(self) -> tuple[float, float]:
        """Ends of the colour bar: all but the worst tenth of the particles are between them."""
        if self.swarm is None or not len(self.swarm.quality):
            return 0.0, 1.0
        low, high = np.percentile(self.swarm.quality, 10), self.swarm.quality.max()
        return float(low), float(max(high, low + 1e-9))

    def is_pose(self, pose: Float[np.ndarray, "4 4"] | None) -> bool:
        """Whether a pose is the refined one, as far as a results file can tell."""
        return pose is not None and bool(np.abs(pose - self.estimate.camera_from_model).max() < SAME_POSE)

    @property
    def moved(self) -> tuple[float, float] | None:
        """Metres and degrees between the rough and the refined pose; None without a rough one."""
        if self.rough is None:
            return None
        after = self.estimate.camera_from_model
        return float(translation_error(self.rough, after)), float(np.degrees(rotation_error(self.rough, after)))


def read_refinement(reader: RecordingReader, number: int) -> Refinement:
    """The refinement of an estimate. Raises as `RecordingReader.read`."""
    kinds = reader.kinds()
    rough, swarm, score = (f"hashmatch/{name}/{number}" for name in ("rough", "pso", "pso_score"))
    return Refinement(
        number=number,
        estimate=reader.read(f"estimates/{number}", PoseEstimate),
        rough=reader.read(rough, PoseEstimate).camera_from_model if rough in kinds else None,
        swarm=reader.read(swarm, Hypotheses) if swarm in kinds else None,
        best_scores=reader.read(score, Series).values if score in kinds else np.zeros(0),
        detection=_detection(reader, number),
    )


def numbers_of_estimates(reader: RecordingReader) -> list[int]:
    """Numbers of the estimates that are recorded, in order."""
    return sorted(int(path.split("/")[1]) for path in reader.paths("estimates/*"))


def number_of(estimates: dict[int, PoseEstimate], wanted: PoseEstimate | None) -> int | None:
    """Number of the recorded estimate that a row of the results is; None where none is."""
    if wanted is None:
        return None
    for number, estimate in estimates.items():
        apart = np.abs(estimate.camera_from_model - wanted.camera_from_model).max()
        if estimate.obj_id == wanted.obj_id and apart < SAME_POSE:
            return number
    return None


def _detection(reader: RecordingReader, number: int) -> int | None:
    path = "hashmatch/candidates/refined"
    if path not in reader.kinds():
        return None
    columns = reader.read(path, Table).columns
    rows = np.flatnonzero((columns["instance"] == number) & (columns["rescan"] == 0))
    return int(columns["candidate"][rows[0]]) if len(rows) else None
