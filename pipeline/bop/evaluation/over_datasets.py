"""Scores of a method over several datasets: AR_Core and its like (thesis secs. bop_accuracy_score, bop17_setup).

Each dataset has the same weight. Only with every dataset of a challenge, each of them whole, is the mean a score of
that challenge; any other mean is named for what it is.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pipeline.bop.evaluation.summary import Named, Summary, Task
from pipeline.bop.facts import dataset_facts, known_datasets
from pipeline.exceptions import InputError

CHALLENGE_2017 = ("lm", "lmo", "icmi", "icbin", "tless", "ruapc", "tudl")
"""The datasets over which recalls were averaged in 2017."""

_NAMES: dict[Task, str] = {
    "localization": "AR_Core",
    "siso": "BOP Challenge 2017",
    "detection": "AP_Core",
    "bbox": "AP_Core",
    "segm": "AP_Core",
}


@dataclass(frozen=True)
class Mean:
    """The scores of one method at one task, averaged over datasets."""

    method: str
    task: Task
    label: str
    """The name of the challenge's score, such as AR_Core, or how many of its datasets this is the mean over."""
    complete: bool
    """Whether it is the challenge's score."""
    scores: Named
    """Means; None where a dataset lacks the score."""
    datasets: tuple[str, ...]
    """What is averaged over."""
    missing: tuple[str, ...]
    """Datasets of the challenge that are not there."""
    incomplete: Mapping[str, str]
    """What is missing of those that are there, by dataset."""

    def as_dict(self) -> dict[str, Any]:
        """What goes into a JSON file."""
        return {
            "method": self.method,
            "task": self.task,
            "label": self.label,
            "complete": self.complete,
            "scores": dict(self.scores),
            "datasets": list(self.datasets),
            "missing": list(self.missing),
            "incomplete": dict(self.incomplete),
        }


def means_over_datasets(summaries: Iterable[Summary]) -> list[Mean]:
    """One mean for each method and task, in the order of their first summaries.

    Where a method has datasets of the task's challenge, the mean is over those only. Raises InputError if a method has
    two summaries for one dataset.
    """
    groups: dict[tuple[str, Task], list[Summary]] = {}
    for summary in summaries:
        groups.setdefault((summary.method, summary.task), []).append(summary)
    return [_mean(method, task, of_method) for (method, task), of_method in groups.items()]


def challenge(task: Task) -> tuple[str, ...]:
    """Names of the datasets that the challenge of a task averages over."""
    return CHALLENGE_2017 if task == "siso" else tuple(name for name in known_datasets() if dataset_facts(name).core)


def check_once_each(pairs: Iterable[tuple[str, str]]) -> None:
    """Raise InputError if a pair of a method and a dataset occurs twice: a mean would count that dataset twice."""
    seen: set[tuple[str, str]] = set()
    for method, dataset in pairs:
        if (method, dataset) in seen:
            raise InputError(
                f"two results files of {method} for {dataset}: a mean over datasets takes one of each; "
                "evaluate them in calls of their own"
            )
        seen.add((method, dataset))


def _mean(method: str, task: Task, summaries: Sequence[Summary]) -> Mean:
    check_once_each((method, summary.dataset) for summary in summaries)
    wanted = challenge(task)
    of_challenge = [summary for summary in summaries if summary.dataset.lower() in wanted]
    averaged = of_challenge or summaries
    missing = tuple(sorted(set(wanted) - {summary.dataset.lower() for summary in averaged}))
    incomplete = {summary.dataset: summary.incomplete for summary in averaged if summary.incomplete}
    complete = bool(of_challenge) and not missing and not incomplete
    return Mean(
        method=method,
        task=task,
        label=_NAMES[task] if complete else _label(task, len(averaged), len(of_challenge), bool(incomplete)),
        complete=complete,
        scores=_scores(averaged),
        datasets=tuple(summary.dataset for summary in averaged),
        missing=missing if of_challenge else (),
        incomplete=incomplete,
    )


def _label(task: Task, averaged: int, of_challenge: int, parts: bool) -> str:
    if not of_challenge:
        return f"mean over {averaged} datasets"
    which = "of 2017" if task == "siso" else "core"
    whole = len(challenge(task))
    datasets = f"{whole} datasets {which}" if task == "siso" else f"{whole} {which} datasets"
    return f"mean over {of_challenge} of {datasets}" + (", not all of them whole" if parts else "")


def _scores(summaries: Sequence[Summary]) -> Named:
    """Mean of each score that all have; None where one of them is None."""
    names = [name for name in summaries[0].scores if all(name in summary.scores for summary in summaries)]
    values = {name: [summary.scores[name] for summary in summaries] for name in names}
    return {
        name: None if None in of_score else float(np.mean([v for v in of_score if v is not None]))
        for name, of_score in values.items()
    }
