"""The part of `benchmarks/hashmatch.py` that counts which instances are found."""

import time
from collections import Counter, defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from hashmatch_registration import registered
from rich.console import Console
from rich.table import Table

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.errors import mspd, mssd
from pipeline.bop.vsd import vsd_of_poses
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.estimator import Found, HashMatchEstimator
from pipeline.hashmatch.proposals import Instance
from pipeline.hashmatch.selection import choose_rough, estimate_instances
from pipeline.hashmatch.trace import trace
from pipeline.rendering import render
from pipeline.scene import GroundTruth, Image, ImageKey, Target

ALL_AROUND = HashMatchConfig(views="sphere", in_plane="circle")
"""All orientations."""

LEAST_VISIBLE = 0.1

REFINED, ROUGH, OTHER = "HashMatch", "HashMatch, rough poses", "FPFH + RANSAC + ICP"

Poses = Sequence[tuple[int, np.ndarray]]


@dataclass(frozen=True)
class Recall:
    """Recall with and without refinement, and of Open3D's global registration; both kinds of poses come from one matching."""

    data: Path = Path("assets/demo")
    """A BOP dataset with depth."""
    images: int = 0
    """Images, evenly chosen among those with depth; 0 takes all."""
    scene: int | None = None
    """Only this scene."""
    cache: Path | None = None
    """Folder for templates; by default a temporary one."""
    thesis_views: bool = False
    """Templates of the upper hemisphere, as in the thesis."""
    objects: tuple[int, ...] = ()
    """Objects sought where there is no ground truth; all, by default."""
    count: int = 1
    """Instances of each, there."""
    compare: bool = False
    """Run Open3D's global registration, too."""
    why: bool = False
    """Say of each lost instance where it was lost."""
    pictures: Path | None = None
    """Folder for a picture of each image: outlines of the estimates, green where right, else red, blue if unknown."""
    config: HashMatchConfig | None = None
    """All parameters; those of the whole sphere or the thesis by default."""


class Hit(NamedTuple):
    """How near the best estimate of its object is to an instance."""

    key: ImageKey
    obj_id: int
    visible: float
    vsd: float
    mssd: float
    """Of the diameter."""
    mspd: float
    """Pixels, for an image 640 px wide."""

    @property
    def found(self) -> bool:
        """The measure of the BOP Challenge 2017."""
        return self.vsd < 0.3


def recall(options: Recall, cache: Path, console: Console) -> None:
    """Estimate the targets of a dataset and compare with its ground truth."""
    dataset = open_dataset(options.data)
    config = options.config or (HashMatchConfig() if options.thesis_views else ALL_AROUND)
    keys = [key for key in dataset.images() if options.scene in (None, key.scene_id)]
    keys = some([key for key in keys if dataset.depth_path(key) is not None], options.images)
    sought = {key: _targets(dataset, key, options) for key in keys}
    ids = sorted({target.obj_id for targets in sought.values() for target in targets})
    begun = time.process_time()
    estimator = HashMatchEstimator.of_dataset(dataset, replace(config, cache=cache), ids)
    console.print(f"{len(ids)} objects learned or loaded in {time.process_time() - begun:.0f} core-s")
    hits: dict[str, list[Hit]] = {name: [] for name in (REFINED, ROUGH, OTHER)}
    seconds: defaultdict[str, float] = defaultdict(float)
    for key in keys:
        image, truths = dataset.image(key), _truths(dataset, key)
        found, rough = _found(estimator, image, sought[key], seconds)
        poses = _poses(estimator, found.chosen)
        hits[REFINED] += [_hit(dataset, image, gt, visible, poses) for gt, visible in truths]
        hits[ROUGH] += [_hit(dataset, image, gt, visible, _poses(estimator, rough)) for gt, visible in truths]
        if options.compare:
            begun = time.process_time()
            others = [one for target in sought[key] for one in registered(dataset.model(target.obj_id), image, target)]
            seconds[OTHER] += time.process_time() - begun
            hits[OTHER] += [_hit(dataset, image, gt, visible, others) for gt, visible in truths]
        own = hits[REFINED][len(hits[REFINED]) - len(truths) :]
        _report(console, key, own, found)
        if options.why:
            _explain(console, estimator, found, [gt for gt, _ in truths], own)
        if options.pictures:
            _draw(options.pictures, dataset, image, poses, truths, own)
    instances = sum(target.inst_count for targets in sought.values() for target in targets)
    console.print(
        f"refinement: {(seconds[REFINED] - seconds[ROUGH]) / max(instances, 1):.2f} core-s per instance sought"
    )
    console.print(_table(hits, seconds, len(keys)))


def _found(
    estimator: HashMatchEstimator, image: Image, targets: Sequence[Target], seconds: dict[str, float]
) -> tuple[Found, list[Instance]]:
    """What is found, and the rough poses that would be reported without refinement; adds core-seconds of both."""
    detector, positions = estimator.detector, {own.obj_id: i for i, own in enumerate(estimator.detector.objects)}
    counts = {positions[target.obj_id]: target.inst_count for target in targets}
    models = [estimator.models[own.obj_id] for own in detector.objects]
    begun, core = time.perf_counter(), time.process_time()
    matching = detector.match(image, np.isin(np.arange(len(models)), list(counts)))
    matched = time.perf_counter()
    seconds[ROUGH] += time.process_time() - core
    proposed, chosen = estimate_instances(detector, matching, models, counts)
    seconds[REFINED] += time.process_time() - core
    wall = {"matching": matched - begun, "refinement": time.perf_counter() - matched}
    return Found(matching, proposed, chosen, wall), choose_rough(detector, matching, counts)[1]


def _poses(estimator: HashMatchEstimator, instances: Sequence[Instance]) -> list[tuple[int, np.ndarray]]:
    return [(estimator.detector.objects[one.position].obj_id, one.pose) for one in instances]


def _targets(dataset: Dataset, key: ImageKey, options: Recall) -> list[Target]:
    """Instances by object: those that are visible enough, or what the options say where no ground truth is known."""
    truths = dataset.ground_truth(key)
    if not truths:
        return [Target(*key, obj_id, options.count) for obj_id in options.objects or dataset.obj_ids]
    counts = Counter(gt.obj_id for gt, _ in _truths(dataset, key))
    return [Target(*key, obj_id, count) for obj_id, count in sorted(counts.items())]


def _truths(dataset: Dataset, key: ImageKey) -> list[tuple[GroundTruth, float]]:
    """Instances that are visible enough, and how visible they are."""
    fractions = [(gt, _visible(dataset, key, gt)) for gt in dataset.ground_truth(key)]
    return [(gt, visible) for gt, visible in fractions if visible >= LEAST_VISIBLE]


def _visible(dataset: Dataset, key: ImageKey, gt: GroundTruth) -> float:
    """Visible share of an instance; where it is not annotated, by the depth image (delta 15 mm)."""
    if gt.visible_fraction is not None:
        return gt.visible_fraction
    depth = dataset.depth(key)
    assert depth is not None
    rendering = render(dataset.model(gt.obj_id), dataset.camera(key), gt.camera_from_model, pixel_center=0.0)
    measured, mask = depth[rendering.box.slices], rendering.mask_crop
    in_front = (measured > 0) & (measured < rendering.depth_crop - 0.015)
    return float((mask & ~in_front).sum() / max(mask.sum(), 1))


def _hit(dataset: Dataset, image: Image, gt: GroundTruth, visible: float, poses: Poses) -> Hit:
    model, K = dataset.model(gt.obj_id), image.camera.K
    assert image.depth is not None
    errors = [(
        vsd_of_poses(model, image.camera, pose, gt.camera_from_model, image.depth, [0.02 / model.diameter],
                     delta=0.015, variant="bop18").values[0],
        mssd(model, pose, gt.camera_from_model).value / model.diameter,
        mspd(model, K, pose, gt.camera_from_model).value * 640 / image.camera.width,
    ) for obj_id, pose in poses if obj_id == gt.obj_id]  # fmt: skip
    best = np.min(errors, axis=0) if errors else np.full(3, np.inf)
    return Hit(image.key, gt.obj_id, visible, *best.tolist())


def _report(console: Console, key: ImageKey, hits: list[Hit], found: Found) -> None:
    counted = f"{sum(hit.found for hit in hits)}/{len(hits)} found" if hits else f"{len(found.chosen)} estimates"
    seen = [hit for hit in hits if hit.visible > 0.6]
    text = f"scene {key.scene_id}, image {key.im_id}: {counted}"
    text += f", of those > 60 % visible {sum(hit.found for hit in seen)}/{len(seen)}" if hits else ""
    if not hits:
        text += " (" + ", ".join(f"{one.score:.2f}" for one in found.chosen) + ")"
    for kind, seconds in (("core-s", found.matching.seconds), ("wall s", found.seconds)):
        text += f"; {kind}: " + ", ".join(f"{stage} {value:.1f}" for stage, value in seconds.items())
    console.print(text)


def _explain(
    console: Console, estimator: HashMatchEstimator, found: Found, truths: list[GroundTruth], hits: list[Hit]
) -> None:
    for gt, hit in zip(truths, hits, strict=True):
        if not hit.found:
            told = trace(estimator.detector, found.matching, gt, estimator.models[gt.obj_id], found.proposed,
                         found.chosen)  # fmt: skip
            console.print(f"    {hit.visible:.0%} visible, lost at {told.stage}: {told.verdict}")


def _draw(
    folder: Path, dataset: Dataset, image: Image, poses: Poses, truths: list[tuple[GroundTruth, float]], hits: list[Hit]
) -> None:
    """The image with the outlines of the estimates; lost instances are outlined in yellow."""
    folder.mkdir(parents=True, exist_ok=True)
    canvas = np.zeros((image.camera.height, image.camera.width, 3), np.uint8) if image.rgb is None else image.rgb.copy()
    for (gt, _), hit in zip(truths, hits, strict=True):
        if not hit.found:
            _outline(canvas, dataset, image, gt.obj_id, gt.camera_from_model, (255, 210, 0))
    for obj_id, pose in poses:
        right = [
            mssd(dataset.model(obj_id), pose, gt.camera_from_model).value < 0.3 * dataset.model(obj_id).diameter
            for gt, _ in truths
            if gt.obj_id == obj_id
        ]
        color = (60, 120, 255) if not truths else (0, 220, 60) if any(right) else (240, 40, 40)
        _outline(canvas, dataset, image, obj_id, pose, color)
    cv2.imwrite(str(folder / f"{image.key.scene_id:06d}_{image.key.im_id:06d}.png"), canvas[..., ::-1])


def _outline(
    canvas: np.ndarray, dataset: Dataset, image: Image, obj_id: int, pose: np.ndarray, color: tuple[int, int, int]
) -> None:
    rendering = render(dataset.model(obj_id), image.camera, pose, pixel_center=0.0)
    offset = (rendering.box.x0, rendering.box.y0)
    contours, _ = cv2.findContours(
        rendering.mask_crop.astype(np.uint8), cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE, offset=offset
    )
    cv2.drawContours(canvas, contours, -1, color, 1, cv2.LINE_AA)
    at = tuple(np.clip(np.array(offset) + 4, 0, None).tolist())
    cv2.putText(canvas, str(obj_id), at, cv2.FONT_HERSHEY_SIMPLEX, 0.4, color, 1, cv2.LINE_AA)


def _table(hits: dict[str, list[Hit]], seconds: Mapping[str, float], images: int) -> Table:
    all_hits = [hit for own in hits.values() for hit in own]
    scenes = sorted({hit.key.scene_id for hit in all_hits})
    columns = ["method", "found", "recall", "> 60 % visible", "AR MSSD", "AR MSPD", *(f"scene {s}" for s in scenes)]
    table = Table(*columns, "core-s per image")
    for name, own in hits.items():
        if not own:
            continue
        seen = [hit.found for hit in own if hit.visible > 0.6]
        ar_mssd = np.mean([[hit.mssd < 0.05 * i for i in range(1, 11)] for hit in own])
        ar_mspd = np.mean([[hit.mspd < 5 * i for i in range(1, 11)] for hit in own])
        by_scene = [[hit.found for hit in own if hit.key.scene_id == scene] for scene in scenes]
        table.add_row(
            name, f"{sum(hit.found for hit in own)}/{len(own)}", f"{np.mean([hit.found for hit in own]):.3f}",
            f"{sum(seen)}/{len(seen)}", f"{ar_mssd:.3f}", f"{ar_mspd:.3f}",
            *(f"{np.mean(scene):.3f}" if scene else "-" for scene in by_scene),
            f"{seconds[name] / max(images, 1):.1f}",
        )  # fmt: skip
    return table


def some(keys: list[ImageKey], count: int) -> list[ImageKey]:
    """So many of the images, evenly chosen; 0 takes all."""
    if not count or count >= len(keys):
        return keys
    return [keys[i] for i in np.linspace(0, len(keys) - 1, count).astype(int)]
