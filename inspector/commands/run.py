"""`inspector run`: a method over a dataset, into a run folder."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass, make_dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Union

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from tyro.conf import OmitSubcommandPrefixes, Positional, Suppress, arg, subcommand

from inspector.interruption import interruptible
from inspector.methods import METHODS
from pipeline.exceptions import InputError, MissingFileError

if TYPE_CHECKING:
    from pipeline.bop.dataset import Dataset
    from pipeline.estimator import Estimator
    from pipeline.run import Run
    from pipeline.scene import Model, Target


@dataclass(frozen=True)
class RunOptions:
    """What all methods have in common."""

    dataset: Positional[Path]
    """Folder of a BOP dataset."""
    out: Path
    """Folder of the run; running again goes on where it stopped."""
    split: str | None = None
    """Folder of the split, such as test_primesense; by default the official test split."""
    targets: Path | None = None
    """List of what to look for, such as test_targets_bop19.json; by default the dataset's own."""
    scenes: tuple[int, ...] = ()
    """Only these scenes."""
    images: tuple[int, ...] = ()
    """Only these images of the scenes."""
    record: bool = True
    """Record what the method sees of each image, for the inspector."""
    workers: int | None = None
    """Processes that work at once; by default as many as there are cores, where it pays."""
    scheduler: str | None = None
    """Address of a Dask scheduler whose workers are taken instead, such as tcp://10.0.0.1:8786; they need this program,
    the dataset and the run's folder at the same paths."""


def _with_settings(settings: type) -> type:
    """The options of a method's subcommand: its own settings beside those that all methods have."""
    own = [("method", Annotated[settings, arg(name="")])]
    made = make_dataclass(f"Run{settings.__name__}", own, bases=(RunOptions,), frozen=True, kw_only=True)
    made.__doc__ = settings.__doc__
    return made


_BY_METHOD = {name: _with_settings(method.settings) for name, method in METHODS.items()}
_SUBCOMMANDS = [Annotated[options, subcommand(name)] for name, options in _BY_METHOD.items()]
_ANY = Union[(*_SUBCOMMANDS, Annotated[None, Suppress])]  # tyro makes subcommands of two types at least


@dataclass(frozen=True)
class RunConfig:
    """Run a method over a dataset, into a run folder with its estimates and recordings."""

    options: Annotated[_ANY, arg(name=""), OmitSubcommandPrefixes]  # type: ignore[valid-type]
    """Of the method chosen."""


def run(config: RunConfig, console: Console | None = None) -> int:
    """Run the method and return the exit code: 1 if an image failed, 130 if interrupted. InputError is left to the caller."""
    from pipeline.bop.dataset import open_dataset
    from pipeline.bop.evaluation.chosen_targets import chosen_targets
    from pipeline.run import Run

    options: Any = config.options
    name = next(name for name, kind in _BY_METHOD.items() if isinstance(options, kind))
    dataset = open_dataset(options.dataset, options.split)
    targets = chosen_targets(dataset, options.targets, options.scenes, options.images)
    settings = _checked(options.method)
    seed = getattr(settings, "seed", 0)
    estimator = METHODS[name].estimator(settings, dataset)
    console = console or Console()
    with Run.create(options.out, dataset=dataset, method=name, config=asdict(settings), seed=seed) as made:
        work = Work(name, estimator, dataset, targets, options.record)
        return work.into(made, console, options.workers, options.scheduler)


def _checked(settings: Any) -> Any:
    """Settings with whole paths: workers may be elsewhere, and a run that goes on may be begun from another folder.

    Raises MissingFileError for a path where nothing is, before there is a run with it.
    """
    paths = {name: value.absolute() for name, value in vars(settings).items() if isinstance(value, Path)}
    for name, path in paths.items():
        if not path.exists():
            raise MissingFileError(f"{path}: no such file; correct --{name.replace('_', '-')}")
    return replace(settings, **paths)


@dataclass(frozen=True)
class Work:
    """What is to be done by `inspector run` and its kin."""

    title: str
    estimator: "Estimator"
    dataset: "Dataset"
    targets: "Sequence[Target]"
    record: bool = True

    def into(self, run: "Run", console: Console, count: int | None, scheduler: str | None = None) -> int:
        """Do it with `count` workers or those of a scheduler, show how far it is, and return the exit code."""
        from pipeline.parallel import open_workers
        from pipeline.running import run_estimator

        images = {target.image for target in self.targets}
        finished = len(images.intersection(run.finished_images()))
        if self.record:
            run.save_models(self._models(console))
        try:
            with (
                open_workers(count, scheduler) as workers,
                interruptible() as check_interruption,
                _bar(console, self.title, finished, len(images)) as update,
            ):

                def progress(share: float) -> None:
                    update(share)
                    check_interruption()

                options: dict[str, Any] = {"targets": self.targets, "record": self.record}
                failed = run_estimator(self.estimator, self.dataset, run, **options, progress=progress, workers=workers)
        except KeyboardInterrupt:
            done = len(images.intersection(run.finished_images()))
            console.print(f"interrupted at {done} of {len(images)} images; the same command continues where it stopped")
            return 130
        root = escape(str(run.root))
        failures = f"{failed} of {len(images) - finished} images failed; " if failed else ""
        console.print(f"{root}: {failures}open it with: inspector serve {root}", soft_wrap=True, highlight=False)
        return 1 if failed else 0

    def _models(self, console: Console) -> "list[Model]":
        """Models of the targets' objects; one that cannot be read is named and left out."""
        models = []
        for obj_id in sorted({target.obj_id for target in self.targets}):
            try:
                models.append(self.dataset.model(obj_id))
            except InputError as error:
                console.print(f"[yellow]left out:[/yellow] {escape(str(error))}", soft_wrap=True)
        return models


@contextmanager
def _bar(console: Console, title: str, finished: int, total: int) -> "Iterator[Any]":
    """A bar that counts images; updated with the share of those that were not finished before."""
    columns = (TextColumn(escape(title)), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bars:
        task = bars.add_task("", total=total, completed=finished)
        yield lambda share: bars.update(task, completed=round(finished + share * (total - finished)))
