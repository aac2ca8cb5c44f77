"""`inspector calibrate`: a camera's intrinsics, its poses from a marker board, and dictionaries of unknown markers."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import orjson
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from tyro.conf import Positional, arg

from pipeline.exceptions import InputError

if TYPE_CHECKING:
    from annotate.calibration import Calibration, Pattern
    from pipeline.parallel import Workers


@dataclass(frozen=True)
class CalibrateConfig:
    """Calibrate a camera.

    intrinsics: camera matrix and distortion from a folder of images of a checkerboard or ChArUco board. poses: where the
    camera stood in the images of a dataset, from a marker board. dictionary: learn which markers images show.
    """

    what: Positional[Literal["intrinsics", "poses", "dictionary"]]
    """What to find."""
    path: Positional[Path]
    """Folder of images; for poses, folder of a BOP dataset."""
    checkerboard: Annotated[tuple[int, int] | None, arg(metavar="COLUMNS ROWS")] = None
    """Inner corners of a checkerboard."""
    charuco: Annotated[tuple[int, int] | None, arg(metavar="COLUMNS ROWS")] = None
    """Squares of a ChArUco board; it needs --marker and --dictionary."""
    square: Annotated[float, arg(metavar="MM")] = 25.0
    """Side of a square in millimetres; intrinsics do not depend on it."""
    marker: Annotated[float | None, arg(metavar="MM")] = None
    """Side of a ChArUco board's markers in millimetres."""
    dictionary: str = "DICT_4X4_50"
    """OpenCV's name of the dictionary of a ChArUco board."""
    undistort: Path | None = None
    """Folder to write the images to without their distortion (intrinsics)."""
    board: Path | None = None
    """Description of the marker board (poses); by default board.json in the folder of each scene."""
    split: str | None = None
    """Folder of the split (poses); by default the official test split."""
    json: Path | None = None
    """File to write the result to; for a dictionary the file that --dictionary of other commands takes."""
    workers: int | None = None
    """Processes that work at once; by default as many as there are cores, where it pays."""


def run(config: CalibrateConfig, console: Console | None = None) -> int:
    """Find what is asked for, print it and return 0. InputError is left to the caller."""
    from pipeline.bop.evaluation.files import check_writable
    from pipeline.parallel import open_workers

    console = console or Console()
    if config.json:
        check_writable(config.json)
    with open_workers(config.workers) as workers:
        if config.what == "intrinsics":
            _intrinsics(config, workers, console)
        elif config.what == "poses":
            _poses(config, workers, console)
        else:
            _dictionary(config, console)
    return 0


def _intrinsics(config: CalibrateConfig, workers: "Workers", console: Console) -> None:
    from annotate.calibration import calibrate

    pattern = _pattern(config)
    paths = _images(config.path)
    found = calibrate(paths, pattern, workers)
    table = Table()
    table.add_column("image")
    table.add_column("corners", justify="right")
    table.add_column("RMS px", justify="right")
    for image in found.images:
        table.add_row(escape(image.name), str(len(image.pixels)), f"{image.rms_px:.3f}")
    console.print(table)
    K, std = found.K, found.std
    named = zip(("fx", "fy", "cx", "cy"), (K[0, 0], K[1, 1], K[0, 2], K[1, 2]), std, strict=True)
    lines = ["  ".join(f"{name} {value:.2f} +- {sure:.2f}" for name, value, sure in named)]
    lines.append("distortion k1 k2 p1 p2 k3: " + " ".join(f"{value:.5f}" for value in found.distortion))
    lines.append(f"RMS over all corners: {found.rms_px:.3f} px")
    _tell(console, lines, found.notes)
    _write(config.json, found.as_dict())
    if config.undistort:
        _undistort(paths, config.undistort, found)


def _pattern(config: CalibrateConfig) -> "Pattern":
    from annotate.calibration import CharucoBoard, Checkerboard

    if (config.checkerboard is None) == (config.charuco is None):
        raise InputError("--checkerboard COLUMNS ROWS or --charuco COLUMNS ROWS: give one of them")
    if config.checkerboard:
        return Checkerboard(*config.checkerboard, config.square / 1000.0)
    assert config.charuco is not None
    if config.marker is None:
        raise InputError("--charuco without --marker: give the side of its markers in millimetres")
    return CharucoBoard(*config.charuco, config.square / 1000.0, config.marker / 1000.0, config.dictionary)


def _images(folder: Path) -> list[Path]:
    from pipeline.bop.layout import IMAGE_SUFFIXES

    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; give one with images")
    found = sorted(path for path in folder.iterdir() if path.suffix.lower() in IMAGE_SUFFIXES)
    if not found:
        raise InputError(f"{folder}: holds no images ({', '.join(IMAGE_SUFFIXES)})")
    return found


def _undistort(paths: list[Path], out: Path, calibration: "Calibration") -> None:
    import cv2

    from annotate.calibration import undistorted
    from pipeline.bop.images import read_rgb
    from pipeline.bop.json_files import write_atomically

    if out.resolve() == paths[0].parent.resolve():
        raise InputError(f"{out}: holds the images as they are; name another folder with --undistort")
    for path in paths:
        image = cv2.cvtColor(undistorted(read_rgb(path), calibration), cv2.COLOR_RGB2BGR)
        write_atomically(out / path.name, cv2.imencode(path.suffix, image)[1].tobytes())


def _poses(config: CalibrateConfig, workers: "Workers", console: Console) -> None:
    from annotate.calibration import sensor_poses
    from annotate.depth import scene_boards
    from pipeline.bop.dataset import open_dataset

    dataset = open_dataset(config.path, config.split)
    keys = list(dataset.images())
    found = sensor_poses(dataset, keys, scene_boards(dataset, keys, config.board), workers)
    text = f"poses of {len(found.poses)} of {len(keys)} images; RMS over {found.corners} corners: {found.rms_px:.3f} px"
    notes = [f"scene {key.scene_id} image {key.im_id}: {reason}" for key, reason in found.failures.items()]
    _tell(console, [text], notes[:10])
    entries = [
        {
            "scene_id": key.scene_id,
            "im_id": key.im_id,
            "camera_from_board": pose.camera_from_board.tolist(),
            "rms_px": pose.rms_px,
            "corners": int(pose.errors_px.size),
        }
        for key, pose in found.poses.items()
    ]
    _write(config.json, {"unit": "m", "rms_px": found.rms_px, "images": entries, "failures": notes})


def _dictionary(config: CalibrateConfig, console: Console) -> None:
    from annotate.calibration import learn_dictionary, write_dictionary
    from pipeline.bop.images import read_rgb

    paths = _images(config.path)
    found = learn_dictionary([read_rgb(path) for path in paths])
    cells, border = found.dictionary.patterns.shape[1], found.dictionary.border
    lines = [f"{len(found.counts)} markers of {cells} x {cells} cells, border of {border}, in {len(paths)} images"]
    for marker, (pattern, count) in enumerate(zip(found.dictionary.patterns, found.counts, strict=True)):
        rows = " ".join("".join("01"[int(cell)] for cell in row) for row in pattern)
        lines.append(f"  {marker:3d}: {rows}  in {count} images")
    count = len(found.symmetric)
    notes = [f"{count} patterns look alike in several orientations and are left out"] if count else []
    _tell(console, lines, notes)
    if config.json:
        write_dictionary(config.json, found.dictionary)


def _tell(console: Console, lines: list[str], notes: "list[str] | tuple[str, ...]") -> None:
    for line in lines:
        console.print(line, markup=False, highlight=False, soft_wrap=True)
    for note in notes:
        console.print(f"[yellow]note:[/yellow] {escape(note)}", highlight=False, soft_wrap=True)


def _write(path: Path | None, content: dict[str, Any]) -> None:
    from pipeline.bop.json_files import write_atomically

    if path is not None:
        write_atomically(path, orjson.dumps(content, option=orjson.OPT_INDENT_2 | orjson.OPT_APPEND_NEWLINE))
