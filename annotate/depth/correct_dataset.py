"""Correcting the depth images of a dataset, in a copy or in place; what is interrupted goes on, nothing is half done.

A folder of depth images is made anew under another name, image by image, with a file that says what was done
(`annotate.depth.provenance`); only when it is whole, it takes its place by being renamed. In place, the images as they
were stay beside it in `depth_original`.
"""

import datetime
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from annotate.depth.applying import check_correction, correct_raw
from annotate.depth.depth_folders import (
    HEAD,
    CorrectionPlan,
    DepthFolder,
    begin,
    beside,
    depth_folders,
    finish_renames,
    link_others,
)
from annotate.depth.provenance import Provenance, check_uncorrected, read_provenance, write_provenance
from pipeline.bop.json_files import read_bytes, write_atomically
from pipeline.exceptions import FormatError, InputError
from pipeline.parallel import HERE, Workers

Progress = Callable[[int, int], None]
"""Told how many of how many depth images are finished."""


@dataclass(frozen=True)
class Done:
    """What was done."""

    images: int
    too_near: int
    """Pixels that came out at 0 or less and became 0: not measured."""
    too_far: int
    """Pixels that came out beyond the range of 16 bits and took its end."""


@dataclass(frozen=True)
class _Item:
    source: Path
    target: Path
    scale_mm: float


def correct_in_place(plan: CorrectionPlan, workers: Workers = HERE, progress: Progress | None = None) -> Done:
    """Correct a dataset's depth images where they are; those as they were are kept in `depth_original` beside.

    Raises InputError, before anything is changed, if some are corrected already or an interrupted run had another
    correction; later if a file cannot be read or written, and then the same call continues.
    """
    check_correction(plan.a, plan.b)
    head = plan.root / f".depth_correction_{plan.split}.json"
    continued = head.is_file()
    begin(head, plan)
    try:
        finish_renames(plan)
        folders = [one for one in depth_folders(plan) if not (continued and _is_made(one.source, plan))]
        for folder in folders:
            _check_free(folder.source)
    except BaseException:
        if not continued:
            head.unlink()
        raise
    run = _Run(plan, workers, progress, sum(len(folder.scales_mm) for folder in folders))
    for folder in folders:
        run.make(folder, beside(folder.source, "corrected.part"), original=beside(folder.source, "original").name)
    for folder in folders:
        folder.source.rename(beside(folder.source, "original"))
        beside(folder.source, "corrected.part").rename(folder.source)
    head.unlink()
    return run.done


def _is_made(folder: Path, plan: CorrectionPlan) -> bool:
    """Whether an interrupted run of the plan has finished a folder."""
    found = read_provenance(folder)
    return found is not None and (found.get("a"), found.get("b_mm")) == (plan.a, plan.b * 1000.0)


def _check_free(folder: Path) -> None:
    check_uncorrected(folder)
    if (kept := beside(folder, "original")).exists():
        raise InputError(f"{kept}: is there already; move it away, the images as they are now would be kept there")


def correct_to(plan: CorrectionPlan, out: Path, workers: Workers = HERE, progress: Progress | None = None) -> Done:
    """Make a corrected copy of the dataset; files that stay as they are become hard links where that can be.

    The copy takes its name when it is whole. Raises InputError as `correct_in_place` does, and if `out` exists.
    """
    check_correction(plan.a, plan.b)
    if out.exists():
        raise InputError(f"{out}: exists already; name a new folder with --out")
    if out.resolve().is_relative_to(plan.root.resolve()):
        raise InputError(f"{out}: lies inside the dataset; name a folder outside with --out")
    folders = depth_folders(plan)
    for folder in folders:
        check_uncorrected(folder.source)
    part = out.with_name(f".{out.name}.part")
    begin(part / HEAD, plan)
    made = {folder.source: part / folder.source.relative_to(plan.root) for folder in folders}
    link_others(plan.root, part, set(made))
    run = _Run(plan, workers, progress, sum(len(folder.scales_mm) for folder in folders))
    for folder in folders:
        run.make(folder, made[folder.source], original=None)
    (part / HEAD).unlink()
    part.rename(out)
    return run.done


class _Run:
    """A correction at work."""

    def __init__(self, plan: CorrectionPlan, workers: Workers, progress: Progress | None, total: int) -> None:
        self._plan, self._workers, self._progress, self._total = plan, workers, progress, total
        self.done = Done(0, 0, 0)

    def make(self, folder: DepthFolder, target: Path, original: str | None) -> None:
        """Make a folder of corrected images, with what an interrupted run has made of it, and its provenance last."""
        begin(target / HEAD, self._plan)
        items = [_Item(folder.source / name, target / name, scale) for name, scale in folder.scales_mm.items()]
        near = far = 0
        work = self._workers.map_unordered(_correct, items, (self._plan.a, self._plan.b), total=len(items))
        for count, (_, lost) in enumerate(work, 1):
            near, far = near + lost[0], far + lost[1]
            if self._progress:
                self._progress(self.done.images + count, self._total)
        when = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        b_mm = self._plan.b * 1000.0
        write_provenance(target, Provenance(self._plan.a, b_mm, when, len(items), near, far, original))
        (target / HEAD).unlink()
        self.done = Done(self.done.images + len(items), self.done.too_near + near, self.done.too_far + far)


def _correct(correction: tuple[float, float], item: _Item) -> tuple[int, int]:
    """What a worker does: correct one image; the counts of pixels that did not fit."""
    raw = cv2.imdecode(np.frombuffer(read_bytes(item.source), np.uint8), cv2.IMREAD_UNCHANGED)
    if raw is None or raw.ndim != 2:
        raise FormatError(f"{item.source}: is no depth image; get the file again")
    try:
        corrected = correct_raw(raw, item.scale_mm, *correction)
    except InputError as error:
        raise InputError(f"{item.source}: {error}") from error
    if not item.target.exists():
        write_atomically(item.target, cv2.imencode(item.target.suffix, corrected.raw)[1].tobytes())
    return corrected.too_near, corrected.too_far
