"""Estimating the depth correction of a sensor, d_c = a d + b (thesis sec. tless_depth_correction)."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from annotate.depth.fitting import Confidence, Fit, confidence, fit
from annotate.depth.held_out import HeldOut, held_out
from annotate.depth.models import KINDS, TEXTS, Kind
from annotate.depth.samples import DepthSamples
from pipeline.exceptions import InputError

LEAST_SPREAD = 0.02
"""Metres between the 5th and 95th percentile of depth below which a and b cannot be told apart ..."""
MOST_STD_A = 0.02
"""... or if the factor is so uncertain."""
FEWEST_SAMPLES = 10


@dataclass(frozen=True, eq=False)
class DepthEstimate:
    """A depth correction and all that is to be known about it; the arrays are there to be plotted."""

    samples: DepthSamples
    """In the range that was asked for."""
    fit: Fit
    """Of the model that was chosen: linear, or an offset where no more can be told."""
    confidence: Confidence
    before: float
    """Mean absolute difference of measured and expected depth, metres."""
    held_out: HeldOut
    """The chosen model on images that it was not fitted to: its `mean_abs` is the difference after correction."""
    others: tuple[HeldOut, ...]
    """Other models, fitted and held out likewise."""
    notes: tuple[str, ...]

    @property
    def a(self) -> float:
        """Factor of the measured depth."""
        return self.fit.correction.a

    @property
    def b(self) -> float:
        """Metres."""
        return self.fit.correction.b

    @property
    def offered(self) -> tuple[HeldOut, ...]:
        """Models that are better on held-out samples, with certainty; best first."""
        return tuple(sorted((one for one in self.others if one.better), key=lambda one: one.mean_abs))

    def as_dict(self) -> dict[str, Any]:
        """For JSON, metres; without the arrays."""
        kind = self.fit.correction.kind
        return {
            "unit": "m",
            "model": TEXTS[kind],
            "a": self.a,
            "b": self.b,
            **_uncertainty(kind, self.confidence),
            "samples": len(self.samples),
            "images": len(np.unique(self.samples.images)),
            "depth_range": [float(self.samples.expected.min()), float(self.samples.expected.max())],
            "mean_abs_before": self.before,
            "mean_abs_after_held_out": self.held_out.mean_abs,
            "other_models": [
                {"model": TEXTS[one.kind], "mean_abs_held_out": one.mean_abs, "better": one.better}
                for one in self.others
            ],
            "notes": list(self.notes),
        }


def _uncertainty(kind: Kind, found: Confidence) -> dict[str, Any]:
    if found.std is None:
        return {"std_a": None, "std_b": None, "interval_a": None, "interval_b": None}
    at_b = 0 if kind == "offset" else 1
    return {
        "std_a": None if kind == "offset" else float(found.std[0]),
        "std_b": float(found.std[at_b]),
        "interval_a": None if kind == "offset" else found.interval(0),
        "interval_b": found.interval(at_b),
    }


def estimate(
    samples: DepthSamples, near: float = 0.0, far: float = float("inf"), notes: tuple[str, ...] = ()
) -> DepthEstimate:
    """Fit the linear correction to samples whose expected depth lies in a range of metres (0.53 to 0.92 in the thesis).

    Where all samples are at one depth, a and b cannot be told apart: a note says so and the offset alone is fitted.
    Raises InputError if too few samples are in the range.
    """
    usable = samples.within(near, far)
    if len(usable) < FEWEST_SAMPLES:
        depths = f"{samples.expected.min():.3g} to {samples.expected.max():.3g} m" if len(samples) else "none"
        raise InputError(
            f"depth correction: {len(usable)} of {len(samples)} samples lie from {near:g} to {far:g} m (they are at"
            f" {depths}); at least {FEWEST_SAMPLES} are needed, so widen the range"
        )
    kind, told = _what_can_be_told(usable)
    found = fit(kind, usable)
    kinds: list[Kind] = [kind, *([] if kind == "offset" else [other for other in KINDS if other != kind])]
    first, *others = held_out(usable, kinds)
    notes = (*notes, *told, *_few_images(usable))
    before = float(np.abs(usable.differences).mean())
    return DepthEstimate(usable, found, confidence(usable, found), before, first, tuple(others), notes)


def _what_can_be_told(samples: DepthSamples) -> tuple[Kind, tuple[str, ...]]:
    low, high = np.percentile(samples.expected, [5, 95]).tolist()
    if high - low < LEAST_SPREAD:
        text = f"all samples lie at one depth ({low:.3f} to {high:.3f} m)"
    else:
        std = confidence(samples, fit("linear", samples)).std
        if std is None or std[0] < MOST_STD_A:
            return "linear", ()
        text = f"the factor a would be uncertain by {std[0]:.3f}"
    return "offset", (
        f"{text}: a and b cannot be told apart, the offset alone is fitted; add nearer and farther images",
    )


def _few_images(samples: DepthSamples) -> tuple[str, ...]:
    count = len(np.unique(samples.images))
    if count >= 3:
        return ()
    held = "corners of it are held out in turn" if count == 1 else "one is held out at a time"
    return (f"{count} image{'' if count == 1 else 's'} only: {held}, and how sure a and b are cannot be told",)
