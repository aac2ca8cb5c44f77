"""Which annotations may be wrong: measures that are unusual for the object and large in themselves."""

from collections import defaultdict
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from annotate.quality.depth_difference import DepthStatistics
from annotate.quality.report import InstanceQuality, Suspect

FEWEST_PIXELS = 100
"""Measured pixels from which depth says something of a pose."""
MOST_HIDDEN = 0.5
"""Share measured before the object beyond which that is taken to be something else, and depth says nothing ..."""
COHERENT = 0.006
"""... unless most differences are no outliers and spread by less than so many metres: then it is the object, displaced."""
UNUSUAL = 4.0
"""Robust standard deviations from the median of the object's instances."""
LEAST = {"behind": 0.15, "median_abs": 0.010, "bias": 0.005, "contour": 3.0, "disagreement": 0.003}
"""Shares, metres and pixels that are no reason for suspicion, however unusual."""
WRONG = 3.0
"""Severity, at least, of what other images and the measurements both contradict."""


class Measure(NamedTuple):
    """One measure of one instance; large is bad."""

    name: str
    value: float
    text: str
    """The reason that it gives if it is too large."""


def suspects(instances: Sequence[InstanceQuality]) -> list[Suspect]:
    """Instances with a measure beyond its limit, worst first.

    The limit is the larger of a fixed one and what is usual for the object: median plus 4 robust standard deviations.
    A bias that all instances of a split have is the sensor's: only what goes beyond it counts (see `common_bias`).
    """
    common = common_bias(instances)
    measures = [list(_measures(one, common)) for one in instances]
    limits = _limits(instances, measures)
    found = []
    for one, own in zip(instances, measures, strict=True):
        rated = [(m.value / limits[one.obj_id, m.name], m.text) for m in own]
        rated = sorted([(rate, text) for rate, text in [*rated, *_contradictions(one)] if rate >= 1], reverse=True)
        if rated:
            reasons = tuple(text for _, text in rated)
            found.append(Suspect(one.key, one.index, one.obj_id, float(rated[0][0]), reasons))
    return sorted(found, key=lambda suspect: (-suspect.severity, suspect.key, suspect.index))


def common_bias(instances: Sequence[InstanceQuality]) -> float:
    """Metres by which the surfaces of a split are measured behind their poses, as a rule (median over instances)."""
    biases = [one.depth.surface_bias for one in instances if one.depth and one.depth.pixels >= FEWEST_PIXELS]
    return float(np.nan_to_num(np.nanmedian(biases))) if np.isfinite(biases).any() else 0.0


def _measures(one: InstanceQuality, common: float) -> Iterator[Measure]:
    contour, agreement = one.contour, one.agreement
    if one.depth and one.depth.pixels >= FEWEST_PIXELS:
        yield from _depth_measures(one.depth, common)
    if contour:
        shift = contour.shift
        move = f"; ({shift.x:+.1f}, {shift.y:+.1f}) px would fit" if shift and shift.length > 1 else ""
        yield Measure("contour", contour.median, f"its contour is {contour.median:.1f} px from edges{move}")
    if agreement and agreement.verdict == "agrees" and np.isfinite(agreement.distance):
        text = f"{_mm(agreement.distance)} from where {_images(agreement.images)} it"
        yield Measure("disagreement", agreement.distance, text)


def _depth_measures(depth: DepthStatistics, common: float) -> Iterator[Measure]:
    """None where something unknown seems to stand before the object."""
    if depth.before > MOST_HIDDEN and not (depth.std < COHERENT and depth.outliers < MOST_HIDDEN):
        return
    yield Measure("behind", depth.behind, f"{depth.behind:.0%} of it is measured more than 20 mm behind it")
    if np.isfinite(depth.median_abs):
        beyond = min(depth.median_abs, abs(depth.mean - common) + depth.std)
        yield Measure("median_abs", beyond, f"measured depth is {_mm(depth.median_abs)} off (median)")
    if depth.before + depth.behind < MOST_HIDDEN and np.isfinite(depth.surface_bias):
        extra = depth.surface_bias - common
        text = f"its surface is measured {_mm(abs(extra))} {'behind' if extra > 0 else 'before'} it"
        yield Measure("bias", abs(extra), f"{text}, beyond what all instances have" if common else text)


def _contradictions(one: InstanceQuality) -> Iterator[tuple[float, str]]:
    agreement = one.agreement
    if agreement and agreement.verdict == "wrong":
        text = f"{_mm(agreement.distance)} from where other images have it, and this image bears them out"
        yield max(WRONG, agreement.distance / LEAST["disagreement"]), text
    elif agreement and agreement.verdict == "alone" and np.isfinite(agreement.distance):
        yield 1.0, f"no other image has it here, the nearest {_mm(agreement.distance)} away; moved or wrong"


def _limits(
    instances: Sequence[InstanceQuality], measures: Sequence[Sequence[Measure]]
) -> dict[tuple[int, str], float]:
    values: dict[tuple[int, str], list[float]] = defaultdict(list)
    for one, own in zip(instances, measures, strict=True):
        for measure in own:
            values[one.obj_id, measure.name].append(measure.value)
    return {(obj_id, name): max(LEAST[name], _usual(found)) for (obj_id, name), found in values.items()}


def _usual(values: Sequence[float]) -> float:
    """What most values stay below; of fewer than four nothing is known."""
    if len(values) < 4:
        return 0.0
    middle = np.median(values)
    return float(middle + UNUSUAL * 1.4826 * np.median(np.abs(np.array(values) - middle)))


def _mm(metres: float) -> str:
    return f"{1000 * metres:.1f} mm"


def _images(count: int) -> str:
    return "another image has" if count == 1 else f"{count} other images have"
