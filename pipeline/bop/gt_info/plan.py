"""What is to be made to complete a dataset's ground-truth information, found out before any work is done."""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from pipeline.bop import layout
from pipeline.bop.dataset import open_dataset
from pipeline.bop.facts import dataset_facts
from pipeline.bop.gt_info.scenes import SCENE_KINDS, SceneKind, ScenePart, find_parts
from pipeline.bop.gt_info.targets import list_path
from pipeline.exceptions import InputError, MissingFileError, UnknownIdError

ListKind = Literal["bop19", "bop24"]
"""Lists of targets for localization and for detection."""

Kind = SceneKind | ListKind

LISTS: tuple[ListKind, ...] = ("bop19", "bop24")
USUAL: tuple[SceneKind, ...] = ("masks", "info", "coco")
"""What every split comes with; those that methods are evaluated on have lists of targets too."""

PBR_DELTA = 0.005
"""Metres; tolerance of the visibility test that BOP took for its photorealistic training images."""


@dataclass(frozen=True)
class GtInfoOptions:
    """What a user asks for."""

    split: str | None = None
    """None: the split that methods are compared on."""
    scenes: tuple[int, ...] = ()
    """Empty: all."""
    sensor: str | None = None
    """None: all sensors that have annotations."""
    kinds: frozenset[Kind] | None = None
    """None: all that are usual."""
    masks: bool = True
    """False: whatever else is asked for, no masks."""
    delta: float | None = None
    """Tolerance of the visibility test, metres; None: the one that BOP took."""


@dataclass(frozen=True, eq=False)
class Plan:
    """All that is to be made."""

    root: Path
    split: str
    sensor: str | None
    """The one that was asked for."""
    kinds: frozenset[Kind]
    delta: float
    """Metres."""
    parts: tuple[ScenePart, ...]
    models: Mapping[int, Path]
    """Model files by object id."""
    obj_ids: tuple[int, ...]
    """All objects of the dataset, annotated here or not."""
    notes: tuple[str, ...]
    """What the user should know beforehand, a line each."""

    @property
    def name(self) -> str:
        """Name of the dataset."""
        return self.root.resolve().name

    @property
    def images(self) -> int:
        """Number of images to look at."""
        return sum(len(part.instances) for part in self.parts) if self.kinds - set(LISTS) else 0

    @property
    def settings(self) -> dict[str, Any]:
        """What an interrupted run must have in common with the one that continues it."""
        parts = [[part.scene_id, part.sensor] for part in self.parts]
        return {"version": 1, "kinds": sorted(self.kinds), "delta": self.delta, "parts": parts}

    def existing(self, kind: Kind) -> list[Path]:
        """Files of a kind that are there and would be written over."""
        if kind == "bop19" or kind == "bop24":
            path = list_path(self.root, self.split, kind)
            return [path] if path.is_file() else []
        return [path for part in self.parts for path in part.existing(kind)]


def make_plan(root: Path, options: GtInfoOptions) -> Plan:
    """Look at the annotations of a split and say what is to be made. Reads all of them, writes nothing.

    Raises InputError where there is nothing to do, and for damaged annotations or cameras, missing models, unknown
    splits, scenes and sensors.
    """
    first = open_dataset(root, options.split, options.sensor)
    parts = tuple(find_parts(root, first.split, options.scenes, options.sensor))
    if not parts:
        raise MissingFileError(f"{root / first.split}: no scene has a scene_gt.json; give the images poses first")
    facts = dataset_facts(first.name)
    kinds, missing = _kinds(root, first.split, options, parts)
    annotated = {obj_id for part in parts for obj_id in part.obj_ids}
    usual_delta = PBR_DELTA if first.split.endswith("_pbr") else facts.vsd_delta
    return Plan(
        root=root,
        split=first.split,
        sensor=options.sensor,
        kinds=kinds,
        delta=usual_delta if options.delta is None else options.delta,
        parts=parts,
        models=_models(root, annotated) if kinds - set(LISTS) else {},
        obj_ids=tuple(sorted({*(facts.obj_ids or first.obj_ids), *annotated})),
        notes=tuple(_notes(parts, missing)),
    )


def check_nothing_is_overwritten(plan: Plan) -> None:
    """Raise InputError that names the first file that exists, counts them, and tells what can be made without it."""
    kinds: tuple[Kind, ...] = (*SCENE_KINDS, *LISTS)
    existing: dict[Kind, list[Path]] = {kind: plan.existing(kind) for kind in kinds if kind in plan.kinds}
    found = [path for paths in existing.values() for path in paths]
    if found:
        count = f"{len(found)} file{'s' * (len(found) > 1)} in all"
        rest = _rest(plan, existing)
        ways = f"make the rest with {rest}, or " if rest else ""
        raise InputError(f"{found[0]}: exists already ({count}); {ways}write over what exists with --force")


def _rest(plan: Plan, existing: Mapping[Kind, list[Path]]) -> str:
    """Options by which only what is missing is made; empty where nothing is, or there is no simple way to say it."""
    free = [kind for kind, paths in existing.items() if not paths]
    if free:
        return f"--only {' '.join(free)}"
    kinds: list[SceneKind] = [kind for kind in SCENE_KINDS if kind in existing]
    taken = {part.scene_id for part in plan.parts for kind in kinds if part.existing(kind)}
    scenes = sorted({part.scene_id for part in plan.parts} - taken)
    return f"--scenes {' '.join(map(str, scenes))} --only {' '.join(kinds)}" if scenes else ""


def _kinds(
    root: Path, split: str, options: GtInfoOptions, parts: tuple[ScenePart, ...]
) -> tuple[frozenset[Kind], Path | None]:
    """What to make, and a missing file because of which lists of targets are not made although they are usual."""
    usual = frozenset[Kind](USUAL if split.startswith("train") else (*USUAL, *LISTS))
    kinds = usual if options.kinds is None else options.kinds
    kinds = kinds if options.masks else kinds - {"masks"}
    if not kinds:
        raise InputError("nothing to make; leave out --no-masks, or name something else with --only")
    missing = next(_missing_infos(root, split, options.sensor, parts if "info" in kinds else ()), None)
    if missing is None or kinds.isdisjoint(LISTS):
        return kinds, None
    if options.kinds is not None and "bop19" in kinds:
        raise MissingFileError(f"{missing}: no such file; lists of targets need it, so make it first (--only info)")
    return (kinds, None) if options.kinds is not None else (kinds - set(LISTS), missing)


def _missing_infos(root: Path, split: str, sensor: str | None, made: Iterable[ScenePart]) -> Iterator[Path]:
    """Files `scene_gt_info.json` that lists of targets need, that do not exist and will not be made."""
    dataset, will_exist = open_dataset(root, split, sensor), {part.json("info") for part in made}
    for scene_id, folder in layout.scene_folders(root / split).items():
        place = layout.SceneLayout(folder, dataset.sensor(scene_id))
        path = place.json("scene_gt_info")
        if place.json("scene_gt").is_file() and path not in will_exist and not path.is_file():
            yield path


def _models(root: Path, obj_ids: Iterable[int]) -> dict[int, Path]:
    """Models as BOP takes them for masks: the original ones, of T-LESS the CAD models; others where there are none."""
    folders = layout.model_folders(root, ("models", "models_cad"))
    files = [layout.model_files(folder) for folder in folders]
    found: dict[int, Path] = {}
    for obj_id in sorted(obj_ids):
        path = next((by_id[obj_id] for by_id in files if obj_id in by_id), None)
        if path is None:
            where = ", ".join(map(str, folders)) or f"{root}, which has no models folder"
            raise UnknownIdError("object", obj_id, where, {i for by_id in files for i in by_id})
        found[obj_id] = path
    return found


def _notes(parts: Iterable[ScenePart], missing: Path | None) -> Iterator[str]:
    images, bare, lost = (
        sum(counts) for counts in zip(*((len(p.instances), p.without_depth, p.not_on_disk) for p in parts), strict=True)
    )
    if bare:
        yield (
            f"{bare} of {images} images have no depth: there, visibility comes from rendering the annotated instances, "
            "and nothing else hides them"
        )
    if lost:
        yield f"{lost} annotated images are not on disk; they are left out"
    if missing is not None:
        yield f"no lists of targets yet: they are of all scenes, and {missing} is missing"
