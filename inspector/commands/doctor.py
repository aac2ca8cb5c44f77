"""`inspector doctor`: look for faults in a BOP dataset, each with evidence and fix."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import cv2
import orjson
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn
from rich.table import Table
from tyro.conf import Positional

from pipeline.bop.doctor import Finding, counts, diagnose
from pipeline.exceptions import InputError

COLORS = {"error": "red", "warning": "yellow", "note": "cyan", "ok": "green"}


@dataclass(frozen=True)
class DoctorConfig:
    """Look for faults in a dataset: units, depth scale, intrinsics, rotations, world poses, broken files and more."""

    dataset: Positional[Path]
    """Folder of a BOP dataset."""
    split: str | None = None
    """Folder of the split, such as test or train_pbr; default: the one that methods are compared on."""
    results: tuple[Path, ...] = ()
    """Results files (CSV) to look at as well."""
    deep: bool = False
    """Look at every scene, image and model instead of a sample; takes minutes on large datasets."""
    all: bool = False
    """Also show what was looked at and found sound."""
    json: Path | None = None
    """File to write all findings to."""


def run(config: DoctorConfig, console: Console | None = None) -> int:
    """Print the findings, worst first; 1 if there is an error among them, else 0. InputError is left to the caller."""
    console = console or Console()
    cv2.utils.logging.setLogLevel(
        cv2.utils.logging.LOG_LEVEL_SILENT
    )  # broken images become findings; OpenCV's own lines would only disturb the table
    with _progress(console) as progress:
        findings = diagnose(config.dataset, config.split, progress, deep=config.deep, results=config.results)
    shown = [finding for finding in findings if config.all or finding.severity != "ok"]
    if shown:
        console.print(_table(shown))
    number = counts(findings)
    console.print(
        f"{config.dataset.resolve().name}: {number['error']} errors, {number['warning']} warnings, "
        f"{number['note']} notes, {number['ok']} sound",
        markup=False,
        highlight=False,
    )
    if config.json:
        _write(config.json, findings)
    return 1 if number["error"] else 0


def _table(findings: list[Finding]) -> Table:
    table = Table(show_lines=True, expand=True)
    table.add_column("", no_wrap=True)
    table.add_column("finding", ratio=2)
    table.add_column("evidence", ratio=4)
    table.add_column("fix", ratio=3)
    for finding in findings:
        color = COLORS[finding.severity]
        what = f"[bold]{escape(finding.title)}[/]\n{escape(finding.subject)}"
        table.add_row(f"[{color}]{finding.severity}[/]", what, escape(finding.evidence), escape(finding.fix))
    return table


def _write(path: Path, findings: list[Finding]) -> None:
    try:
        path.write_bytes(orjson.dumps([finding.as_dict() for finding in findings], option=orjson.OPT_INDENT_2))
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); name another file with --json") from error


@contextmanager
def _progress(console: Console) -> Iterator[Callable[[int, int, str], None]]:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn())
    with Progress(*columns, console=console, transient=True) as bars:
        task = bars.add_task("")
        yield lambda done, total, title: bars.update(task, completed=done, total=total, description=escape(title))
