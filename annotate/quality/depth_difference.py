"""Measured minus rendered depth of annotated objects: the statistics of the thesis's table (sec. tless_gt_eval).

Statistics are kept as counts and sums with a histogram, so that those of many images add up exactly; a median comes
from the histogram and is right to 0.01 mm where there are many pixels.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import reduce

import numpy as np
from jaxtyping import Float, Int64

OUTLIER = 0.05
"""Metres: differences beyond are pruned (thesis sec. tless_gt_eval)."""
SURFACE = 0.02
"""Metres within which a measurement is taken to be of the object itself, not of what stands before or behind it."""
BINS = 2000
BIN = 2 * OUTLIER / BINS
"""Metres."""


@dataclass(frozen=True, eq=False)
class DepthDifferences:
    """Differences of measured and rendered depth (metres) at the pixels that have both; add up with `+`."""

    pixels: int = 0
    """All, outliers too."""
    before: int = 0
    """Pixels measured more than SURFACE nearer than rendered: something may stand before the object."""
    behind: int = 0
    """Pixels measured more than SURFACE farther than rendered: there the object is not, whatever stands before it."""
    total: float = 0.0
    """Sum of the differences that are no outliers; likewise the next two."""
    total_squares: float = 0.0
    total_abs: float = 0.0
    histogram: Int64[np.ndarray, "b"] = field(default_factory=lambda: np.zeros(BINS, np.int64))
    """Of the differences that are no outliers, in BINS bins of BIN metres from -OUTLIER."""

    @staticmethod
    def of(differences: Float[np.ndarray, "n"]) -> "DepthDifferences":
        """Those of the pixels of one instance, metres."""
        kept = differences[np.abs(differences) <= OUTLIER].astype(np.float64)
        bins = np.minimum(((kept + OUTLIER) / BIN).astype(np.int64), BINS - 1)
        return DepthDifferences(
            len(differences),
            int((differences < -SURFACE).sum()),
            int((differences > SURFACE).sum()),
            float(kept.sum()),
            float((kept**2).sum()),
            float(np.abs(kept).sum()),
            np.bincount(bins, minlength=BINS),
        )

    def __add__(self, other: "DepthDifferences") -> "DepthDifferences":
        """Those of both."""
        return DepthDifferences(
            self.pixels + other.pixels,
            self.before + other.before,
            self.behind + other.behind,
            self.total + other.total,
            self.total_squares + other.total_squares,
            self.total_abs + other.total_abs,
            self.histogram + other.histogram,
        )

    def statistics(self) -> "DepthStatistics":
        """The columns of the table."""
        count = int(self.histogram.sum())
        if not count:
            nan = float("nan")
            outliers = 1.0 if self.pixels else nan
            shares = (self.before / self.pixels, self.behind / self.pixels) if self.pixels else (nan, nan)
            return DepthStatistics(self.pixels, outliers, *shares, nan, nan, nan, nan, nan, nan)
        mean = self.total / count
        surface = self.histogram.copy()
        surface[np.abs(_CENTRES) > SURFACE] = 0
        return DepthStatistics(
            pixels=self.pixels,
            outliers=1.0 - count / self.pixels,
            before=self.before / self.pixels,
            behind=self.behind / self.pixels,
            mean=mean,
            std=float(np.sqrt(max(self.total_squares / count - mean**2, 0.0))),
            mean_abs=self.total_abs / count,
            median_abs=_median(_folded(self.histogram)),
            surface_bias=_median(surface) - OUTLIER,
            surface_median_abs=_median(_folded(surface)),
        )


@dataclass(frozen=True)
class DepthStatistics:
    """How far the measured depth is from the rendered one; metres, NaN where no pixel can tell."""

    pixels: int
    """Pixels of the object, as the nearest of the annotated ones, whose depth was measured."""
    outliers: float
    """Share of the differences beyond 5 cm; pruned in `mean` to `median_abs`."""
    before: float
    """Share of the pixels measured more than 2 cm nearer than rendered."""
    behind: float
    """Share of the pixels measured more than 2 cm farther than rendered."""
    mean: float
    """mu_delta of the thesis: positive where the surface is measured behind the rendered one."""
    std: float
    """sigma_delta."""
    mean_abs: float
    """mu_|delta|."""
    median_abs: float
    """med_|delta|."""
    surface_bias: float
    """Median of the differences within 2 cm: those of the object itself, without what stands before or behind it."""
    surface_median_abs: float
    """Median of the absolute differences within 2 cm."""


def pooled(parts: Iterable[DepthDifferences]) -> DepthDifferences:
    """The differences of all parts together."""
    return reduce(lambda one, other: one + other, parts, DepthDifferences())


_CENTRES = -OUTLIER + BIN * (np.arange(BINS) + 0.5)


def _folded(histogram: Int64[np.ndarray, "b"]) -> Int64[np.ndarray, "b/2"]:
    """Histogram of the absolute values."""
    return histogram[BINS // 2 :] + histogram[BINS // 2 - 1 :: -1]


def _median(histogram: Int64[np.ndarray, "b"]) -> float:
    """Median of values that begin at 0, taken to be even in each bin; NaN where there is none."""
    ends = np.cumsum(histogram)
    if not ends[-1]:
        return float("nan")
    half = ends[-1] / 2
    place = int(np.searchsorted(ends, half))
    return float(BIN * (place + 1 - (ends[place] - half) / histogram[place]))
