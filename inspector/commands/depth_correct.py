"""`inspector depth-correct`: estimate a sensor's systematic depth error, and correct a dataset's depth images."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import orjson
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn
from tyro.conf import Positional, arg

from inspector.commands.depth_correct_report import show_estimate, show_unknown_size, tell
from pipeline.exceptions import InputError

if TYPE_CHECKING:
    from pipeline.bop.dataset import Dataset
    from pipeline.parallel import Workers
    from pipeline.scene import ImageKey


@dataclass(frozen=True)
class DepthCorrectConfig:
    """Correct the systematic error of a depth sensor: d_c = a d + b.

    Estimate: --from board (marker corners) or --from poses (annotated objects); tells how sure a and b are. Apply: --a
    and --b, or what was estimated, with --out or --in-place.
    """

    dataset: Positional[Path]
    """Folder of a BOP dataset."""
    source: Annotated[Literal["board", "poses"] | None, arg(name="from")] = None
    """What to estimate a and b from: the corners of a marker board, or the poses of annotated objects."""
    board: Path | None = None
    """Description of the board (JSON); by default board.json in the folder of each scene."""
    dictionary: str | None = None
    """Dictionary of the markers where there is no description: OpenCV's name, such as DICT_ARUCO_ORIGINAL, or a file of bit
    patterns (see inspector calibrate). How the markers lie on their plane is learned from the images."""
    side: Annotated[float | None, arg(metavar="MM")] = None
    """Side of the markers of --dictionary in millimetres; without, it is estimated together, and a cannot be told."""
    objects: tuple[int, ...] = ()
    """Objects whose poses to trust, for --from poses; by default all."""
    near: float = 0.0
    """Metres: only samples beyond are used (0.53 in T-LESS)."""
    far: float = float("inf")
    """Metres: only samples before are used (0.92 in T-LESS)."""
    registration: bool = False
    """Also check whether depth is registered to colour: the lateral shift of depth edges against colour edges."""
    a: float | None = None
    """Factor to correct with."""
    b: Annotated[float | None, arg(metavar="MM")] = None
    """Offset to correct with, in millimetres."""
    out: Path | None = None
    """New folder for a corrected copy of the dataset; what stays as it is becomes hard links."""
    in_place: bool = False
    """Correct the depth images where they are; those as they were are kept beside in depth_original."""
    split: str | None = None
    """Folder of the split, such as test_primesense; by default the official test split."""
    scenes: tuple[int, ...] = ()
    """Scenes; by default all."""
    sensor: str | None = None
    """Suffix of the sensor in datasets with several, such as cam1."""
    json: Path | None = None
    """File to write the estimate to."""
    workers: int | None = None
    """Processes that work at once; by default as many as there are cores, where it pays."""


def run(config: DepthCorrectConfig, console: Console | None = None) -> int:
    """Estimate, apply, or both, and return 0; 130 if interrupted. InputError is left to the caller."""
    from pipeline.bop.dataset import open_dataset
    from pipeline.bop.evaluation.files import check_writable
    from pipeline.parallel import open_workers

    console = console or Console()
    _check(config)
    if config.json:
        check_writable(config.json)
    dataset = open_dataset(config.dataset, config.split, config.sensor)
    try:
        with open_workers(config.workers) as workers:
            a, b_mm = _estimated(config, dataset, workers, console) if config.source else (config.a, config.b)
            if config.registration:
                _registration(config, dataset, workers, console)
            if config.out or config.in_place:
                assert a is not None  # see `_check`; an estimate without a factor is refused there
                _apply(config, dataset, a, (b_mm or 0.0) / 1000.0, workers, console)
    except KeyboardInterrupt:
        console.print("interrupted; nothing is half done, the same command continues where it stopped")
        return 130
    return 0


def _check(config: DepthCorrectConfig) -> None:
    applies = config.out is not None or config.in_place
    given = config.a is not None or config.b is not None
    if config.out and config.in_place:
        raise InputError("--out and --in-place: give one of them")
    if config.source and given:
        raise InputError("--from estimates a and b: leave out --a and --b")
    if given and not applies:
        raise InputError("--a and --b: say where to apply them, with --out NEW or --in-place")
    if config.a is None and given:
        raise InputError("--b without --a: give both, --a 1 for an offset alone")
    if applies and not (config.source or given):
        raise InputError("no correction: give --a and --b (millimetres), or estimate it with --from board or poses")
    if not (config.source or given or config.registration):
        raise InputError("nothing to do: give --from board, --from poses, --registration, or --a and --b")
    if config.dictionary and config.board:
        raise InputError("--board and --dictionary: a description names its dictionary; leave --dictionary out")
    if applies and config.dictionary and config.side is None:
        raise InputError("--dictionary without --side: the factor a cannot be told then, so nothing can be applied")


def _keys(config: DepthCorrectConfig, dataset: "Dataset") -> "list[ImageKey]":
    keys = [key for key in dataset.images() if not config.scenes or key.scene_id in config.scenes]
    if not keys:
        raise InputError(f"{dataset.root}: {dataset.split} has no images of scenes {config.scenes}; choose others")
    return keys


def _estimated(
    config: DepthCorrectConfig, dataset: "Dataset", workers: "Workers", console: Console
) -> tuple[float | None, float | None]:
    """Estimate, tell and write it; a and b in millimetres, None where a cannot be told."""
    from annotate.calibration import any_dictionary
    from annotate.depth import (
        board_samples,
        estimate,
        estimate_unknown_size,
        marker_samples,
        pose_samples,
        scene_boards,
    )

    keys = _keys(config, dataset)
    if config.source == "poses":
        found = pose_samples(dataset, keys, config.objects, workers)
    elif config.dictionary:
        markers = marker_samples(dataset, keys, any_dictionary(config.dictionary))
        if config.side is None:
            unknown = estimate_unknown_size(markers, config.near, config.far)
            show_unknown_size(unknown, console)
            _write(config.json, unknown.as_dict())
            return None, None
        result = estimate(
            markers.with_side(config.side / 1000.0), config.near, config.far, notes=markers.collected.notes
        )
        show_estimate(result, console)
        _write(config.json, result.as_dict())
        return result.a, result.b * 1000.0
    else:
        found = board_samples(dataset, keys, scene_boards(dataset, keys, config.board), workers)
    result = estimate(found.samples, config.near, config.far, found.notes)
    show_estimate(result, console)
    _write(config.json, result.as_dict())
    return result.a, result.b * 1000.0


def _write(path: Path | None, content: dict[str, Any]) -> None:
    from pipeline.bop.json_files import write_atomically

    if path is not None:
        write_atomically(path, orjson.dumps(content, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE))


def _registration(config: DepthCorrectConfig, dataset: "Dataset", workers: "Workers", console: Console) -> None:
    from annotate.depth import check_registration

    keys = [key for key in _keys(config, dataset) if dataset.depth_path(key)]
    found = check_registration(dataset, keys, workers)
    x, y = found.shift.x, found.shift.y
    text = (
        f"edges of colour lie ({x:+.2f} +- {found.shift.std_x:.2f}, {y:+.2f} +- {found.shift.std_y:.2f}) px from those"
    )
    text += f" of depth ({len(found.keys)} images): {'shifted' if found.is_shifted else 'no shift of half a pixel'}"
    console.print(text, markup=False, highlight=False, soft_wrap=True)


def _apply(
    config: DepthCorrectConfig, dataset: "Dataset", a: float, b: float, workers: "Workers", console: Console
) -> None:
    from annotate.depth import CorrectionPlan, correct_in_place, correct_to

    plan = CorrectionPlan(config.dataset, dataset.split, a, b, config.scenes, config.sensor)
    with _progress(console) as progress:
        if config.out is not None:
            done = correct_to(plan, config.out, workers, progress)
        else:
            done = correct_in_place(plan, workers, progress)
    where = config.out if config.out is not None else config.dataset / dataset.split
    lines = [f"{where}: corrected {done.images} depth images with a = {a:.6g}, b = {1000 * b:.6g} mm"]
    lines += [f"  {done.too_near} pixels came out at 0 or less: not measured now"] if done.too_near else []
    lines += [f"  {done.too_far} pixels came out beyond 16 bits: set to the largest depth"] if done.too_far else []
    tell(console, lines, ())


@contextmanager
def _progress(console: Console) -> Iterator[Callable[[int, int], None]]:
    columns = (TextColumn("depth images"), BarColumn(), MofNCompleteColumn(), TimeRemainingColumn())
    with Progress(*columns, console=console, transient=True) as bars:
        task = bars.add_task("", total=None)
        yield lambda done, total: bars.update(task, completed=done, total=total)
