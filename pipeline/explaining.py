"""Why a method found or lost an annotated instance: what it says, how that is recorded, and read back.

A method that can say so is a row in `EXPLAINERS`: beside its estimator there is a module with a function

    explained(estimator, image, targets, recorder) -> tuple[list[PoseEstimate], Explain]

which estimates as the estimator does, and hands back a function that explains one annotated instance. So no method sees
ground truth before its estimates are made, and estimators know nothing of explaining.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from importlib import import_module
from typing import Any, NamedTuple

import numpy as np

from pipeline.estimator import Estimator
from pipeline.exceptions import InputError
from pipeline.recording import RecordingReader, StageRecorder, Text
from pipeline.scene import GroundTruth, Image, Model, PoseEstimate, Target

EXPLAINERS = {
    ("pipeline.hashmatch.estimator", "HashMatchEstimator"): "pipeline.hashmatch.explaining",
}
"""Module that explains, by module and name of the estimator's class."""


class Evidence(NamedTuple):
    """A number that a verdict rests on."""

    name: str
    value: float
    limit: float | None = None
    """What it was compared with."""
    unit: str = ""
    passed: bool | None = None
    """Whether the value is on the right side of the limit; None where nothing hangs on it."""


@dataclass(frozen=True)
class Explanation:
    """Why an annotated instance was found or lost."""

    gt_index: int
    obj_id: int
    stage: str
    """Of the method, where it was lost; "found" where it was not."""
    verdict: str
    """One sentence."""
    evidence: tuple[Evidence, ...] = ()
    details: Mapping[str, Any] = field(default_factory=dict)
    """What else the method says, as JSON can hold it."""

    def as_dict(self) -> dict[str, Any]:
        """For JSON: `gt_index`, `obj_id`, `stage`, `verdict`, `evidence` (name, value, limit, unit, passed), and `details`."""
        return {**asdict(self), "evidence": [one._asdict() for one in self.evidence]}


Explain = Callable[[GroundTruth, Model], Explanation]
"""Explains an instance of the image that was estimated; the model is that of evaluation, with its symmetries."""


def can_explain(estimator: Estimator) -> bool:
    """Whether a method can say why it found or lost an instance."""
    return _explainer(estimator) in EXPLAINERS


def explained(
    estimator: Estimator, image: Image, targets: Sequence[Target], recorder: StageRecorder
) -> tuple[list[PoseEstimate], Explain | None]:
    """Estimate, and get a function that explains; None where the method has none. Raises as `Estimator.estimate`."""
    if not can_explain(estimator):
        return estimator.estimate(image, targets, recorder), None
    return import_module(EXPLAINERS[_explainer(estimator)]).explained(estimator, image, targets, recorder)


def explain_targets(
    explain: Explain,
    truths: Sequence[GroundTruth],
    targets: Sequence[Target],
    model_of: Callable[[int], Model],
    recorder: StageRecorder,
) -> list[Explanation]:
    """Explain the annotated instances of the targets' objects and record what is said; what cannot be is logged."""
    sought, found = {target.obj_id for target in targets}, []
    for truth in truths:
        if truth.obj_id not in sought:
            continue
        try:
            found.append(explain(truth, model_of(truth.obj_id)))
        except InputError as error:  # the estimates stand
            recorder.text("log", f"instance {truth.index} is not explained: {error}", level="WARN")
        else:
            record_explanation(recorder, found[-1])
    return found


def record_explanation(recorder: StageRecorder, explanation: Explanation) -> None:
    """Record an explanation under `diagnosis/`."""
    path, evidence = f"diagnosis/{explanation.gt_index}", explanation.evidence
    recorder.text(f"{path}/verdict", explanation.verdict)
    recorder.text(f"{path}/details", json.dumps(explanation.as_dict(), default=_plain))
    recorder.table(path, {
        "name": np.array([one.name for one in evidence], str),
        "value": np.array([one.value for one in evidence], float),
        "limit": np.array([np.nan if one.limit is None else one.limit for one in evidence], float),
        "unit": np.array([one.unit for one in evidence], str),
        "passed": np.array([-1 if one.passed is None else one.passed for one in evidence], np.int8),
    })  # fmt: skip


def recorded_explanations(reader: RecordingReader) -> dict[int, Explanation]:
    """What a recording says about the annotated instances, by index in the annotation. Raises as `RecordingReader.read`."""
    found: dict[int, Explanation] = {}
    for path in reader.paths("diagnosis/*/details"):
        values = json.loads(reader.read(path, Text).text)
        evidence = tuple(Evidence(**one) for one in values.pop("evidence"))
        found[values["gt_index"]] = Explanation(**values, evidence=evidence)
    return found


def _explainer(estimator: Estimator) -> tuple[str, str]:
    kind = type(estimator)
    return kind.__module__, kind.__qualname__


def _plain(value: Any) -> Any:
    """NumPy scalars as Python numbers, for JSON."""
    if isinstance(value, np.generic):
        return value.item()
    raise TypeError(f"JSON cannot hold a {type(value).__name__}")
