"""`inspector evaluate`: the scores that the BOP Challenge would give."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import orjson
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from tyro.conf import Positional

from pipeline.exceptions import InputError

if TYPE_CHECKING:
    from pipeline.bop.evaluate import Evaluation
    from pipeline.bop.scores import Scores


@dataclass(frozen=True)
class EvaluateConfig:
    """Score results files as the BOP Challenge does for 6D localization: average recalls of VSD, MSSD and MSPD."""

    dataset: Positional[Path]
    """Folder of a BOP dataset."""
    results: Positional[tuple[Path, ...]]
    """BOP results files (CSV)."""
    split: str | None = None
    """Folder of the split, such as test_primesense; by default the official test split."""
    vsd: bool = True
    """Compute VSD where there is depth; it takes by far the most time."""
    json: Path | None = None
    """File to write the scores to: one object, or a list where there are several results files."""


def run(config: EvaluateConfig, console: Console | None = None) -> int:
    """Evaluate all files, print and write the scores, and return 0. InputError is left to the caller."""
    from pipeline.bop.dataset import open_dataset
    from pipeline.bop.evaluate import evaluate
    from pipeline.bop.json_files import write_atomically
    from pipeline.bop.results import read_results

    console = console or Console()
    if not config.results:
        raise InputError("no results file; name one or more: inspector evaluate DATASET RESULTS.csv")
    dataset = open_dataset(config.dataset, config.split)
    evaluations = []
    for path in config.results:
        results = read_results(path)
        if results.dataset_name and results.dataset_name != dataset.name:
            note = f"{path}: by its name for {results.dataset_name}, evaluated on {dataset.name}; check both"
            console.print(f"[yellow]note:[/yellow] {escape(note)}", soft_wrap=True)
        with _progress(console, path.name) as progress:
            evaluations.append(evaluate(dataset, results, progress, with_vsd=config.vsd))
    console.print(_table(f"{dataset.name}/{dataset.split}", evaluations))
    asked, in_challenge = len(evaluations[0].instances), dataset.facts.test_instances or 0
    if dataset.split == dataset.facts.test_split and asked < in_challenge:
        console.print(f"[yellow]note:[/yellow] {asked} of the {in_challenge} instances of the BOP Challenge are here")
    if evaluations[0].why_no_vsd:
        console.print(f"no VSD: {escape(evaluations[0].why_no_vsd)}", soft_wrap=True, highlight=False)
    if config.json:
        found = [evaluation.as_dict() for evaluation in evaluations]
        content = found[0] if len(found) == 1 else found
        write_atomically(config.json, orjson.dumps(content, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE))
    return 0


def _table(title: str, evaluations: "list[Evaluation]") -> Table:
    table = Table(title=escape(title))
    table.add_column("method", overflow="fold")
    for name in ("object", "targets", "AR", "AR_VSD", "AR_MSSD", "AR_MSPD", "seconds"):
        table.add_column(name, justify="right", no_wrap=True)
    for evaluation in evaluations:
        whole = _cells(evaluation.scores)
        seconds = f"{evaluation.seconds:.2f}"
        table.add_row(escape(evaluation.method), "all", str(len(evaluation.instances)), *whole, seconds, style="bold")
        for obj_id, of_object in evaluation.per_object.items():
            count = int((evaluation.instances.obj_id == obj_id).sum())
            table.add_row("", str(obj_id), str(count), *_cells(of_object), "")
        table.add_section()
    return table


def _cells(scores: "Scores") -> list[str]:
    values = (scores.average, scores.vsd, scores.mssd, scores.mspd)
    return ["-" if value is None else f"{value:.4f}" for value in values]


@contextmanager
def _progress(console: Console, title: str) -> Iterator[Callable[[float], None]]:
    columns = (TextColumn(escape(title)), BarColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bars:
        task = bars.add_task("", total=1.0)
        yield lambda share: bars.update(task, completed=share)
