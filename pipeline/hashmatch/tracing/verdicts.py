"""Where an instance was lost, and one sentence about it."""

from collections.abc import Sequence
from typing import Literal, NamedTuple, get_args

from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.tracing.afterwards import FOUND, DetectionsOf, RefinementOf
from pipeline.hashmatch.tracing.following import Followed, progress
from pipeline.hashmatch.verification import TESTS

Stage = Literal[
    "pyramid", "template", "objectness", "size", "hashing", "verification", "suppression", "refinement", "selection",
    "found",
]  # fmt: skip
"""Where an instance was lost, in the order of the method."""

STAGES: tuple[Stage, ...] = get_args(Stage)

_FAR = 0.1
"""An instance that was found with a larger error (MSSD, share of the diameter) is said to be off."""


class Verdict(NamedTuple):
    """Where an instance was lost."""

    stage: Stage
    sentence: str


def judged(
    name: str,
    followed: Sequence[Followed],
    detections: DetectionsOf,
    refinement: RefinementOf,
    edgels_needed: float,
    config: HashMatchConfig,
) -> Verdict:
    """Where an instance was lost.

    What came farther counts first: an estimate, then refined poses, then detections, then the templates and windows
    about the ground truth.

    Args:
        name: What the sentence calls the instance.
        followed: The templates nearest to it at the windows about it.
        detections: Of the instance.
        refinement: Of the instance.
        edgels_needed: theta.
        config: With which the image was matched.

    """
    if refinement.chosen_error is not None and refinement.chosen_error < FOUND:
        off = ", so its pose is off" if refinement.chosen_error > _FAR else ""
        return Verdict("found", f"{name} was found (MSSD {refinement.chosen_error:.2f} d{off}).")
    if detections.count:
        return _lost_late(name, detections, refinement, config.refine)
    if not followed:
        return Verdict("pyramid", f"{name}: no level of the pyramid and window fit its distance and place.")
    nearest = min(one.angle_deg for one in followed)
    if nearest > near_enough_deg(config):
        return Verdict("template", f"{name}: the nearest template is {nearest:.0f} degrees off; use all views.")
    return _lost_early(name, max(followed, key=progress), detections, edgels_needed, config)


def near_enough_deg(config: HashMatchConfig) -> float:
    """Angle within which templates have to be; those of a whole grid of three angles are nearer."""
    return 1.5 * config.angle_step_deg


def _lost_early(
    name: str, best: Followed, detections: DetectionsOf, edgels_needed: float, config: HashMatchConfig
) -> Verdict:
    """The verdict on an instance that was not detected, although there is a template."""
    if not best.objectness:
        sentence = f"{name}: its window holds {best.edgels} depth edgels, more than {edgels_needed:.0f} are needed."
        return Verdict("objectness", sentence)
    if not best.size_possible:
        return Verdict("size", f"{name}: no template of it fits the size of its window: {_measured(best)}.")
    if not best.kept:
        return Verdict("hashing", f"{name}: its template got {_votes(best, config)}.")
    if best.failed_test == 1:
        return Verdict("verification", f"{name}: its template failed {TESTS[0]}: {_measured(best)}.")
    if best.failed_test:
        share, test = best.fractions[best.failed_test - 2], TESTS[best.failed_test - 1]
        missing = f"{share:.2f} of {config.matches_needed:.2f} needed"
        return Verdict("verification", f"{name}: its template failed {test}: {missing}.")
    off = "" if detections.nearest_error is None else f" (at best MSSD {detections.nearest_error:.2f} d)"
    return Verdict("verification", f"{name}: templates near it passed all tests, but only with poses too far off{off}.")


def _lost_late(name: str, detections: DetectionsOf, refinement: RefinementOf, refines: bool) -> Verdict:
    """The verdict on an instance that was detected, but is not among the estimates."""
    if not refines:
        rank = f"its best detection has rank {detections.rank}"
        if detections.suppressed_by is not None:
            by = detections.suppressed_by.detection
            return Verdict("suppression", f"{name}: {rank} and was suppressed by detection {by}.")
        return Verdict("selection", f"{name}: {rank}, and as many as were sought have better scores.")
    if refinement.refined_error is not None and refinement.refined_error < FOUND:
        sentence = f"{name} was detected and refined, but other poses explained its pixels with a better score."
        return Verdict("selection", sentence)
    if refinement.rough_error is not None and refinement.rough_error < FOUND:
        moved = f"from MSSD {refinement.rough_error:.2f} d to {refinement.moved_error:.2f} d"
        return Verdict("refinement", f"{name}: refinement moved its rough pose away, {moved}.")
    text = f"{detections.count} detections are of it, the best one with rank {detections.rank}"
    if detections.followed_up:
        return Verdict("selection", f"{name}: {text}; other poses fitted the depth image better before refinement.")
    return Verdict("selection", f"{name}: {text}; with so many at its place none was refined.")


def _measured(best: Followed) -> str:
    size = best.size
    measured = f"{size.measured:.3f} m is measured" if size.measured > 0 else "nothing is measured there"
    return f"{measured}, {size.nearest:.3f} to {size.farthest:.3f} m would fit"


def _votes(best: Followed, config: HashMatchConfig) -> str:
    if not best.votes:
        return "no vote at its window"
    if best.votes < config.votes_needed:
        return f"{best.votes} vote{'' if best.votes == 1 else 's'} at its window, {config.votes_needed} are needed"
    return f"{best.votes} votes at its window, rank {best.rank}; the first {config.votes_kept} pass"
