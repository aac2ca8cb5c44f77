"""What the cascade makes of an image: the windows of each level with what passed which stage, and the detections."""

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Float, Integer

from pipeline.hashmatch.level import Level
from pipeline.hashmatch.pyramid import Base
from pipeline.hashmatch.verification import Verified
from pipeline.hashmatch.voting import Candidates


@dataclass(frozen=True, eq=False)
class LevelMatches:
    """What the stages made of the windows of one level."""

    level: Level
    scale: float
    """s_w times the focal length of the templates by that of the image."""
    windows: Integer[np.ndarray, "n 2"]
    """All windows: first pixel (x, y) in the maps of the level."""
    edgel_counts: Integer[np.ndarray, "n"]
    foreground: Integer[np.ndarray, "f"]
    """Rows of the windows that pass objectness."""
    hashed: Integer[np.ndarray, "k"]
    """Rows of those that were hashed: some object is of the right size there (T1, which depends on no template)."""
    allowed: Bool[np.ndarray, "k o"]
    """Which objects are, in each of these."""
    candidates: Candidates
    """`windows` are rows of `self.windows`."""
    verified: Verified


@dataclass(frozen=True, eq=False)
class Detections:
    """Verified candidates of all levels, best first."""

    objects: Integer[np.ndarray, "n"]
    """Position in the detector's list of objects."""
    templates: Integer[np.ndarray, "n"]
    """Row in the object's templates."""
    levels: Integer[np.ndarray, "n"]
    """Index of the level of the pyramid."""
    scales: Float[np.ndarray, "n"]
    """s_w."""
    centers: Float[np.ndarray, "n 2"]
    """(u_w, v_w): pixels of the image."""
    boxes: Float[np.ndarray, "n 4"]
    """x0, y0, x1, y1 of the silhouette in the image, pixels."""
    votes: Integer[np.ndarray, "n"]
    fractions: Float[np.ndarray, "n 4"]
    """c_2 to c_5."""
    shifts: Float[np.ndarray, "n"]
    """Metres; median of measured minus template distance."""
    ranking: Float[np.ndarray, "n"]
    """r = c (a / s)."""
    suppressed_by: Integer[np.ndarray, "n"]
    """Row of the detection that suppressed it; its own where it is kept."""

    def __len__(self) -> int:
        return len(self.objects)

    @property
    def kept(self) -> Integer[np.ndarray, "k"]:
        """Rows that non-maxima suppression keeps, best first."""
        return np.flatnonzero(self.suppressed_by == np.arange(len(self)))


@dataclass(frozen=True, eq=False)
class Matching:
    """All that the cascade found in an image."""

    base: Base
    levels: tuple[LevelMatches, ...]
    detections: Detections
    edgels_needed: float
    """theta."""
    seconds: dict[str, float] = field(default_factory=dict)
    """Processor time by stage, of all threads together."""
