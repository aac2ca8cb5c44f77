"""`inspector gt-info`: masks, visibilities, COCO annotations and target lists of a dataset that lacks them."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from tyro.conf import Positional

from pipeline.exceptions import InputError

if TYPE_CHECKING:
    from pipeline.bop.gt_info.plan import GtInfoOptions, Kind, Plan


@dataclass(frozen=True)
class GtInfoConfig:
    """Make what a dataset lacks of the ground-truth information that BOP datasets come with.

    From poses, models and depth images: masks, visible masks, scene_gt_info.json, scene_gt_coco.json and the lists
    of targets. Nothing is written over without --force; an interrupted run continues when its command is given again.
    """

    dataset: Positional[Path]
    """Folder of a BOP dataset."""
    split: str | None = None
    """Folder of the split, such as train_pbr; by default the official test split."""
    scenes: tuple[int, ...] = ()
    """Scenes; by default all."""
    sensor: str | None = None
    """Suffix of the sensor in datasets with several, such as cam1; by default all."""
    only: tuple[Literal["masks", "info", "coco", "coco-modal", "targets", "bop19", "bop24"], ...] = ()
    """What to make; by default all but coco-modal. coco has boxes of full silhouettes, coco-modal of what is visible;
    targets are bop19 (localization) and bop24 (detection)."""
    masks: bool = True
    """Write the mask images; all else can be made without."""
    delta_mm: float | None = None
    """How far an object may lie behind the measured surface and still be visible; by default 15 mm, as in BOP, and 5 mm
    for ITODD and photorealistic training images."""
    force: bool = False
    """Start anew and write over existing files."""
    workers: int | None = None
    """Processes that work at once; by default as many as there are cores, where it pays."""
    scheduler: str | None = None
    """Address of a Dask scheduler whose workers are taken instead, such as tcp://10.0.0.1:8786; they need the same files
    at the same paths."""


def run(config: GtInfoConfig, console: Console | None = None) -> int:
    """Make what is asked for, tell what was made and return 0; 130 if interrupted. InputError is left to the caller."""
    from pipeline.bop.gt_info.plan import check_nothing_is_overwritten, make_plan
    from pipeline.bop.gt_info.run import is_interrupted, make_gt_info
    from pipeline.parallel import open_workers

    console = console or Console()
    plan = make_plan(config.dataset.absolute() if config.scheduler else config.dataset, _options(config))
    continued = is_interrupted(plan) and not config.force
    if not continued and not config.force:
        check_nothing_is_overwritten(plan)
    for note in plan.notes:
        console.print(f"[yellow]note:[/yellow] {escape(note)}", soft_wrap=True, highlight=False)
    try:
        with open_workers(config.workers, config.scheduler) as workers, _progress(console, plan) as progress:
            make_gt_info(plan, force=config.force, workers=workers, progress=progress)
    except KeyboardInterrupt:
        console.print("interrupted; the same command continues where it stopped")
        return 130
    verb = "completed" if continued else "made"
    text = f"{plan.name}/{plan.split}: {verb} {', '.join(_words(plan))}"
    console.print(text, markup=False, soft_wrap=True, highlight=False)
    return 0


def _options(config: GtInfoConfig) -> "GtInfoOptions":
    from pipeline.bop.gt_info.plan import GtInfoOptions

    if config.delta_mm is not None and not config.delta_mm >= 0:
        raise InputError(f"--delta-mm {config.delta_mm:g}: give millimetres from 0, such as 15")
    return GtInfoOptions(
        split=config.split,
        scenes=config.scenes,
        sensor=config.sensor,
        kinds=_kinds(config),
        masks=config.masks,
        delta=None if config.delta_mm is None else config.delta_mm / 1000.0,
    )


def _kinds(config: GtInfoConfig) -> "frozenset[Kind] | None":
    """What is asked for; None: all that is usual."""
    from pipeline.bop.gt_info.plan import LISTS

    if not config.only:
        return None
    kinds: set[Kind] = {kind for kind in config.only if kind != "targets"}
    return frozenset(kinds.union(LISTS) if "targets" in config.only else kinds)


def _words(plan: "Plan") -> Iterator[str]:
    """What is made, for people."""
    from pipeline.bop.gt_info.scenes import STEMS
    from pipeline.bop.gt_info.targets import list_path

    count = sum(sum(part.instances.values()) for part in plan.parts)
    if "masks" in plan.kinds:
        yield f"{2 * count} masks"
    for kind, stem in STEMS.items():
        if kind in plan.kinds:
            yield f"{len(plan.parts)} {stem}.json"
    for year in ("bop19", "bop24"):
        if year in plan.kinds:
            yield list_path(plan.root, plan.split, year).name


@contextmanager
def _progress(console: Console, plan: "Plan") -> Iterator[Callable[[int], None]]:
    columns = (TextColumn("images"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bars:
        task = bars.add_task("", total=plan.images, start=False)

        def show(done: int) -> None:
            if bars.tasks[0].started:
                bars.update(task, completed=done)
            else:  # what is done already tells nothing of the speed
                bars.reset(task, completed=done)

        yield show
