"""The ground truth of a whole dataset against its images: measures by instance and object, and a list of suspects."""

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

from annotate.quality.agreement import Agreement, Sighting, agreements
from annotate.quality.depth_difference import DepthDifferences, DepthStatistics, pooled
from annotate.quality.evidence import decide
from annotate.quality.instances import InstanceMeasures, measure_instances
from annotate.quality.report import InstanceQuality, ObjectQuality, QualityReport
from annotate.quality.suspects import common_bias, suspects
from pipeline.bop.dataset import Dataset
from pipeline.exceptions import InputError
from pipeline.parallel import HERE, Workers
from pipeline.scene import ImageKey, Model

COMMON_BIAS = 0.003
"""Metres of bias that all instances share from which depth is worth correcting."""
Progress = Callable[[int, int], None]
"""Told how many of how many images are finished."""


@dataclass(frozen=True)
class QualityConfig:
    """What is looked at."""

    scenes: tuple[int, ...] = ()
    """All if empty."""
    contours: bool = True
    """Compare contours with the edges of the colour images."""


def audit(
    dataset: Dataset,
    config: QualityConfig | None = None,
    workers: Workers = HERE,
    progress: Progress | None = None,
) -> QualityReport:
    """Measure all annotated instances of a split. Raises InputError if there is none that could be measured.

    An image that cannot be read is left out and noted. Memory grows with the number of instances, not of pixels.
    """
    config = config or QualityConfig()
    keys = _annotated_images(dataset, config.scenes)
    notes = list(_without_model(dataset, keys))
    instances: list[InstanceQuality] = []
    pools: dict[int, DepthDifferences] = {}
    with_contours = _Measuring(dataset, config.contours)
    for done, (_, found) in enumerate(workers.map_unordered(_measure, keys, with_contours, total=len(keys)), 1):
        if isinstance(found, str):
            notes.append(found)
        else:
            instances += [_quality(measures) for measures in found]
            for measures in found:
                if measures.depth is not None:
                    pools[measures.obj_id] = pools.get(measures.obj_id, DepthDifferences()) + measures.depth
        if progress:
            progress(done, len(keys))
    if not instances:
        reason = notes[-1] if notes else "no object is annotated"
        raise InputError(f"{dataset.root}: nothing to measure in {dataset.split}: {reason}")
    instances.sort(key=lambda instance: (instance.key, instance.index))
    instances = _with_agreement(dataset, instances, workers, notes)
    notes += _gaps(instances)
    objects = tuple(_objects(instances, pools))
    total = ObjectQuality(0, len(instances), _pooled(list(pools.values())))
    ranked = tuple(suspects(instances))
    return QualityReport(dataset.name, dataset.split, objects, total, tuple(instances), ranked, tuple(notes))


@dataclass(frozen=True, eq=False)
class _Measuring:
    """What the measuring of all images has in common."""

    dataset: Dataset
    contours: bool


def _annotated_images(dataset: Dataset, scenes: Sequence[int]) -> list[ImageKey]:
    """Images with annotations, of the chosen scenes. Raises InputError if there is none."""
    chosen = scenes or dataset.scene_ids
    keys = []
    for scene_id in chosen:
        annotated = set(dataset.scene_ground_truth(scene_id).im_ids.tolist()) if _has_truth(dataset, scene_id) else ()
        keys += [ImageKey(scene_id, im_id) for im_id in dataset.image_ids(scene_id) if im_id in annotated]
    if not keys:
        raise InputError(f"{dataset.root}: {dataset.split} has no annotated image; choose another with --split")
    return keys


def _has_truth(dataset: Dataset, scene_id: int) -> bool:
    dataset.image_ids(scene_id)  # tells a scene that is not there
    return dataset.has_ground_truth(scene_id)


def _measure(task: _Measuring, key: ImageKey) -> list[InstanceMeasures] | str:
    """What a worker does: the instances of one image, or why there are none."""
    dataset = task.dataset
    try:
        truths = dataset.ground_truth(key)
        models = {obj_id: dataset.model(obj_id) for obj_id in {truth.obj_id for truth in truths} & _known(dataset)}
        rgb = dataset.rgb(key) if task.contours else None
        return measure_instances(key, truths, models, dataset.camera(key), rgb, dataset.depth(key))
    except InputError as error:
        return str(error)


def _without_model(dataset: Dataset, keys: Sequence[ImageKey]) -> Iterator[str]:
    scenes = {key.scene_id for key in keys}
    annotated = {obj_id for scene in scenes for obj_id in dataset.scene_ground_truth(scene).obj_ids.tolist()}
    if unknown := sorted(annotated - _known(dataset)):
        yield f"objects without a model are left out: {', '.join(map(str, unknown[:20]))}"


def _known(dataset: Dataset) -> set[int]:
    return set(dataset.models.obj_ids)


def _quality(measures: InstanceMeasures) -> InstanceQuality:
    statistics = None if measures.depth is None else measures.depth.statistics()
    return InstanceQuality(
        measures.key, measures.index, measures.obj_id, measures.visible, statistics, measures.contour, None
    )


def _pooled(parts: Sequence[DepthDifferences]) -> DepthStatistics | None:
    return pooled(parts).statistics() if parts else None


def _objects(instances: Sequence[InstanceQuality], pools: dict[int, DepthDifferences]) -> Iterator[ObjectQuality]:
    counts: dict[int, int] = defaultdict(int)
    for instance in instances:
        counts[instance.obj_id] += 1
    for obj_id in sorted(counts):
        yield ObjectQuality(obj_id, counts[obj_id], _pooled([pools[obj_id]] if obj_id in pools else []))


def _gaps(instances: Sequence[InstanceQuality]) -> Iterator[str]:
    """What could not be compared, in words."""
    images = {instance.key for instance in instances}
    bare = {instance.key for instance in instances if instance.depth is None}
    if bare:
        yield f"{len(bare)} of {len(images)} images have no depth: only their contours are compared"
    if not any(instance.agreement for instance in instances):
        yield "no scene has world poses of its cameras and an object in several images: images are not compared"
    bias = common_bias(instances)
    if abs(bias) > COMMON_BIAS:
        side = "behind" if bias > 0 else "before"
        yield f"surfaces are measured {abs(bias) * 1000:.1f} mm {side} their poses as a rule; see inspector depth-correct"


def _with_agreement(
    dataset: Dataset, instances: Sequence[InstanceQuality], workers: Workers, notes: list[str]
) -> list[InstanceQuality]:
    """The instances with what other images of their scene say of them."""
    found = [one for group in _sightings(dataset, instances) for one in agreements(group, _model(dataset, group))]
    questions = [one for one in found if one.expected is not None]
    verdicts = {(one.key, one.index): one for one in found}
    for position, verdict in workers.map_unordered(decide, questions, dataset, total=len(questions)):
        one = questions[position]
        verdicts[one.key, one.index] = replace(one, verdict=verdict)
    notes += _displacements(list(verdicts.values()))
    return [replace(instance, agreement=verdicts.get((instance.key, instance.index))) for instance in instances]


def _displacements(found: Sequence[Agreement]) -> Iterator[str]:
    """Objects that were moved, and images all of whose objects are elsewhere: there the camera's pose is wrong."""
    by_image: dict[ImageKey, list[Agreement]] = defaultdict(list)
    for one in found:
        by_image[one.key].append(one)
    odd = [key for key, own in by_image.items() if len(own) > 1 and all(one.verdict != "agrees" for one in own)]
    if odd:
        yield (
            f"scene {odd[0].scene_id} image {odd[0].im_id}{f' and {len(odd) - 1} more' if len(odd) > 1 else ''}: all"
            " objects are elsewhere than in other images; check the camera's world pose (cam_R_w2c, cam_t_w2c)"
        )
    moved = sum(one.verdict == "moved" and one.key not in odd for one in found)
    if moved:
        yield f"{moved} annotations are of objects that were moved between images: no error"


def _model(dataset: Dataset, group: Sequence[Sighting]) -> Model:
    return dataset.model(group[0].obj_id)


def _sightings(dataset: Dataset, instances: Sequence[InstanceQuality]) -> list[list[Sighting]]:
    """Annotations in world frames, by scene and object."""
    groups: dict[tuple[int, int], list[Sighting]] = defaultdict(list)
    for instance in instances:
        world_from_camera = dataset.camera(instance.key).world_from_camera
        if world_from_camera is not None:
            truth = dataset.scene_ground_truth(instance.key.scene_id).of_image(instance.key.im_id)[instance.index]
            sighting = Sighting(
                instance.key,
                instance.index,
                instance.obj_id,
                world_from_camera @ truth.camera_from_model,
                world_from_camera,
            )
            groups[instance.key.scene_id, instance.obj_id].append(sighting)
    return list(groups.values())
