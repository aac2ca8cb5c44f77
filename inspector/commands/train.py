"""`inspector train`: a method's network, trained on a dataset, into a folder that can be watched and gone on with."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from tyro.conf import OmitSubcommandPrefixes, Positional, Suppress, arg, subcommand

from pipeline.epos.training.config import TrainConfig as EposTraining
from pipeline.exceptions import MissingFileError

if TYPE_CHECKING:
    from pipeline.epos.training.train import Progress as Step


@dataclass(frozen=True)
class EposOptions(EposTraining):
    """Train the network of EPOS on the objects of a dataset.

    Without further options: a light network, for two processor cores, on images that are made on the fly from the
    models. The same command goes on where it was stopped, to the bit on a CPU.
    """

    dataset: Positional[Path]
    """Folder of a BOP dataset: its models, its camera, and images of its training split if there is one."""


_ANY = Annotated[EposOptions, subcommand("epos")] | Annotated[None, Suppress]  # tyro: of two types at least


@dataclass(frozen=True)
class TrainConfig:
    """Train the network of a method on the objects of a dataset."""

    options: Annotated[_ANY, arg(name=""), OmitSubcommandPrefixes]
    """Of the method chosen."""


def run(config: TrainConfig, console: Console | None = None) -> int:
    """Train and return 0; 130 if interrupted. InputError is left to the caller."""
    options: Any = config.options
    console = console or Console()
    asked = _with_whole_paths(options)
    reached, stop = 0, _Stop()
    try:
        with stop.listening(), _bar(console, asked) as show:
            from pipeline.epos.training.train import train

            def progress(step: Step) -> None:
                nonlocal reached
                reached = step.step
                show(step)
                stop.check()

            network = train(asked, progress)
    except KeyboardInterrupt:
        _say(console, _stopped(reached, asked, stop.between_steps))
        return 130
    _say(console, f"{network}: trained in {asked.steps} steps")
    _say(console, f"use it:  inspector run epos {asked.dataset} --checkpoint {network} --out RUN")
    _say(console, f"see how: inspector serve {asked.out}")
    return 0


def _stopped(step: int, asked: EposTraining, between_steps: bool) -> str:
    """What is told when training was stopped."""
    if not step:
        return "stopped before the first step"
    if not between_steps:
        return f"stopped within step {step + 1} of {asked.steps}; the same command goes on from what was saved last"
    return f"stopped at step {step} of {asked.steps}, which is saved in {asked.out}; the same command goes on there"


def _with_whole_paths(options: EposTraining) -> EposTraining:
    """Options that mean the same in another folder. Raises MissingFileError for a path where nothing is."""
    given = {"dataset": options.dataset, "start_from": options.start_from}
    for name, path in (*given.items(), ("pasted.backgrounds", options.pasted.backgrounds)):
        if path is not None and not path.exists():
            option = "the dataset" if name == "dataset" else f"--{name.replace('_', '-')}"
            raise MissingFileError(f"{path}: no such file or folder; correct {option}")
    whole = {name: path.absolute() for name, path in given.items() if path is not None}
    pasted = options.pasted
    if pasted.backgrounds is not None:
        pasted = replace(pasted, backgrounds=pasted.backgrounds.absolute())
    return replace(options, **whole, out=options.out.absolute(), pasted=pasted)


class _Stop:
    """Ctrl-C that waits for the end of the step; a second one does not wait."""

    def __init__(self) -> None:
        self._steps, self._asked = 0, False
        self.between_steps = False
        """Whether it came to the end of a step."""

    def check(self) -> None:
        """Called after each step; raises KeyboardInterrupt if it was pressed."""
        self._steps += 1
        if self._asked:
            self.between_steps = True
            raise KeyboardInterrupt

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Handle the signal inside."""
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = signal.signal(signal.SIGINT, self._pressed)
        try:
            yield
        finally:
            signal.signal(signal.SIGINT, before)

    def _pressed(self, *_: object) -> None:
        if self._asked or not self._steps:
            raise KeyboardInterrupt
        self._asked = True


@contextmanager
def _bar(console: Console, asked: EposTraining) -> Iterator[Callable[[Step], None]]:
    """A line with step, loss, speed and the time left; its loss is smoothed."""
    columns = (
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[loss]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=console, speed_estimate_period=120) as bars:
        task = bars.add_task("preparing", total=asked.steps, start=False, loss="")
        smooth: list[float] = []

        def show(step: Step) -> None:
            if not smooth:  # what was done before tells nothing of the speed
                bars.reset(task, completed=step.step - 1, description="training")
                smooth.append(step.loss[0])
            smooth[0] += _SMOOTHING * (step.loss[0] - smooth[0])
            speed = bars.tasks[0].speed
            rate = "" if speed is None else f"  {asked.batch * speed:.3g} images/s"
            bars.update(task, completed=step.step, loss=f"loss {smooth[0]:.3f}{rate}")

        yield show


_SMOOTHING = 0.05
"""Weight of a step in the loss that is shown."""


def _say(console: Console, text: str) -> None:
    console.print(text, markup=False, highlight=False, soft_wrap=True)
