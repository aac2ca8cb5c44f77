"""`inspector record`: make a run folder with recordings out of a results file."""

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from tyro.conf import Positional


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
    from pipeline.bop.dataset import open_dataset
    from pipeline.bop.results import read_results
    from pipeline.replay import Replay
    from pipeline.run import Run
    from pipeline.running import run_estimator

    console = console or Console()
    dataset, results = open_dataset(config.dataset, config.split), read_results(config.results)
    bar = Progress(TextColumn("recording"), BarColumn(), TimeRemainingColumn(), console=console)
    with Run.create(config.out, dataset=dataset, method=results.method or config.results.stem) as made, bar:
        made.save_models(dataset.model(obj_id) for obj_id in sorted({t.obj_id for t in dataset.targets()}))
        task = bar.add_task("", total=1.0)
        failed = run_estimator(
            Replay(dataset, results), dataset, made, progress=lambda p: bar.update(task, completed=p)
        )
    console.print(f"{escape(str(config.out))}: open it with: inspector serve {escape(str(config.out))}")
    return 1 if failed else 0
