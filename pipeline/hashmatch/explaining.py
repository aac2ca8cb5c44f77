"""Why HashMatch found or lost an instance: its trace, as `pipeline.explaining` wants it."""

from collections.abc import Iterator, Sequence
from functools import partial

from pipeline.explaining import Evidence, Explain, Explanation
from pipeline.hashmatch.detector import Detector
from pipeline.hashmatch.estimator import Found, HashMatchEstimator
from pipeline.hashmatch.trace import Trace, trace
from pipeline.hashmatch.tracing.afterwards import FOUND
from pipeline.hashmatch.tracing.following import Followed
from pipeline.hashmatch.tracing.verdicts import near_enough_deg
from pipeline.hashmatch.verification import TESTS
from pipeline.recording import StageRecorder
from pipeline.scene import GroundTruth, Image, Model, PoseEstimate, Target


def explained(
    estimator: HashMatchEstimator, image: Image, targets: Sequence[Target], recorder: StageRecorder
) -> tuple[list[PoseEstimate], Explain]:
    """Estimate, and get a function that explains an instance. Raises as `HashMatchEstimator.estimate`."""
    estimates, found = estimator.found(image, targets, recorder)
    return estimates, partial(explanation, estimator.detector, found)


def explanation(detector: Detector, found: Found, truth: GroundTruth, model: Model) -> Explanation:
    """What became of an instance. Raises UnknownIdError for an object that was not learned."""
    traced = trace(detector, found.matching, truth, model, found.proposed, found.chosen)
    seen = [] if truth.visible_fraction is None else [Evidence("visible fraction", truth.visible_fraction)]
    evidence = (*seen, *_evidence(traced))
    return Explanation(truth.index, truth.obj_id, traced.stage, traced.verdict, evidence, traced.as_dict())


def _evidence(traced: Trace) -> Iterator[Evidence]:
    """The numbers of a trace, in the order of the stages."""
    best, config = traced.best, traced.config
    if best is not None:
        near = near_enough_deg(config)
        yield Evidence("angle to the template", best.angle_deg, near, "deg", best.angle_deg <= near)
        yield Evidence("depth edgels", best.edgels, traced.edgels_needed, "", best.objectness)
        yield Evidence("votes", best.votes, config.votes_needed, "", best.votes >= config.votes_needed)
        yield Evidence("rank by votes", best.rank, config.votes_kept, "", best.kept)
        yield from _tests(traced, best)
    yield Evidence("detections", traced.detections.count, 1, "", traced.detections.count > 0)
    if traced.detections.rank is not None:
        yield Evidence("best rank among detections", traced.detections.rank)
    yield from _errors(traced)


def _tests(traced: Trace, best: Followed) -> Iterator[Evidence]:
    size, needed = best.size, traced.config.matches_needed
    limit = size.nearest if size.measured < size.nearest else size.farthest
    yield Evidence(TESTS[0], size.measured, limit, "m", size.passed)
    tests = TESTS[1:] if traced.colored else TESTS[1:-1]
    for name, fraction in zip(tests, best.fractions, strict=False):
        yield Evidence(name, fraction, needed, "of the points", fraction >= needed)


def _errors(traced: Trace) -> Iterator[Evidence]:
    refinement = traced.refinement
    errors = {
        "error of the nearest detection": traced.detections.nearest_error,
        "error before refinement": refinement.rough_error,
        "error of that pose after refinement": refinement.moved_error,
        "error of the nearest refined pose": refinement.refined_error,
        "error of the nearest estimate": refinement.chosen_error,
    }
    for name, error in errors.items():
        if error is not None:
            yield Evidence(name, error, FOUND, "diameters", error < FOUND)
