"""What `inspector run` and its kin do to many images: workers, bars that show how far it is, and Ctrl-C."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

from inspector.interruption import interruptible
from pipeline.exceptions import InputError

if TYPE_CHECKING:
    from inspector.methods import Method
    from pipeline.bop.dataset import Dataset
    from pipeline.estimator import Estimator
    from pipeline.parallel import Workers
    from pipeline.run import Run
    from pipeline.scene import Model, Target


class Crew(NamedTuple):
    """Who works."""

    workers: "Workers"
    check_interruption: Callable[[], None]
    """Raises KeyboardInterrupt after Ctrl-C, even if somebody swallowed that."""


@contextmanager
def crew(count: int | None, scheduler: str | None = None) -> Iterator[Crew]:
    """So many workers, or those of a scheduler, until the end of the block; raises as `open_workers`."""
    from pipeline.parallel import open_workers

    with open_workers(count, scheduler) as workers, interruptible() as check_interruption:
        yield Crew(workers, check_interruption)


def prepare(method: "Method", settings: Any, dataset: "Dataset", by: Crew, console: Console, title: str) -> bool:
    """Let a method make what all images need, and tell what it says of it; False if interrupted."""
    if method.prepare is None:
        return True
    last = ("", 0, 0)
    try:
        with _preparation_bar(console, title, method.unit) as show:

            def progress(label: str, done: int, total: int) -> None:
                nonlocal last
                last = (label, done, total)
                show(*last)
                by.check_interruption()

            notes = method.prepare(settings, dataset, by.workers, progress)
    except KeyboardInterrupt:
        _tell_interruption(console, last[1], last[2], method.unit)
        return False
    for note in notes:
        console.print(f"[yellow]note:[/yellow] {escape(note)}", soft_wrap=True, highlight=False)
    return True


@dataclass(frozen=True)
class Work:
    """What is to be done to the images."""

    title: str
    estimator: "Estimator"
    dataset: "Dataset"
    targets: "Sequence[Target]"
    record: bool = True

    def into(self, run: "Run", by: Crew, console: Console) -> int:
        """Do it, show how far it is, and return the exit code: 1 if an image failed, 130 if interrupted."""
        from pipeline.running import run_estimator

        images = {target.image for target in self.targets}
        finished = len(images.intersection(run.finished_images()))
        if self.record:
            run.save_models(self._models(console))
        try:
            with _bar(console, self.title, finished, len(images)) as update:

                def progress(share: float) -> None:
                    update(share)
                    by.check_interruption()

                options: dict[str, Any] = {"targets": self.targets, "record": self.record, "workers": by.workers}
                failed = run_estimator(self.estimator, self.dataset, run, **options, progress=progress)
        except KeyboardInterrupt:
            done = len(images.intersection(run.finished_images()))
            _tell_interruption(console, done, len(images), "images")
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


def _tell_interruption(console: Console, done: int, total: int, unit: str) -> None:
    text = f"interrupted at {done} of {total} {unit}; the same command continues where it stopped"
    console.print(text, soft_wrap=True, highlight=False)


@contextmanager
def _bar(console: Console, title: str, finished: int, total: int) -> "Iterator[Any]":
    """A bar that counts images; updated with the share of those that were not finished before."""
    columns = (TextColumn(escape(title)), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console) as bars:
        task = bars.add_task("", total=total, completed=finished)
        yield lambda share: bars.update(task, completed=round(finished + share * (total - finished)))


@contextmanager
def _preparation_bar(console: Console, title: str, unit: str) -> "Iterator[Callable[[str, int, int], None]]":
    """A bar that comes with the first news, and names what is worked at."""
    text = TextColumn("{task.description}")
    counted = (MofNCompleteColumn(), TextColumn(unit), TimeRemainingColumn(elapsed_when_finished=True))
    with Progress(text, BarColumn(), *counted, console=console) as bars:

        def show(label: str, done: int, total: int) -> None:
            description = escape(f"{title}: {label}")
            if bars.tasks:
                bars.update(bars.tasks[0].id, description=description, completed=done, total=total)
            else:  # what was done before tells nothing of the speed
                bars.add_task(description, total=total, completed=done)

        yield show
