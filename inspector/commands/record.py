"""`inspector record`: make a run folder with recordings out of a results file."""

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from tyro.conf import Positional

from pipeline.exceptions import InputError


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
    workers: int | None = None
    """Processes that work at once; by default as many as there are cores, where it pays."""


def run(config: RecordConfig, console: Console | None = None) -> int:
    """Record all targets and return the exit code: 1 if an image failed, 130 if interrupted.

    InputError is left to the caller.
    """
    from inspector.commands.work import Work, crew
    from inspector.opening import notes_on
    from inspector.workspace import Method
    from pipeline.bop.assessment import targets_of
    from pipeline.bop.dataset import open_dataset
    from pipeline.bop.results import read_results
    from pipeline.replay import Replay
    from pipeline.run import Run

    console = console or Console()
    dataset, results = open_dataset(config.dataset, config.split), read_results(config.results)
    for note in notes_on(dataset, [Method(results.method, results, config.results)]):
        console.print(f"[yellow]note:[/yellow] {escape(note)}", soft_wrap=True)
    targets = targets_of(dataset, results)
    if not targets:
        raise InputError(
            f"{config.results}: has nothing for the images of {config.dataset}; give the dataset it is for"
        )
    work = Work("recording", Replay(dataset, results), dataset, targets)
    with (
        crew(config.workers) as by,
        Run.create(config.out, dataset=dataset, method=results.method or config.results.stem) as made,
    ):
        return work.into(made, by, console)
