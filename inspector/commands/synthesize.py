"""`inspector synthesize`: a BOP dataset made from object models alone."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
from rich.text import Text
from tyro.conf import Positional

from inspector.interruption import interruptible
from pipeline.exceptions import InputError

if TYPE_CHECKING:
    from pipeline.synth.generation.config import SynthesisConfig


@dataclass(frozen=True)
class SynthesizeConfig:
    """Make a BOP dataset from object models: images, depth, masks, ground truth, COCO annotations.

    Objects are arranged by physics in furnished scenes and path traced, or drawn over pictures, or put on a marker
    board. An interrupted run continues when its command is given again. Without arguments: which configurations there
    are.
    """

    config: Positional[Path | None] = None
    """Configuration file (TOML), or the name of one that comes with this: bop20, furnished, bins, upright, paste,
    turntable or demo."""
    out: Path | None = None
    """Folder of the dataset."""
    models: Path | None = None
    """Folder of a BOP dataset whose models are taken in place of the configuration's."""
    objects: tuple[int, ...] = ()
    """Only these objects."""
    scenes: int | None = None
    """Number of scenes of each [[scene]]; for a first look, 1."""
    arrangements: int | None = None
    """Number of arrangements in a scene."""
    images: int | None = None
    """Number of images of an arrangement, or of a scene where objects are drawn over pictures."""
    quality: Literal["low", "medium", "high", "bop20"] | None = None
    """Of path tracing."""
    seed: int | None = None
    workers: int | None = None
    """Processes that work at once; by default one for every two cores, which it uses both."""
    scheduler: str | None = None
    """Address of a Dask scheduler whose workers are taken instead, such as tcp://10.0.0.1:8786; they need the same files
    at the same paths."""


def run(config: SynthesizeConfig, console: Console | None = None) -> int:
    """Make the dataset and return 0; 130 if interrupted. InputError is left to the caller."""
    console = console or Console()
    if config.config is None:
        _tell_names(console)
        return 0
    if config.out is None:
        raise InputError("no --out; give the folder of the dataset to be made")
    _check_extra()
    from pipeline.synth.generation.config_file import read_config

    asked = _changed(read_config(config.config), config)
    return _make(asked, config, console)


def _check_extra() -> None:
    """Raise InputError where the extra is not installed."""
    from importlib.util import find_spec

    missing = [name for name in ("mitsuba", "mitsuba_oidn", "mujoco", "manifold3d") if find_spec(name) is None]
    if missing:
        raise InputError(
            f"synthesize needs {', '.join(missing)}, which the extra synth brings: "
            ".venv/bin/pip install -c constraints.txt -e '.[synth]'"
        )


def _make(asked: SynthesisConfig, config: SynthesizeConfig, console: Console) -> int:
    from pipeline.parallel import open_workers
    from pipeline.synth.generation.run import synthesize

    assert config.out is not None
    out = config.out.absolute()
    count = max(1, min(_processes(asked), asked.images)) if config.workers is None else config.workers
    begun = time.monotonic()
    try:
        with (
            interruptible() as check,
            open_workers(None if config.scheduler else count, config.scheduler) as workers,
            _progress(console, asked.images) as progress,
        ):
            made = synthesize(asked, out, workers, count, progress)
            check()
    except KeyboardInterrupt:
        console.print("interrupted; finished images are there, and the same command continues")
        return 130
    text = f"made in {_duration(time.monotonic() - begun)}" if made else "complete already; nothing to do"
    console.print(
        f"{out}: {asked.images} images of {asked.split}, {text}", markup=False, soft_wrap=True, highlight=False
    )
    console.print(
        f"look at it: inspector serve {out} --split {asked.split}", markup=False, soft_wrap=True, highlight=False
    )
    return 0


def _processes(asked: SynthesisConfig) -> int:
    """How many pay: a path tracer keeps two cores busy, and every process has to set its scenes up."""
    cores = len(os.sched_getaffinity(0))
    return cores if all(scene.kind == "pasted" for scene in asked.scene) else max(1, cores // 2)


def _changed(asked: SynthesisConfig, config: SynthesizeConfig) -> SynthesisConfig:
    """The configuration with what the command line says instead."""
    general: dict[str, Any] = {"models": config.models, "objects": config.objects, "seed": config.seed}
    if config.models is not None:
        general["models"] = config.models.absolute()
    asked = replace(asked, **{name: value for name, value in general.items() if value not in (None, ())})
    names = ("scenes", "arrangements", "images", "quality")
    scenes = []
    for scene in asked.scene:
        own = {name: value for name in names if (value := getattr(config, name)) is not None and hasattr(scene, name)}
        scenes.append(replace(scene, **own))
    return replace(asked, scene=tuple(scenes))


def _tell_names(console: Console) -> None:
    from pipeline.synth.generation.config_file import FOLDER, config_names

    console.print("configurations that come with this (inspector synthesize NAME --out FOLDER --models DATASET):")
    for name, text in config_names().items():
        console.print(f"  [bold]{name:<10}[/bold] {escape(text)}", highlight=False, soft_wrap=True)
    console.print(f"copy one to change it: {FOLDER}", markup=False, soft_wrap=True, highlight=False)


class _Speed(ProgressColumn):
    """Seconds an image, over all workers."""

    def render(self, task: Any) -> Text:
        return Text(f"{1 / task.speed:.2g} s/image" if task.speed else "", style="progress.data.speed")


@contextmanager
def _progress(console: Console, total: int) -> Iterator[Callable[[int], None]]:
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), _Speed(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True, speed_estimate_period=300) as bars:
        task = bars.add_task("setting the first scene up", total=total, start=False)

        def show(done: int) -> None:
            if not bars.tasks[0].started:  # what is done already tells nothing of the speed
                bars.reset(task, completed=done)
            elif done > bars.tasks[0].completed:
                bars.update(task, completed=done, description="images")

        yield show


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s" if minutes else f"{rest} s"
