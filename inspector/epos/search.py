"""The search for poses, replayed: what each hypothesis was, and how the best quality rose."""

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.recording import Hypotheses

MOST_STOPS = 60
"""Hypotheses at which a replay stops, besides those that were the best so far."""
_BEST = "best so far"
_UNCOMPARABLE = "early"
"""Stage of hypotheses that were dropped after a look at a few pixels, so their quality is about these alone."""


class Hypothesis(NamedTuple):
    """One pose that the search looked at."""

    position: int
    """In the search, from 0."""
    stage: str
    """As the method calls it: sample, optimized, refined, final..."""
    best: bool
    """The best so far when it was looked at."""
    quality: float
    camera_from_model: Float[np.ndarray, "4 4"]
    triplet: Int[np.ndarray, "3"] | None
    """Rows of the recorded correspondences that it was computed from."""
    before: "Hypothesis | None"
    """The hypothesis that it is the local optimization of."""
    instance: int
    """The sought instance or proposal, -1 where unknown."""


@dataclass(frozen=True, eq=False)
class Search:
    """All hypotheses of an object in the order of the search."""

    record: Hypotheses
    correspondences: int
    """How many the record's samples may point at."""

    def __len__(self) -> int:
        return len(self.record.quality)

    @cached_property
    def stages(self) -> tuple[str, ...]:
        """What each is, without whether it was the best."""
        labels = self.record.labels or ("hypothesis",) * len(self)
        return tuple(label.split(",")[0].strip() for label in labels)

    @cached_property
    def quality(self) -> Float[np.ndarray, "h"]:
        """Of each; 0 where it is not a number."""
        return np.nan_to_num(self.record.quality.astype(np.float64), posinf=0.0, neginf=0.0)

    @cached_property
    def comparable(self) -> Bool[np.ndarray, "h"]:
        """Whether the quality is over the whole image, so that it can be compared."""
        return np.array([stage != _UNCOMPARABLE for stage in self.stages], bool)

    @cached_property
    def best(self) -> Bool[np.ndarray, "h"]:
        """Whether each was the best so far: as the method says, else by its quality."""
        if any(label.endswith(_BEST) for label in self.record.labels):
            return np.array([label.endswith(_BEST) for label in self.record.labels], bool)
        values = np.where(self.comparable, self.quality, -np.inf)
        return values > np.concatenate([[-np.inf], np.maximum.accumulate(values)[:-1]])

    @cached_property
    def best_quality(self) -> Float[np.ndarray, "h"]:
        """The highest quality up to each; 0 before the first."""
        return np.maximum.accumulate(np.where(self.comparable, self.quality, 0.0))

    def at(self, index: int) -> Hypothesis:
        """A hypothesis by its place in the search; the last one where there are fewer."""
        index = min(max(index, 0), len(self) - 1)
        before = self._begun_from(index)
        return Hypothesis(
            index,
            self.stages[index],
            bool(self.best[index]),
            float(self.quality[index]),
            self.record.camera_from_model[index].astype(np.float64),
            self._triplet(index),
            None if before is None else self.at(before),
            -1 if self.record.instances is None else int(self.record.instances[index]),
        )

    @cached_property
    def stops(self) -> Int[np.ndarray, "s"]:
        """Where a replay stops: at all hypotheses, or evenly among many, and wherever one was the best so far."""
        even = np.linspace(0, len(self) - 1, min(len(self), MOST_STOPS)).round().astype(int)
        best = np.flatnonzero(self.best)
        return np.union1d(even, best[:: max(1, -(-len(best) // MOST_STOPS))])

    def next_best(self, index: int | None) -> int:
        """The next hypothesis that was the best so far, from the first again after the last."""
        found = np.flatnonzero(self.best)
        later = found[found > (-1 if index is None else index)]
        return int(later[0] if len(later) else found[0] if len(found) else 0)

    def _triplet(self, index: int) -> Int[np.ndarray, "3"] | None:
        if self.record.samples is None:
            return None
        rows = self.record.samples[index].astype(np.int64)
        return rows if ((rows >= 0) & (rows < self.correspondences)).all() else None

    def _begun_from(self, index: int) -> int | None:
        """The sample right before a locally optimized hypothesis, with the same triplet."""
        if not index or self.stages[index] != "optimized" or self.stages[index - 1] == "optimized":
            return None
        samples = self.record.samples
        return index - 1 if samples is None or (samples[index] == samples[index - 1]).all() else None
