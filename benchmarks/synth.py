"""Cost of whole synthetic images, by the real generator: per preset, per stage, over processes; and of render & paste.

    python benchmarks/synth.py [--presets low bop20] [--images 8] [--processes 1 2]

Each row is one run of `synthesize`: a scene of our parts, arranged by physics, its 640 x 480 images written with masks
and annotations. Wall seconds of the run, wall and CPU seconds per image once the scene stands (the arrangement and the
compilation of the first image are listed apart, added over the processes), CPU seconds of all processes. The last column
relates the images per second to those of the first row. All processes together use as many threads as there are cores.
Nothing is asserted; a busy machine makes all of it larger.
`benchmarks/path_tracer.py` looks into path tracing itself.
"""

import json
import os
import resource
import tempfile
import time
from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import tyro
from rich.console import Console
from rich.table import Table

from pipeline.parallel.local import LocalWorkers
from pipeline.synth.generation.config import PastedScene, SynthesisConfig, TracedScene
from pipeline.synth.generation.config_file import read_config
from pipeline.synth.generation.run import synthesize
from pipeline.synth.tracing.mitsuba_variant import mitsuba

THESIS = {"low": 15.0, "medium": 120.0, "high": 720.0}
"""Wall seconds per VGA image on 16 cores (thesis sec. synth_pbr)."""


@dataclass(frozen=True)
class Config:
    """What to measure."""

    presets: tuple[str, ...] = ("low", "bop20", "medium")
    """`high` takes some ten times as long as `medium`."""
    images: int = 8
    """Path traced, per run."""
    pasted: int = 100
    """Rendered and pasted, per run."""
    processes: tuple[int, ...] = (1, 2)
    world: str = "cube_room"


class Run(NamedTuple):
    """One run of the generator."""

    wall: float
    cpu: float
    """Of this and all worker processes."""
    images: int
    seconds: dict[str, float]
    """Wall seconds of the stages, added over images and processes."""
    processes: int

    @property
    def rate(self) -> float:
        """Images per second of all processes together, setting up not counted."""
        return self.processes / self.per_image

    @property
    def per_image(self) -> float:
        """Wall seconds that one process takes for an image, setting up not counted."""
        made = sum(value for name, value in self.seconds.items() if name != "setup")
        return made / self.images


def used() -> float:
    """CPU seconds of this process and of those that have ended."""
    kinds = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return sum(usage.ru_utime + usage.ru_stime for usage in map(resource.getrusage, kinds))


def run(config: SynthesisConfig, processes: int) -> Run:
    """Make the dataset in an empty folder, which is removed."""
    with tempfile.TemporaryDirectory() as folder:
        before, start = used(), time.perf_counter()
        with closing(LocalWorkers(processes)) as workers:
            synthesize(config, Path(folder) / "set", workers, processes)
        wall, cpu = time.perf_counter() - start, used() - before
        summary = json.loads((Path(folder) / "set" / config.split / "synthesis.json").read_text())
    return Run(wall, cpu, summary["images"], summary["seconds"], processes)


def traced(config: Config, preset: str) -> SynthesisConfig:
    """One arrangement of the cube room."""
    base = read_config(Path("bop20"))
    scene = base.scene[0]
    assert isinstance(scene, TracedScene)
    scene = replace(scene, scenes=1, arrangements=1, images=config.images, quality=preset, worlds=(config.world,))
    return replace(base, scene=(scene,))


def show(title: str, runs: Sequence[tuple[str, Run]], console: Console) -> None:
    """Print a table."""
    stages = sorted({name for _, run in runs for name in run.seconds}, key=lambda name: name != "setup")
    table = Table(
        "run",
        "images",
        "wall s",
        "CPU s",
        "s/image",
        *(f"{name} s" for name in stages),
        "images/s",
        "ratio",
        title=title,
    )
    first = runs[0][1]
    for name, made in runs:
        parts = [
            f"{made.seconds[s] / (1 if s == 'setup' else made.images):.3f}" if s in made.seconds else "" for s in stages
        ]
        ratio = made.rate / first.rate
        table.add_row(
            name, str(made.images), f"{made.wall:.1f}", f"{made.cpu:.1f}", f"{made.per_image:.3f}", *parts, f"{made.rate:.2f}", f"{ratio:.2f}"
        )  # fmt: skip
    console.print(table)


def main(config: Config) -> None:
    """Print the tables."""
    console = Console(width=200)
    load = os.getloadavg()[0]
    console.print(f"{mitsuba().variant()}, {os.cpu_count()} cores, load {load:.1f}; thesis, 16 cores: {THESIS}")
    run(traced(replace(config, images=1), "low"), 1)  # compiles what is kept for later processes
    runs = [
        (f"{preset}, {n} process(es)", run(traced(config, preset), n))
        for preset in config.presets
        for n in config.processes
    ]
    show("path traced", runs, console)
    base = read_config(Path("paste"))
    scene = base.scene[0]
    assert isinstance(scene, PastedScene)
    pasted = replace(base, scene=(replace(scene, scenes=1, images=config.pasted),))
    show("render & paste", [(f"{n} process(es)", run(pasted, n)) for n in config.processes], console)


if __name__ == "__main__":
    main(tyro.cli(Config))
