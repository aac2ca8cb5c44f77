"""A results file checked before it is submitted or scored, as strictly as BOP's own check and with more to say.

BOP's check (bop_toolkit, `check_bop_results`) refuses what its reader cannot read, a file without estimates, and two
times for one image. Its scores then ignore without a word whatever is not asked for; here that is told too.
"""

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from pipeline.bop.dataset import Dataset
from pipeline.bop.results import Results, name_parts, results_of, scan_results
from pipeline.bop.results_csv import MAX_ROWS, Scan, UnreadableError
from pipeline.bop.submission.asked import asked_of
from pipeline.bop.submission.file import check_name, check_text, finding_of
from pipeline.bop.submission.findings import Finding, Given, Task
from pipeline.bop.submission.targets import NOT_ASKED, check_counts, check_ids
from pipeline.bop.submission.values import check_poses, check_scores, check_times

MEANINGLESS = frozenset({"nothing matches", "no rows", "no targets"})
"""Kinds of findings of which any forbids to score a file."""

__all__ = ["Finding", "SubmissionCheck", "Task", "check_submission"]


@dataclass(frozen=True, eq=False)
class SubmissionCheck:
    """All that was found in a results file, errors first, at most one finding of a kind."""

    path: Path
    dataset: str
    split: str
    task: Task
    rows: int
    """Rows that could be read."""
    findings: tuple[Finding, ...]
    results: Results | None
    """The file's content; None if a row of it cannot be read."""

    @cached_property
    def errors(self) -> tuple[Finding, ...]:
        """Why BOP would refuse the file, or why it cannot be evaluated."""
        return tuple(finding for finding in self.findings if finding.severity == "error")

    @cached_property
    def warnings(self) -> tuple[Finding, ...]:
        """What looks wrong, but is evaluated."""
        return tuple(finding for finding in self.findings if finding.severity == "warning")

    @cached_property
    def unusable(self) -> Finding | None:
        """Why the file is not to be scored, as the numbers would mean nothing; None where it can be.

        A file that is only misnamed can be: most of its rows are for targets of the dataset.
        """
        if self.results is None:
            return next(iter(self.errors), None)
        ignored = sum(finding.count for finding in self.findings if finding.kind in NOT_ASKED)
        foreign = {"other dataset"} if 2 * ignored > self.rows else set()
        return next((found for found in self.findings if found.kind in MEANINGLESS | foreign), None)

    @property
    def ok(self) -> bool:
        """Whether there is no error."""
        return not self.errors

    def lines(self) -> list[str]:
        """Give every finding as a line of plain text."""
        return [f"{finding.severity}: {finding.text}" for finding in self.findings]

    def as_dict(self) -> dict[str, Any]:
        """As plain values, for JSON."""
        return {
            "file": str(self.path),
            "dataset": self.dataset,
            "split": self.split,
            "task": self.task,
            "rows": self.rows,
            "ok": self.ok,
            "findings": [finding.as_dict() for finding in self.findings],
        }


def check_submission(
    dataset: Dataset,
    path: Path,
    task: Task = "localization",
    *,
    name: str | None = None,
    max_rows: int = MAX_ROWS,
) -> SubmissionCheck:
    """Check a results file against a split of a dataset.

    Args:
        dataset: what it is for.
        path: the CSV file.
        task: decides what is asked for: instances of objects, one instance of each, or whatever is in an image.
        name: of the file as it would be submitted, if it is not that of `path`; empty to leave the name unchecked.
        max_rows: a file of more is refused, unread where its size tells.

    Raises:
        MissingFileError: the file cannot be read.
        FormatError: the dataset's list of targets is damaged.

    """
    path = Path(path)
    name = path.name if name is None else name
    findings = list(check_name(name, dataset)) if name else []
    results, rows = None, 0
    try:
        scan = scan_results(path, max_rows)
    except UnreadableError as error:
        findings.append(finding_of(error.problem))
    else:
        findings += _content(scan, dataset, task, name)
        rows = len(scan.columns["score"])
        results = None if scan.faults.counts else results_of(scan, name or path.name)
    findings.sort(key=lambda finding: finding.severity != "error")
    return SubmissionCheck(path, dataset.name, dataset.split, task, rows, tuple(findings), results)


def _content(scan: Scan, dataset: Dataset, task: Task, name: str) -> list[Finding]:
    found, given = list(check_text(scan)), Given(scan)
    if not len(given):
        return found
    asked = asked_of(dataset, task)
    found += check_ids(given, asked, name_parts(name).dataset)
    if not any(finding.kind == "nothing matches" for finding in found):
        found += check_counts(given, asked, task, dataset)
    return [*found, *check_times(given), *check_poses(given), *check_scores(given, task)]
