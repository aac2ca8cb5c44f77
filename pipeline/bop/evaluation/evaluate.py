"""A results file scored as the BOP Challenge does for 6D localization since 2019 (thesis sec. bop_accuracy_score).

The numbers are the benchmark's or there are none: whatever would leave out a target is an error.
"""

import time
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np

from pipeline.bop.dataset import Dataset
from pipeline.bop.evaluation.average_distance import THETA, AdRecalls, ad_recalls
from pipeline.bop.evaluation.columns import HERE, Columns, Execution, Progress
from pipeline.bop.evaluation.scorable import check, why_no_depth
from pipeline.bop.evaluation.scores import (
    MSPD_THETAS_PX,
    THETAS,
    FoundInstances,
    Scores,
    average_recalls,
    average_recalls_by,
    found,
)
from pipeline.bop.evaluation.summary import Summary, counts, time_per_image
from pipeline.bop.evaluation.target_errors import TargetErrors, errors_of_targets
from pipeline.bop.results import Results
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
    split: str = ""
    time_per_image: float | None = None
    """Mean seconds that the method took for an image; None where it does not tell."""
    incomplete: str = ""
    """What is missing of the instances of the BOP Challenge; empty where all are here."""
    notes: tuple[str, ...] = ()
    """What is to be known beside the numbers, one line each."""

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

    @cached_property
    def ad(self) -> AdRecalls | None:
        """Recalls by the average distance; None where it was not asked for."""
        found_at = self.instances.ad
        return None if found_at is None else ad_recalls(found_at, self.instances.obj_id)

    @cached_property
    def summary(self) -> Summary:
        """The scores under the names of BOP's scripts; `targets` is the number of instances asked for."""
        scores = _named(self.scores)
        missing = [name for name, value in scores.items() if value is None]
        per_object: dict[int, dict[str, float | None]] = {i: _named(s) for i, s in self.per_object.items()}
        if self.ad is not None:
            scores |= {"ad_recall": self.ad.recall, "ad_mean_object_recall": self.ad.mean_over_objects}
            per_object = {i: named | {"ad_recall": self.ad.per_object[i]} for i, named in per_object.items()}
        return Summary(
            dataset=self.dataset,
            split=self.split,
            task="localization",
            method=self.method,
            scores=scores,
            per_object=per_object,
            per_scene={scene_id: _named(of_scene) for scene_id, of_scene in self.per_scene.items()},
            targets=len(self.instances),
            targets_per_object=counts(self.instances.obj_id),
            seconds=self.seconds,
            time_per_image=self.time_per_image,
            reasons=dict.fromkeys(missing, self.why_no_vsd),
            incomplete=self.incomplete,
            notes=self.notes,
        )

    def as_dict(self) -> dict[str, Any]:
        """What goes into a JSON file (see `Summary`)."""
        return self.summary.as_dict()


def evaluate(
    dataset: Dataset,
    results: Results,
    progress: Progress = lambda _: None,
    *,
    with_vsd: bool = True,
    with_ad: bool = False,
    execution: Execution = HERE,
) -> Evaluation:
    """Score results on the targets of a dataset; estimates for anything else do not count, as in BOP.

    VSD, which takes most of the time by far, is computed if all images with targets have depth; ADD and ADI if asked
    for.

    Raises:
        InputError: there are no targets, none has an estimate or one has no usable ground truth; a file is damaged.

    """
    begun = time.perf_counter()
    targets = tuple(target for target in dataset.targets() if target.inst_count > 0)
    check(dataset, results, targets)
    why_no_vsd = why_no_depth(dataset, targets) if with_vsd else "not asked for"
    compute = partial(localization_columns, with_vsd=not why_no_vsd, with_ad=with_ad)
    columns = execution.columns(compute, dataset, results, targets, progress)
    instances = FoundInstances(**columns)
    return Evaluation(
        dataset.name,
        results.method,
        instances,
        why_no_vsd,
        time.perf_counter() - begun,
        dataset.split,
        time_per_image(results),
        _incomplete(dataset, len(instances)),
    )


def localization_columns(
    dataset: Dataset, results: Results, targets: Sequence[Target], with_vsd: bool, with_ad: bool = False
) -> Columns:
    """The fields of `FoundInstances` for some targets, `vsd` and `ad` only if asked for."""
    return _found_instances(errors_of_targets(dataset, results, targets, with_vsd, with_ad))


def _incomplete(dataset: Dataset, asked: int) -> str:
    """Tell how many instances of the BOP Challenge are missing; empty if none is, or it has none of this dataset."""
    wanted = dataset.facts.test_instances or 0
    if dataset.facts.known and dataset.split != dataset.facts.test_split:
        return f"the BOP Challenge is on the split {dataset.facts.test_split}"
    return f"{asked} of the {wanted} instances of the BOP Challenge are here" if asked < wanted else ""


def _found_instances(targets: Iterable[TargetErrors]) -> Columns:
    """Match the estimates of every target, whose errors may be forgotten then: a byte a threshold is kept."""
    ids: list[tuple[int, int, int, int]] = []
    fractions: list[float] = []
    mssd, mspd, vsd, ad = [], [], [], []
    for errors in targets:
        for gt in errors.instances:
            ids.append((*errors.target[:3], gt.index))
            fractions.append(np.nan if gt.visible_fraction is None else gt.visible_fraction)
        mssd.append(found(errors.mssd, THETAS))
        mspd.append(found(errors.mspd, MSPD_THETAS_PX))
        if errors.vsd is not None:
            vsd.append(np.stack([found(at_tau, THETAS) for at_tau in errors.vsd], axis=1))
        if errors.ad is not None:
            ad.append(found(errors.ad, np.array([THETA]))[:, 0])
    columns = dict(zip(("scene_id", "im_id", "obj_id", "gt_index"), np.array(ids, dtype=np.int64).T, strict=True))
    columns |= {
        "visible_fraction": np.array(fractions, dtype=float),
        "mssd": np.concatenate(mssd),
        "mspd": np.concatenate(mspd),
    }
    optional = {"vsd": vsd, "ad": ad}
    return columns | {name: np.concatenate(parts) for name, parts in optional.items() if parts}


def _named(values: Scores) -> dict[str, float | None]:
    """The scores under the names of BOP's scripts."""
    return {
        _PREFIX: values.average,
        f"{_PREFIX}_vsd": values.vsd,
        f"{_PREFIX}_mssd": values.mssd,
        f"{_PREFIX}_mspd": values.mspd,
    }
