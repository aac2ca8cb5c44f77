"""Folders of depth images that are corrected: which there are, how a new one is begun, and how the rest is linked."""

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import orjson

from pipeline.bop import layout
from pipeline.bop.dataset import open_dataset
from pipeline.bop.json_files import read_json_object, write_atomically
from pipeline.exceptions import InputError
from pipeline.scene import ImageKey

HEAD = "correcting.json"
"""In a folder that is being made: what it is made with."""


@dataclass(frozen=True)
class CorrectionPlan:
    """Which depth images to correct, and how."""

    root: Path
    split: str
    a: float
    b: float
    """Metres."""
    scenes: tuple[int, ...] = ()
    """All if empty."""
    sensor: str | None = None
    """Suffix of the sensor in datasets with several; by default the one that the dataset prefers."""


@dataclass(frozen=True)
class DepthFolder:
    """A folder of depth images of one scene."""

    source: Path
    scales_mm: dict[str, float]
    """`depth_scale` by the name of the image."""


def depth_folders(plan: CorrectionPlan) -> list[DepthFolder]:
    """Folders of depth images that the plan is for. Raises InputError if there are none."""
    dataset = open_dataset(plan.root, plan.split, plan.sensor)
    found = []
    for scene_id in plan.scenes or dataset.scene_ids:
        scales: dict[str, float] = {}
        source = None
        for im_id in dataset.image_ids(scene_id):
            path = dataset.depth_path(ImageKey(scene_id, im_id))
            if path is not None:
                source = path.parent
                scales[path.name] = dataset.depth_scale_mm(ImageKey(scene_id, im_id))
        if source is not None and scales:
            found.append(DepthFolder(source, scales))
    if not found:
        raise InputError(f"{plan.root}: {plan.split} has no depth images; choose another split with --split")
    return found


def begin(head: Path, plan: CorrectionPlan) -> None:
    """Write down what is begun, or go on. Raises InputError if it was begun with another correction."""
    wanted = {"a": plan.a, "b": plan.b, "split": plan.split, "scenes": list(plan.scenes), "sensor": plan.sensor}
    if head.is_file():
        begun = read_json_object(head)
        if begun != wanted:
            raise InputError(
                f"{head}: an interrupted run was for a = {begun.get('a')}, b = {begun.get('b')} m or other scenes;"
                " give its command again, or remove the file with what lies beside it"
            )
    write_atomically(head, orjson.dumps(wanted))


def beside(folder: Path, what: str) -> Path:
    """The folder's name with something added: where it is kept as it was, or made anew."""
    return folder.with_name(f"{folder.name}_{what}")


def finish_renames(plan: CorrectionPlan) -> None:
    """Complete what was interrupted between the two renames of a folder."""
    for scene in layout.scene_folders(plan.root / plan.split).values():
        for made in scene.glob("*_corrected.part"):
            source = made.with_name(made.name.removesuffix("_corrected.part"))
            if not source.exists() and not (made / HEAD).exists():
                made.rename(source)


def link_others(root: Path, part: Path, without: set[Path]) -> None:
    """Hard links to, or copies of, all files of the dataset but those in some folders."""
    for folder, names, files in os.walk(root, followlinks=True):
        names[:] = [name for name in names if Path(folder, name) not in without]
        for name in files:
            source = Path(folder, name)
            _link(source.resolve(), part / source.relative_to(root))


def _link(source: Path, target: Path) -> None:
    if target.exists():
        return
    target.parent.mkdir(parents=True, exist_ok=True)
    try:
        os.link(source, target)
    except OSError:  # another file system, or one without links
        temporary = target.with_name(f".{target.name}.part")
        shutil.copy2(source, temporary)
        temporary.replace(target)
