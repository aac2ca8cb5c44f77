"""Why a ground-truth instance was found or lost: its templates and windows followed through the cascade."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from pipeline.exceptions import UnknownIdError
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.detector import Detector, Matching
from pipeline.hashmatch.proposals import Instance
from pipeline.hashmatch.tracing.afterwards import DetectionsOf, RefinementOf, detections_of, refinement_of
from pipeline.hashmatch.tracing.following import Followed, follow, progress
from pipeline.hashmatch.tracing.verdicts import Stage, judged
from pipeline.hashmatch.verification import TESTS
from pipeline.scene import GroundTruth, Model


@dataclass(frozen=True)
class Trace:
    """What became of a ground-truth instance."""

    obj_id: int
    gt_index: int
    stage: Stage
    """Where it was lost, or "found"."""
    verdict: str
    """One sentence."""
    best: Followed | None
    """The followed template and window that came farthest."""
    followed: tuple[Followed, ...]
    edgels_needed: float
    """theta: more are needed."""
    detections: DetectionsOf
    refinement: RefinementOf
    colored: bool
    """Whether T5 is made for the object."""
    config: HashMatchConfig

    def as_dict(self) -> dict[str, Any]:
        """Plain numbers, strings, lists and dicts with these keys, for JSON; None for what does not apply.

        `template` (row, angle_deg, quaternion_xyzw of R_t), `window` (level, scale, u, v in pixels), `objectness` (edgels, needed, passed),
        `votes` (votes, needed, rank, kept_at_most, passed), `tests` (a list: test, name, fraction, needed, passed; T1
        has measured, nearest and farthest in metres instead of a fraction), `failed_test`, `detections` and
        `refinement` as the dataclasses of these names, and `followed`, a list of the first five for each template and
        window that was followed. Errors are MSSD as a share of the diameter.
        """
        followed = [self._as_dict(one) for one in self.followed]
        best: dict[str, Any] = self._as_dict(self.best) if self.best else dict.fromkeys(_KEYS)
        return {
            **best,
            "detections": asdict(self.detections),
            "refinement": asdict(self.refinement),
            "followed": followed,
        }

    def _as_dict(self, one: Followed) -> dict[str, Any]:
        config = self.config
        return {
            "template": {
                "row": one.template, "angle_deg": round(one.angle_deg, 2), "quaternion_xyzw": one.quaternion_xyzw,
            },
            "window": {"level": one.level, "scale": one.scale, "u": one.window[0], "v": one.window[1]},
            "objectness": {"edgels": one.edgels, "needed": self.edgels_needed, "passed": one.objectness},
            "size_possible": one.size_possible,
            "votes": {
                "votes": one.votes, "needed": config.votes_needed, "rank": one.rank,
                "kept_at_most": config.votes_kept, "passed": one.kept,
            },
            "tests": [self._test(one, number) for number in range(1, 6)],
            "failed_test": one.failed_test,
        }  # fmt: skip

    def _test(self, one: Followed, number: int) -> dict[str, Any]:
        named: dict[str, Any] = {"test": number, "name": TESTS[number - 1]}
        if number == 1:
            return {**named, **one.size._asdict(), "passed": one.size.passed}
        if number == 5 and not self.colored:
            return {**named, "fraction": None, "needed": None, "passed": None}
        fraction, needed = one.fractions[number - 2], self.config.matches_needed
        return {**named, "fraction": fraction, "needed": needed, "passed": fraction >= needed}


_KEYS = ("template", "window", "objectness", "size_possible", "votes", "tests", "failed_test")


def trace(
    detector: Detector,
    matching: Matching,
    gt: GroundTruth,
    model: Model,
    proposed: Sequence[Instance] = (),
    chosen: Sequence[Instance] = (),
) -> Trace:
    """Follow a ground-truth instance through a matching of its image.

    Args:
        detector: That made the matching.
        matching: Of the image that the ground truth is of.
        gt: The instance.
        model: Of its object, with its symmetries.
        proposed: Refined poses before the choice.
        chosen: Those that became estimates.

    Raises:
        UnknownIdError: the detector has no templates of the object.

    """
    ids = [own.obj_id for own in detector.objects]
    if gt.obj_id not in ids:
        raise UnknownIdError("object", gt.obj_id, "the templates of this run", ids)
    position = ids.index(gt.obj_id)
    followed = follow(detector, matching, gt, model, position)
    best = max(followed, key=progress, default=None)
    detections = detections_of(detector, matching, gt, model, position)
    refinement = refinement_of(proposed, chosen, gt, model, position)
    needed, config = matching.edgels_needed, detector.config
    stage, verdict = judged(f"object {gt.obj_id}", followed, detections, refinement, needed, config)
    colored = detector.objects[position].colored
    return Trace(
        gt.obj_id, gt.index, stage, verdict, best, tuple(followed), needed, detections, refinement, colored, config
    )
