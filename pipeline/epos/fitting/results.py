"""What fitting returns, and what it tells about how it came to that."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Int


@dataclass(frozen=True, eq=False)
class FittedPose:
    """The pose of one instance."""

    camera_from_model: Float[np.ndarray, "4 4"]
    """Metres."""
    quality: float
    """0..1, q over all pixels with correspondences (thesis eq. pose_quality_single): several instances share 1."""
    inliers: Int[np.ndarray, "i"]
    """Positions of the inliers in the given correspondences, one per pixel at most."""


@dataclass(frozen=True, eq=False)
class Fitting:
    """The instances of one object, in the order in which they were accepted: the best supported first."""

    poses: tuple[FittedPose, ...]
    pixels: int
    """Pixels with usable correspondences, |U_o|."""
    iterations: int
    """Triplets that poses were computed from."""
    stopped: str
    """Why no more instances were looked for."""


@dataclass(frozen=True, eq=False)
class HypothesisTrace:
    """All hypotheses of a fit in the order in which they were looked at."""

    camera_from_model: Float[np.ndarray, "h 4 4"]
    """Metres."""
    quality: Float[np.ndarray, "h"]
    """q as in the search, 0..1; of `early` ones over the few pixels around the triplet."""
    triplets: Int[np.ndarray, "h 3"]
    """Positions of the sampled triplet in the given correspondences."""
    stage: tuple[str, ...]
    """early: dropped after a look around its triplet. sample: scored. optimized: locally optimized. refined: from all
    inliers. final: as returned."""
    best: Bool[np.ndarray, "h"]
    """True where it was the best so far (pooled: at its place in the image)."""
    proposals: Int[np.ndarray, "h"]
    """Which proposal it belongs to, from 0 (progressive_x); the instance where it is final; else -1."""


@dataclass(frozen=True)
class FittingEvent:
    """One decision: proposed, taken, refused, merged, removed, stopped."""

    kind: str
    text: str
    """For people: numbers with names."""
    instance: int = -1
    """The instance that it is about; -1 for none."""


@dataclass
class FittingTrace:
    """Given to a fit, it is filled with what happened; without one, nothing is kept and no time is spent."""

    capacity: int = 100_000
    """Hypotheses kept at most; later ones are left out."""
    hypotheses: list[HypothesisTrace] = field(default_factory=list)
    """In pieces, in order."""
    events: list[FittingEvent] = field(default_factory=list)

    @property
    def room(self) -> int:
        """How many more hypotheses are kept."""
        return max(0, self.capacity - sum(len(piece.quality) for piece in self.hypotheses))

    def tell(self, kind: str, text: str, instance: int = -1) -> None:
        """Add an event."""
        self.events.append(FittingEvent(kind, text, instance))

    def all_hypotheses(self) -> HypothesisTrace:
        """The pieces joined."""
        pieces = self.hypotheses or [no_hypotheses()]
        arrays = {
            name: np.concatenate([getattr(piece, name) for piece in pieces])
            for name in ("camera_from_model", "quality", "triplets", "best", "proposals")
        }
        return HypothesisTrace(stage=sum((piece.stage for piece in pieces), ()), **arrays)


def no_hypotheses() -> HypothesisTrace:
    """An empty trace."""
    return HypothesisTrace(
        np.zeros((0, 4, 4)), np.zeros(0), np.zeros((0, 3), np.int64), (), np.zeros(0, bool), np.zeros(0, np.int64)
    )
