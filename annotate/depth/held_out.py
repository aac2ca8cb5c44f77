"""What a depth correction is worth on images that it was not fitted to, and whether another model does better."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from annotate.depth.fitting import fit
from annotate.depth.models import Kind
from annotate.depth.samples import DepthSamples

MOST_FOLDS = 20
LEAST_GAIN = 0.03
"""Share of the mean absolute difference by which another model must be better ..."""
CERTAIN = 2.0
"""... and so many standard errors of the gain by image."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """A model on corners that its fits have not seen."""

    kind: Kind
    residuals: Float[np.ndarray, "n"]
    """Corrected minus expected depth of each sample, by the fit to the other images; metres."""
    mean_abs: float
    """Metres."""
    gain: float
    """Metres by which its mean absolute difference is below that of the model it is compared with."""
    gain_std: float
    """Standard error of the gain, over images; infinite for a single image."""
    better: bool
    """Whether the gain is large and certain."""


def held_out(samples: DepthSamples, kinds: Sequence[Kind]) -> list[HeldOut]:
    """Residuals of models by leave-one-image-out, each compared with the first.

    With more than 20 images they are left out in 20 groups; with one, a fifth of its corners at a time.
    """
    folds = _folds(samples)
    found: list[HeldOut] = []
    for kind in kinds:
        residuals = np.full(len(samples), np.nan)
        for fold in np.unique(folds):
            rows = folds == fold
            fitted = fit(kind, samples.chosen(~rows)).correction
            residuals[rows] = fitted(samples.measured[rows], samples.pixels[rows]) - samples.expected[rows]
        found.append(_compared(kind, residuals, found[0] if found else None, samples.images))
    return found


def _folds(samples: DepthSamples) -> Int[np.ndarray, "n"]:
    images, rows = np.unique(samples.images, return_inverse=True)
    if len(images) == 1:
        return np.arange(len(samples)) % min(5, len(samples))
    return rows % MOST_FOLDS


def _compared(
    kind: Kind, residuals: Float[np.ndarray, "n"], first: HeldOut | None, images: Int[np.ndarray, "n"]
) -> HeldOut:
    mean_abs = float(np.abs(residuals).mean())
    if first is None:
        return HeldOut(kind, residuals, mean_abs, 0.0, 0.0, False)
    gains = np.abs(first.residuals) - np.abs(residuals)
    by_image = np.array([gains[images == image].mean() for image in np.unique(images)])
    std = float(by_image.std(ddof=1) / np.sqrt(len(by_image))) if len(by_image) > 1 else float("inf")
    gain = first.mean_abs - mean_abs
    better = gain > LEAST_GAIN * first.mean_abs and by_image.mean() > CERTAIN * std
    return HeldOut(kind, residuals, mean_abs, gain, std, bool(better))
