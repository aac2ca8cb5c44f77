"""From detections to estimates: in which order objects are refined, and which of the refined poses are instances."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool

from pipeline.hashmatch.detector import Detector, Matching
from pipeline.hashmatch.joint_choice import choose_jointly
from pipeline.hashmatch.proposals import Instance, propose, rough_instances
from pipeline.scene import Model

CONFIDENT = 0.45
"""Least score of a chosen pose whose pixels the next round leaves out."""

MOST_INSTANCES = 50
"""Of an object in an image, for detection."""

_CLAIMED = 0.4
"""A pose of which others explain such a share of the pixels is not another instance."""


def estimate_instances(
    detector: Detector,
    matching: Matching,
    models: Sequence[Model],
    counts: dict[int, int],
    keep_particles: bool = False,
) -> tuple[list[Instance], list[Instance]]:
    """Refine poses and choose instances, in rounds: (all refined ones, the chosen ones best first).

    What the chosen ones that fit well explain is left out in the next round, in which the objects still missing are
    sought again behind and beside it. In the end instances are chosen from all rounds together.

    Args:
        detector: That made the matching.
        matching: Of the image.
        models: Of the detector's objects.
        counts: By position of the object; for detection how many are sought at most does not matter.
        keep_particles: Hand back all that the swarms looked at.

    """
    config, base = detector.config, matching.base
    localize = config.task == "localization"
    most = {position: count if localize else MOST_INSTANCES for position, count in counts.items()}
    if not config.refine:
        return choose_rough(detector, matching, most)
    proposed: list[Instance] = []
    missing, taken = most, np.zeros(base.depth.shape, bool)
    for rescan in range(config.rescans + 1):
        if rescan:
            missing, taken = _what_is_missing(proposed, most, base.depth.shape)
            if not missing:
                break
            matching = detector.match(base.image, np.isin(np.arange(len(models)), list(missing)), taken)
        for position, count in missing.items():
            sought = count if localize else 2
            proposed += propose(detector, matching, position, models[position], sought, keep_particles, taken, rescan)
    chosen = _chosen(proposed, most)
    if localize:
        chosen += _fill(proposed, chosen, _left(most, chosen))
    else:
        chosen = [one for one in chosen if one.score >= config.least_fit]
    return proposed, sorted(chosen, key=lambda instance: -instance.score)


def choose_rough(
    detector: Detector, matching: Matching, most: Mapping[int, int]
) -> tuple[list[Instance], list[Instance]]:
    """Detections as they are, without refinement: (all that are kept, the best of each object)."""
    rough = [one for position in most for one in rough_instances(detector, matching, position)]
    return rough, _best_of_each(rough, most)


def _what_is_missing(
    proposed: Sequence[Instance], most: Mapping[int, int], shape: tuple[int, ...]
) -> tuple[dict[int, int], Bool[np.ndarray, "h w"]]:
    """Instances to look for again, by object, and the pixels that the sure ones explain."""
    sure = [one for one in _chosen(proposed, most) if one.score >= CONFIDENT]
    taken = np.zeros(shape, bool)
    for one in sure:
        taken.reshape(-1)[one.pixels] = True
    return _left(most, sure), taken


def _chosen(proposed: Sequence[Instance], most: Mapping[int, int]) -> list[Instance]:
    rows = choose_jointly([one.evidence for one in proposed], [one.position for one in proposed], most)
    return [proposed[row] for row in rows]


def _left(most: Mapping[int, int], chosen: Sequence[Instance]) -> dict[int, int]:
    """How many of each object are missing."""
    left = {position: count - sum(one.position == position for one in chosen) for position, count in most.items()}
    return {position: count for position, count in left.items() if count > 0}


def _fill(proposed: Sequence[Instance], chosen: Sequence[Instance], left: Mapping[int, int]) -> list[Instance]:
    """For the instances still missing, the best poses that do not explain again what is explained."""
    explained = {int(pixel) for one in chosen for pixel in one.pixels}
    missing, added = dict(left), []
    for one in sorted(proposed, key=lambda one: -one.evidence.net):
        if missing.get(one.position, 0) and len(one.pixels):
            pixels = set(one.pixels.tolist())
            if len(pixels & explained) <= _CLAIMED * len(pixels):
                explained |= pixels
                added.append(one)
                missing[one.position] -= 1
    return added


def _best_of_each(rough: Sequence[Instance], most: Mapping[int, int]) -> list[Instance]:
    left, chosen = dict(most), []
    for one in sorted(rough, key=lambda one: -one.score):
        if left[one.position]:
            chosen.append(one)
            left[one.position] -= 1
    return chosen
