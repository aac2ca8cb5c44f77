"""Robust least squares of depth corrections, and how far their coefficients can be trusted."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from annotate.depth.models import Correction, Kind, design
from annotate.depth.samples import DepthSamples

ROUNDS = 12
TUKEY = 4.685
"""Residuals of so many standard deviations weigh nothing (Tukey's biweight; 95 % efficient for normal noise)."""
LEAST_SCALE = 1e-6
"""Metres: exact data have no spread to scale residuals by."""
BOOTSTRAPS = 1000


@dataclass(frozen=True, eq=False)
class Fit:
    """A correction and what it was fitted with."""

    correction: Correction
    weights: Float[np.ndarray, "n"]
    """0 to 1, by sample; 0 for those that fit no other."""
    residuals: Float[np.ndarray, "n"]
    """Corrected minus expected depth, metres."""


@dataclass(frozen=True, eq=False)
class Confidence:
    """Standard deviations of the coefficients of a correction."""

    std: Float[np.ndarray, "k"] | None
    """With whole images as what varies independently, for the pose of an image is shared by its samples; None for
    fewer than three images."""
    bootstrap: Float[np.ndarray, "m k"] | None
    """The coefficients of fits to images drawn with repetition; None likewise."""

    def interval(self, coefficient: int, share: float = 0.95) -> tuple[float, float] | None:
        """Between which values a coefficient lies in this share of the bootstrap's fits."""
        if self.bootstrap is None:
            return None
        low, high = np.quantile(self.bootstrap[:, coefficient], [(1 - share) / 2, (1 + share) / 2]).tolist()
        return low, high


def fit(kind: Kind, samples: DepthSamples) -> Fit:
    """Fit a model to samples by iterated, robustly weighted least squares.

    Noise of the measured depth, which is on the right side of d_c = a d + b, would flatten the slope by the ratio of
    its variance to that of the depths. So the residuals are made orthogonal not to the measured but to the expected
    depth, which has none (an instrumental variable); residuals are those of the measurements all the same.
    """
    target, factors, instruments = _system(kind, samples)
    weights = np.ones(len(samples))
    coefficients = np.zeros(factors.shape[1])
    for _ in range(ROUNDS):
        weighted = instruments * weights[:, None]
        coefficients = np.linalg.pinv(weighted.T @ factors) @ (weighted.T @ target)
        updated = _tukey(factors @ coefficients - target)
        change = np.abs(updated - weights).max(initial=0.0)
        weights = updated
        if change < 1e-4:
            break
    correction = Correction(kind, coefficients, samples.image_size)
    return Fit(correction, weights, factors @ coefficients - target)


def confidence(samples: DepthSamples, found: Fit, seed: int = 0) -> Confidence:
    """Standard deviations of the coefficients, by the spread over images and by bootstrap over images."""
    images = np.unique(samples.images)
    if len(images) < 3:
        return Confidence(None, None)
    target, factors, instruments = _system(found.correction.kind, samples)
    weighted = instruments * found.weights[:, None]
    groups = [samples.images == image for image in images]
    matrices = np.stack([weighted[rows].T @ factors[rows] for rows in groups])
    sides = np.stack([weighted[rows].T @ target[rows] for rows in groups])
    scores = sides - matrices @ found.correction.coefficients
    inverse = np.linalg.pinv(matrices.sum(axis=0))
    covariance = inverse @ (scores.T @ scores) @ inverse.T * len(images) / (len(images) - 1)
    draws = np.random.default_rng(seed).multinomial(len(images), np.full(len(images), 1 / len(images)), BOOTSTRAPS)
    drawn = np.linalg.pinv(np.einsum("mg,gij->mij", draws, matrices))
    return Confidence(np.sqrt(np.diag(covariance)), np.einsum("mij,mj->mi", drawn, draws @ sides))


def _system(
    kind: Kind, samples: DepthSamples
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n k"], Float[np.ndarray, "n k"]]:
    """What is to be reached, the factors of the coefficients, and the instruments."""
    target = samples.expected - samples.measured if kind == "offset" else samples.expected
    factors = design(kind, samples.measured, samples.pixels, samples.image_size)
    return target, factors, design(kind, samples.expected, samples.pixels, samples.image_size)


def _tukey(residuals: Float[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
    scale = max(1.4826 * float(np.median(np.abs(residuals))), LEAST_SCALE)
    ratio = np.minimum(np.abs(residuals) / (TUKEY * scale), 1.0)
    return (1 - ratio**2) ** 2
