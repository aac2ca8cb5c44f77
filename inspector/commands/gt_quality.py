"""`inspector gt-quality`: how well the ground truth agrees with the images, and which annotations may be wrong."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import orjson
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table
from tyro.conf import Positional

if TYPE_CHECKING:
    from annotate.quality import ObjectQuality, QualityReport, Suspect


@dataclass(frozen=True)
class GtQualityConfig:
    """Judge the ground truth by the images: measured minus rendered depth, contours against edges, image against image.

    Prints the statistics of T-LESS's table by object, and the annotations that may be wrong, worst first, with reasons.
    """

    dataset: Positional[Path]
    """Folder of a BOP dataset."""
    split: str | None = None
    """Folder of the split, such as test_primesense; by default the official test split."""
    scenes: tuple[int, ...] = ()
    """Scenes; by default all."""
    sensor: str | None = None
    """Suffix of the sensor in datasets with several, such as cam1."""
    contours: bool = True
    """Compare contours with the edges of the colour images."""
    worst: int = 20
    """How many of the suspects to print; the JSON file has all."""
    json: Path | None = None
    """File to write everything to."""
    workers: int | None = None
    """Processes that work at once; by default as many as there are cores, where it pays."""
    scheduler: str | None = None
    """Address of a Dask scheduler whose workers are taken instead, such as tcp://10.0.0.1:8786; they need the same files
    at the same paths."""


def run(config: GtQualityConfig, console: Console | None = None) -> int:
    """Print the table and the suspects and return 0. InputError is left to the caller."""
    from annotate.quality import QualityConfig, audit
    from pipeline.bop.dataset import open_dataset
    from pipeline.bop.evaluation.files import check_writable
    from pipeline.bop.json_files import write_atomically
    from pipeline.parallel import open_workers

    console = console or Console()
    if config.json:
        check_writable(config.json)
    root = config.dataset.absolute() if config.scheduler else config.dataset
    dataset = open_dataset(root, config.split, config.sensor)
    with open_workers(config.workers, config.scheduler) as workers, _progress(console) as progress:
        report = audit(dataset, QualityConfig(config.scenes, config.contours), workers, progress)
    _show(console, report, config.worst)
    if config.json:
        write_atomically(config.json, orjson.dumps(report.as_dict(), option=orjson.OPT_INDENT_2))
    return 0


def _show(console: Console, report: "QualityReport", worst: int) -> None:
    console.print(_objects(report))
    for note in report.notes:
        console.print(f"[yellow]note:[/yellow] {escape(note)}", soft_wrap=True, highlight=False)
    if not report.suspects:
        console.print(f"none of {len(report.instances)} annotations is suspect", highlight=False)
        return
    if worst > 0:
        console.print(_suspects(report.suspects[:worst]))
    count = f"{len(report.suspects)} of {len(report.instances)} annotations are suspect"
    console.print(f"{count}; {min(worst, len(report.suspects))} shown, worst first", highlight=False)


def _objects(report: "QualityReport") -> Table:
    title = f"{report.dataset}/{report.split}: measured minus rendered depth, mm"
    table = Table(title=escape(title), caption="mean to median without outliers (> 50 mm); surface: within 20 mm")
    for name in ("object", "instances", "pixels", "outliers", "mean", "std", "mean |d|", "median |d|", "surface |d|"):
        table.add_column(name, justify="right")
    for one in report.objects:
        table.add_row(*_row(one, str(one.obj_id)))
    table.add_section()
    table.add_row(*_row(report.total, "all"))
    return table


def _row(one: "ObjectQuality", name: str) -> list[str]:
    depth = one.depth
    if depth is None:
        return [name, str(one.instances), *["-"] * 7]
    lengths = (depth.mean, depth.std, depth.mean_abs, depth.median_abs, depth.surface_median_abs)
    shown = [f"{1000 * value:.2f}" if value == value else "-" for value in lengths]
    outliers = f"{depth.outliers:.1%}" if depth.pixels else "-"
    return [name, str(one.instances), str(depth.pixels), outliers, *shown]


def _suspects(found: "tuple[Suspect, ...]") -> Table:
    table = Table(show_lines=True)
    for name in ("scene", "image", "annotation", "object", "times limit"):
        table.add_column(name, justify="right")
    table.add_column("why")
    for one in found:
        ids = (*one.key, one.index, one.obj_id)
        table.add_row(*map(str, ids), f"{one.severity:.1f}", escape("\n".join(one.reasons)))
    return table


@contextmanager
def _progress(console: Console) -> Iterator[Callable[[int, int], None]]:
    columns = (TextColumn("images"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bars:
        task = bars.add_task("", total=None)
        yield lambda done, total: bars.update(task, completed=done, total=total)
