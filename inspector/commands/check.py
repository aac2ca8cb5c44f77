"""`inspector check`: whether results files are fit to be submitted and scored."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import orjson
from rich.console import Console
from rich.markup import escape
from tyro.conf import Positional

from pipeline.exceptions import InputError

if TYPE_CHECKING:
    from pipeline.bop.submission import SubmissionCheck

COLORS = {"error": "red", "warning": "yellow"}


@dataclass(frozen=True)
class CheckConfig:
    """Check results files against a dataset before they are submitted: name, columns, ids, targets, times, poses."""

    dataset: Positional[Path]
    """Folder of a BOP dataset."""
    results: Positional[tuple[Path, ...]]
    """BOP results files (CSV)."""
    split: str | None = None
    """Folder of the split, such as test_primesense; by default the official test split."""
    task: Literal["localization", "siso", "detection"] = "localization"
    """What the results are for: 6D localization, of one instance each (BOP 2017), or 6D detection (BOP 2024)."""
    json: Path | None = None
    """File to write the findings to: one object, or a list where there are several results files."""


def run(config: CheckConfig, console: Console | None = None) -> int:
    """Print the findings of every file; 1 if there is an error among them, else 0. InputError is left to the caller."""
    from pipeline.bop.dataset import open_dataset
    from pipeline.bop.json_files import write_atomically
    from pipeline.bop.submission import check_submission

    console = console or Console()
    if not config.results:
        raise InputError("no results file; name one or more: inspector check DATASET RESULTS.csv")
    dataset = open_dataset(config.dataset, config.split)
    checks = []
    for path in config.results:
        checks.append(check := check_submission(dataset, path, config.task))
        _show(check, console)
    if config.json:
        found = [check.as_dict() for check in checks]
        content = found[0] if len(found) == 1 else found
        write_atomically(config.json, orjson.dumps(content, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE))
    return 0 if all(check.ok for check in checks) else 1


def _show(check: "SubmissionCheck", console: Console) -> None:
    counts = ", ".join(
        f"{len(found)} {name}{'' if len(found) == 1 else 's'}"
        for name, found in (("error", check.errors), ("warning", check.warnings))
    )
    where = f"{check.dataset}/{check.split}, {check.task}"
    line = f"[bold]{escape(str(check.path))}[/] ({escape(where)}): {check.rows:,} rows, {counts}"
    console.print(line, highlight=False, soft_wrap=True)
    for finding in check.findings:
        severity = f"[{COLORS[finding.severity]}]{finding.severity}:[/]"
        console.print(f"  {severity} {escape(finding.text)}", highlight=False, soft_wrap=True)
