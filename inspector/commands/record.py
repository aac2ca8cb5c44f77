"""`inspector record`: make a run folder with recordings out of a results file."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from tyro.conf import Positional

from pipeline.exceptions import InputError

if TYPE_CHECKING:
    from pipeline.bop.dataset import Dataset
    from pipeline.scene import Model, Target


@dataclass(frozen=True)
class RecordConfig:
    """Make a run folder with recordings (images, poses, VSD maps) from a dataset and a results file."""

    dataset: Positional[Path]
    """Folder of a BOP dataset."""
    results: Positional[Path]
    """BOP results file (CSV)."""
    out: Path
    """Folder of the run; running again continues it."""
    split: str | None = None
    """Folder of the split; by default the official test split."""


def run(config: RecordConfig, console: Console | None = None) -> int:
    """Record all targets and return the exit code: 1 if an image failed. InputError is left to the caller."""
    from inspector.opening import notes_on
    from inspector.workspace import Method
    from pipeline.bop.assessment import targets_of
    from pipeline.bop.dataset import open_dataset
    from pipeline.bop.results import read_results
    from pipeline.replay import Replay
    from pipeline.run import Run
    from pipeline.running import run_estimator

    console = console or Console()
    dataset, results = open_dataset(config.dataset, config.split), read_results(config.results)
    for note in notes_on(dataset, [Method(results.method, results, config.results)]):
        console.print(f"[yellow]note:[/yellow] {escape(note)}", soft_wrap=True)
    targets = targets_of(dataset, results)
    if not targets:
        raise InputError(
            f"{config.results}: has nothing for the images of {config.dataset}; give the dataset it is for"
        )
    bar = Progress(TextColumn("recording"), BarColumn(), TimeRemainingColumn(), console=console)
    with Run.create(config.out, dataset=dataset, method=results.method or config.results.stem) as made, bar:
        made.save_models(_models(dataset, targets, console))
        task = bar.add_task("", total=1.0)
        replay = Replay(dataset, results)
        failed = run_estimator(
            replay, dataset, made, targets=targets, progress=lambda share: bar.update(task, completed=share)
        )
    console.print(f"{escape(str(config.out))}: open it with: inspector serve {escape(str(config.out))}")
    return 1 if failed else 0


def _models(dataset: "Dataset", targets: "list[Target]", console: Console) -> "list[Model]":
    """Models of the targets' objects; one that cannot be read is named and left out."""
    models = []
    for obj_id in sorted({target.obj_id for target in targets}):
        try:
            models.append(dataset.model(obj_id))
        except InputError as error:
            console.print(f"[yellow]left out:[/yellow] {escape(str(error))}", soft_wrap=True)
    return models
