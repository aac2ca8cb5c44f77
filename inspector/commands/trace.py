"""`inspector trace`: why a run found or lost an annotated instance."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import orjson
from rich.console import Console
from rich.markup import escape
from rich.table import Table
from tyro.conf import Positional

from pipeline.exceptions import InputError, UnknownIdError

if TYPE_CHECKING:
    from pipeline.bop.dataset import Dataset
    from pipeline.explaining import Evidence, Explanation
    from pipeline.run import Run
    from pipeline.scene import ImageKey

TRACEABLE = ("hashmatch",)
"""Methods that can say why they lose an instance."""


@dataclass(frozen=True)
class TraceConfig:
    """Say at which stage a run lost an annotated instance, and by how much."""

    run: Positional[Path]
    """Folder of a run."""
    scene: int
    """Id of the scene."""
    image: int
    """Id of the image."""
    gt: int | None = None
    """Index of the instance in the annotation of the image; by default all that were sought."""
    json: bool = False
    """Print JSON: an object for one instance, a list for all."""
    dataset: Path | None = None
    """Folder of the dataset, where it has moved since the run."""


def run(config: TraceConfig, console: Console | None = None) -> int:
    """Print what became of an instance, or of all of an image, and return 0. InputError is left to the caller."""
    from pipeline.run import Run
    from pipeline.scene import ImageKey

    console = console or Console()
    opened, key = Run.open(config.run), ImageKey(config.scene, config.image)
    _check(opened, key)
    found = _explanations(opened, key, config.dataset)
    chosen = _chosen(found, config.gt, key)
    if config.json:
        content = [one.as_dict() for one in chosen]
        text = orjson.dumps(
            content if config.gt is None else content[0], option=orjson.OPT_INDENT_2 | orjson.OPT_SERIALIZE_NUMPY
        )
        console.out(text.decode(), highlight=False)
    elif config.gt is None:
        _show_all(chosen, key, console)
    else:
        _show(chosen[0], key, console)
    return 0


def _check(run: "Run", key: "ImageKey") -> None:
    """Raise InputError for a run that cannot be traced, or an image that it does not have."""
    root, method = run.root, run.info.method
    if method not in TRACEABLE:
        known = ", ".join(TRACEABLE)
        raise InputError(f"{root}: is a run of {method}, which cannot be traced; give a run of {known}")
    finished = {image.key: image for image in run.finished()}
    if not finished:
        raise InputError(f"{root}: has no finished images yet; go on with it by `inspector run`")
    scenes = {own.scene_id for own in finished}
    if key.scene_id not in scenes:
        raise UnknownIdError("scene", key.scene_id, str(root), scenes)
    if key not in finished:
        images = [own.im_id for own in finished if own.scene_id == key.scene_id]
        raise UnknownIdError("image", key.im_id, f"scene {key.scene_id} of {root}", images)
    failure = finished[key].failure
    if failure is not None:
        raise InputError(f"{root}: {method} failed on this image: {failure}")


def _explanations(run: "Run", key: "ImageKey", moved: Path | None) -> "dict[int, Explanation]":
    """Those that were recorded; else they are computed again, which gives the same."""
    from pipeline.explaining import recorded_explanations
    from pipeline.recording import RecordingReader

    path = run.recording_path(key)
    recorded = recorded_explanations(RecordingReader.open(path)) if path.exists() else {}
    return recorded or _computed_again(run, key, moved)


def _computed_again(run: "Run", key: "ImageKey", moved: Path | None) -> "dict[int, Explanation]":
    from inspector.methods import METHODS
    from pipeline.bop.dataset import open_dataset
    from pipeline.explaining import explain_targets, explained
    from pipeline.kept_settings import settings_of
    from pipeline.recording import NullRecorder

    dataset = open_dataset(moved or Path(run.info.dataset_root), run.info.dataset_split)
    truths, image = dataset.ground_truth(key), dataset.image(key)
    if not truths:
        where = f"scene {key.scene_id}, image {key.im_id}"
        raise InputError(f"{dataset.root}: {where} has no ground truth, so nothing can be traced; choose another image")
    method = METHODS[run.info.method]
    settings: Any = settings_of(method.settings, run.info.config)
    targets = _targets(dataset, key, settings)
    with Console(stderr=True).status("computing again what the run saw, as it was not recorded"):
        _, explain = explained(method.make(settings, dataset), image, targets, NullRecorder())
        assert explain is not None
        found = explain_targets(explain, truths, targets, dataset.model, NullRecorder())
    return {one.gt_index: one for one in found}


def _targets(dataset: "Dataset", key: "ImageKey", settings: Any) -> list[Any]:
    """What was sought in the image: the dataset's targets, else what is annotated, of the objects of the run."""
    listed = [target for target in dataset.targets() if target.image == key]
    targets = listed or [target for target in dataset.annotated_targets() if target.image == key]
    objects = getattr(settings, "objects", ())
    return [target for target in targets if not objects or target.obj_id in objects]


def _chosen(found: "Mapping[int, Explanation]", gt: int | None, key: "ImageKey") -> "list[Explanation]":
    if gt is None:
        return list(found.values())
    if gt not in found:
        where = f"what was sought in scene {key.scene_id}, image {key.im_id}"
        raise UnknownIdError("ground-truth instance", gt, where, found)
    return [found[gt]]


def _show_all(found: "list[Explanation]", key: "ImageKey", console: Console) -> None:
    table = Table(
        "gt", "object", "lost at", "why", title=f"scene {key.scene_id}, image {key.im_id}", title_justify="left"
    )
    for one in found:
        table.add_row(str(one.gt_index), str(one.obj_id), _colored(one.stage), escape(one.verdict))
    console.print(table)


def _show(one: "Explanation", key: "ImageKey", console: Console) -> None:
    where = f"scene {key.scene_id}, image {key.im_id}, instance {one.gt_index}"
    console.print(f"[bold]{where}[/] (object {one.obj_id}): {_colored(one.stage)}", highlight=False)
    console.print(escape(one.verdict), highlight=False, soft_wrap=True)
    table = Table("", "", "found", "limit", "", box=None, padding=(0, 2, 0, 0))
    for evidence in one.evidence:
        table.add_row(_mark(evidence), evidence.name, _number(evidence.value), _number(evidence.limit), evidence.unit)
    console.print(table)


def _mark(evidence: "Evidence") -> str:
    return {True: "[green]✓[/]", False: "[red]✗[/]", None: ""}[evidence.passed]


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:g}" if float(value).is_integer() else f"{value:.3g}"


def _colored(stage: str) -> str:
    return "[green]found[/]" if stage == "found" else f"[red]lost at {stage}[/]"
