"""A results file scored as the BOP Challenge does for 6D localization since 2019 (thesis sec. bop_accuracy_score).

The numbers are the benchmark's or there are none: whatever would leave out a target is an error.
"""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from pipeline.bop.columns import HERE, Columns, Execution, Progress
from pipeline.bop.dataset import Dataset
from pipeline.bop.results import Results
from pipeline.bop.scores import (
    MSPD_THETAS_PX,
    THETAS,
    FoundInstances,
    Scores,
    average_recalls,
    average_recalls_by,
    found,
)
from pipeline.bop.target_errors import TargetErrors, errors_of_targets
from pipeline.exceptions import FormatError, InputError
from pipeline.scene import Target

_PREFIX = "bop19_average_recall"


@dataclass(frozen=True, eq=False)
class Evaluation:
    """How well a method did on a dataset."""

    dataset: str
    method: str
    instances: FoundInstances
    """Every instance asked for, so that each score can be traced to what is behind it."""
    why_no_vsd: str
    """Why there is no VSD, and so no average recall over all three errors; empty where there is."""
    seconds: float
    """Spent on this evaluation."""

    @cached_property
    def scores(self) -> Scores:
        """Over all instances, each of the same weight."""
        return average_recalls(self.instances)

    @cached_property
    def per_object(self) -> dict[int, Scores]:
        """Over the instances of each object, by object id."""
        return average_recalls_by(self.instances, self.instances.obj_id)

    @cached_property
    def per_scene(self) -> dict[int, Scores]:
        """Over the instances of each scene, by scene id."""
        return average_recalls_by(self.instances, self.instances.scene_id)

    def as_dict(self) -> dict[str, Any]:
        """What goes into a JSON file; `targets` is the number of instances asked for.

        Only where a score is None there is one key more: `reasons`, with the reason by the score's name.
        """
        content = {
            "dataset": self.dataset,
            "method": self.method,
            "scores": _named(self.scores),
            "per_object": {str(obj_id): _named(of_object) for obj_id, of_object in self.per_object.items()},
            "targets": len(self.instances),
            "seconds": self.seconds,
        }
        missing = [name for name, value in _named(self.scores).items() if value is None]
        return content | ({"reasons": dict.fromkeys(missing, self.why_no_vsd)} if missing else {})


def evaluate(
    dataset: Dataset,
    results: Results,
    progress: Progress = lambda _: None,
    *,
    with_vsd: bool = True,
    execution: Execution = HERE,
) -> Evaluation:
    """Score results on the targets of a dataset; estimates for anything else do not count, as in BOP.

    VSD, which takes most of the time by far, is computed if all images with targets have depth.

    Raises:
        InputError: there are no targets, none has an estimate or one has no usable ground truth; a file is damaged.

    """
    begun = time.perf_counter()
    targets = tuple(target for target in dataset.targets() if target.inst_count > 0)
    check(dataset, results, targets)
    why_no_vsd = why_no_depth(dataset, targets) if with_vsd else "not asked for"
    compute = partial(localization_columns, with_vsd=not why_no_vsd)
    columns = execution.columns(compute, dataset, results, targets, progress)
    instances = FoundInstances(**columns)
    return Evaluation(dataset.name, results.method, instances, why_no_vsd, time.perf_counter() - begun)


def localization_columns(dataset: Dataset, results: Results, targets: Sequence[Target], with_vsd: bool) -> Columns:
    """The fields of `FoundInstances` for some targets, `vsd` only if asked for."""
    return _found_instances(errors_of_targets(dataset, results, targets, with_vsd))


def check(dataset: Dataset, results: Results, targets: Sequence[Target]) -> None:
    """Refuse what cannot be scored: damaged ground truth, no targets, results for something else."""
    where = f"{dataset.name}/{dataset.split}"
    for scene_id in dataset.scene_ids:
        for damage in dataset.scene_ground_truth(scene_id).damage.values():
            raise FormatError(damage)  # targets made from the ground truth would lack it
    if not targets:
        raise InputError(f"{where}: no targets and no ground truth to make them from; evaluate an annotated split")
    if len(results) and not any(len(results.rows(target.image, target.obj_id)) for target in targets):
        raise InputError(
            f"results of {results.method or 'the method'}: none of the {len(results)} estimates is for a target of "
            f"{where}; give the dataset and split that they are for"
        )


def why_no_depth(dataset: Dataset, targets: Sequence[Target]) -> str:
    """Name an image with targets and without depth; empty if there is none."""
    images = dict.fromkeys(target.image for target in targets)
    without = [key for key in images if dataset.depth_path(key) is None]
    if not without:
        return ""
    first = f"scene {without[0].scene_id}, image {without[0].im_id}"
    return f"no depth image for {len(without)} of {len(images)} images with targets (first: {first})"


def _found_instances(targets: Iterable[TargetErrors]) -> Columns:
    """Match the estimates of every target, whose errors may be forgotten then: a byte a threshold is kept."""
    ids: list[tuple[int, int, int, int]] = []
    fractions: list[float] = []
    mssd, mspd, vsd = [], [], []
    for errors in targets:
        for gt in errors.instances:
            ids.append((*errors.target[:3], gt.index))
            fractions.append(np.nan if gt.visible_fraction is None else gt.visible_fraction)
        mssd.append(found(errors.mssd, THETAS))
        mspd.append(found(errors.mspd, MSPD_THETAS_PX))
        if errors.vsd is not None:
            vsd.append(np.stack([found(at_tau, THETAS) for at_tau in errors.vsd], axis=1))
    columns = dict(zip(("scene_id", "im_id", "obj_id", "gt_index"), np.array(ids, dtype=np.int64).T, strict=True))
    columns |= {
        "visible_fraction": np.array(fractions, dtype=float),
        "mssd": np.concatenate(mssd),
        "mspd": np.concatenate(mspd),
    }
    return columns | ({"vsd": np.concatenate(vsd)} if vsd else {})


def _named(values: Scores) -> dict[str, float | None]:
    """The scores under the names of BOP's scripts."""
    return {
        _PREFIX: values.average,
        f"{_PREFIX}_vsd": values.vsd,
        f"{_PREFIX}_mssd": values.mssd,
        f"{_PREFIX}_mspd": values.mspd,
    }
