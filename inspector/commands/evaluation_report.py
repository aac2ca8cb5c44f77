"""Scores as tables for the terminal."""

from collections.abc import Mapping, Sequence
from itertools import groupby
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.markup import escape
from rich.table import Table

if TYPE_CHECKING:
    from pipeline.bop.evaluation.over_datasets import Mean
    from pipeline.bop.evaluation.summary import Named, Summary, Task

_COLUMNS: "Mapping[Task, Mapping[str, str]]" = {
    "localization": {
        "AR": "bop19_average_recall",
        "AR_VSD": "bop19_average_recall_vsd",
        "AR_MSSD": "bop19_average_recall_mssd",
        "AR_MSPD": "bop19_average_recall_mspd",
        "AD": "ad_recall",
    },
    "siso": {"recall": "siso_recall"},
    "detection": {"AP": "bop24_mAP", "AP_MSSD": "bop24_mAP_mssd", "AP_MSPD": "bop24_mAP_mspd"},
    "bbox": {"AP": "AP", "AP50": "AP50", "AP75": "AP75", "AR": "AR100"},
    "segm": {"AP": "AP", "AP50": "AP50", "AP75": "AP75", "AR": "AR100"},
}
"""Title and name of the scores that fit in a table."""

_TITLES: "Mapping[Task, str]" = {
    "localization": "6D localization",
    "siso": "6D localization of one instance (2017)",
    "detection": "6D detection",
    "bbox": "2D detection",
    "segm": "2D segmentation",
}


def report(console: Console, summaries: "Sequence[Summary]", means: "Sequence[Mean]") -> None:
    """Print a table for each dataset and task, what is to be known of the numbers, and means over datasets."""
    for _, of_dataset in groupby(sorted(summaries, key=_place), key=_place):
        group = list(of_dataset)
        console.print(_table(group))
        for summary in group:
            for note in _notes(summary):
                console.print(note, soft_wrap=True, highlight=False)
    if means:
        console.print(_means(means))


def _place(summary: "Summary") -> tuple[str, str, str]:
    return summary.dataset, summary.split, summary.task


def _table(summaries: "Sequence[Summary]") -> Table:
    first = summaries[0]
    columns = {t: name for t, name in _COLUMNS[first.task].items() if any(name in s.scores for s in summaries)}
    table = Table(
        box=SIMPLE_HEAD,
        padding=(0, 0, 0, 1),
        title=f"{escape(first.dataset)}/{escape(first.split)}, {_TITLES[first.task]}",
    )
    table.add_column("method", overflow="fold")
    for title in ("object", "targets", *columns, "seconds"):
        table.add_column(title, justify="right", no_wrap=True)
    for summary in summaries:
        whole = _cells(summary.scores, columns)
        table.add_row(
            escape(summary.method), "all", str(summary.targets), *whole, f"{summary.seconds:.2f}", style="bold"
        )
        for obj_id, scores in summary.per_object.items():
            count = summary.targets_per_object.get(obj_id, 0)
            table.add_row("", str(obj_id), str(count), *_cells(scores, columns), "")
        table.add_section()
    return table


def _cells(scores: "Named", columns: Mapping[str, str]) -> list[str]:
    values = [scores.get(name) for name in columns.values()]
    return ["-" if value is None else f"{value:.4f}" for value in values]


def _notes(summary: "Summary") -> list[str]:
    """Lines under the table."""
    of = f"{escape(summary.method)}: "
    lines = [f"[yellow]note:[/yellow] {of}{escape(note)}" for note in summary.notes]
    if summary.incomplete:
        lines.append(f"[yellow]note:[/yellow] {escape(summary.incomplete)}")
    if "ad_mean_object_recall" in summary.scores:
        lines.append(f"{of}AD, mean over objects: {summary.scores['ad_mean_object_recall']:.4f}")
    for reason in dict.fromkeys(summary.reasons.values()):
        names = [t for t, name in _COLUMNS[summary.task].items() if summary.reasons.get(name) == reason]
        lines.append(f"{of}no {', '.join(names)}: {escape(reason)}" if names else "")
    return list(filter(None, lines))


def _means(means: "Sequence[Mean]") -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 0, 0, 1), title="over datasets")
    table.add_column("method", overflow="fold")
    table.add_column("what", overflow="fold")
    columns = dict.fromkeys(t for mean in means for t, name in _COLUMNS[mean.task].items() if name in mean.scores)
    for title in columns:
        table.add_column(title, justify="right", no_wrap=True)
    for mean in means:
        names = {title: _COLUMNS[mean.task].get(title, "") for title in columns}
        table.add_row(escape(mean.method), escape(mean.label), *_cells(mean.scores, names))
    return table
