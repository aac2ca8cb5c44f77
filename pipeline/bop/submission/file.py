"""Checks of the file itself: its name, its header, its rows as text."""

import re
from collections.abc import Iterator

from pipeline.bop.dataset import Dataset
from pipeline.bop.results import name_parts
from pipeline.bop.results_csv import HEADER, Scan
from pipeline.bop.results_problems import Problem
from pipeline.bop.submission.findings import Finding


def check_name(name: str, dataset: Dataset) -> Iterator[Finding]:
    """Whether method, dataset and split stand in the name as BOP wants them, and are those of the dataset.

    BOP's tools cut a name at its dots, the first part at its underscores, and what follows the method at its hyphens.
    """
    parts, own_split = name_parts(name), dataset.split.replace("_", "-")
    shown = name if name.isprintable() else repr(name)
    part = "[^_.-]+"
    form = rf"[^_.]+_({re.escape(dataset.name)}|{part})-(?P<split>{part}(-{part})?)(_[^.]*)?\.csv"
    found = re.fullmatch(form, name)
    if found is None:
        method = re.sub(r"[^A-Za-z0-9+-]+", "-", parts.method).strip("-") or "METHOD"
        wanted = f"{method}_{parts.dataset or dataset.name}-{parts.split or own_split}.csv"
        message = f"the name {shown} is not of the form METHOD_DATASET-SPLIT.csv (no dot or underscore in METHOD)"
        yield Finding("error", "file name", message, f"rename it, say to {wanted}", value=name)
    if parts.dataset.lower() not in ("", dataset.name.lower()) and f"_{dataset.name}-" not in name:
        message = f"by its name {shown} is for {parts.dataset}, but it is checked against {dataset.name}"
        fix = f"give the dataset {parts.dataset}, or the right file"
        yield Finding("error", "other dataset", message, fix, value=parts.dataset)
    elif found and not _same_split(split := found["split"], own_split):
        message = f"by its name {shown} is for the split {split}, but it is checked against {dataset.split}"
        yield Finding("warning", "other split", message, "give that split, or the right file", value=split)


def _same_split(a: str, b: str) -> bool:
    """Whether one is the other, possibly without its sensor, such as `test` and `test-primesense`."""
    return f"{a}-".startswith(f"{b}-") or f"{b}-".startswith(f"{a}-")


def check_text(scan: Scan) -> Iterator[Finding]:
    """What BOP's reader, or ours, stumbles over."""
    for problem, count in (*scan.faults, *scan.oddities):
        yield finding_of(problem, count)
    if not scan.has_header:
        message = "the first line is no header"
        yield Finding("warning", "no header", message, f"begin the file with {HEADER}", line=1)
    if not len(scan.columns["score"]) and not scan.faults.counts:
        fix = "write a row for each estimate: BOP refuses a file without any"
        yield Finding("error", "no rows", "it holds no estimates", fix)


def finding_of(problem: Problem, count: int = 1) -> Finding:
    """Tell what the reader found."""
    line = problem.line or None
    return Finding("error", problem.kind, problem.text, problem.fix, line, problem.column, problem.value, count)
