"""A method's estimates held against the ground truth, one row per annotated instance: for looking at, not for scoring.

The benchmark's matching depends on the threshold of correctness. To look at single cases one wants a fixed partner
for every instance: estimates are taken in the order of their score, and each gets the free ground-truth instance of
its object that is nearest by MSSD, however far that is.
"""

import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.bop import errors
from pipeline.bop.dataset import Dataset
from pipeline.bop.evaluation.matching import assign
from pipeline.bop.results import Results
from pipeline.exceptions import InputError
from pipeline.scene import GroundTruth, ImageKey, Model, PoseEstimate, Target

Progress = Callable[[float], None]
"""Called with the finished share, 0..1."""


NO_OBJECT = 0
"""Object id of a row that stands for an image alone; BOP counts objects from 1."""


MOST_ADI_VERTICES = 100_000
"""Vertices up to which ADI is computed here; models for evaluation have fewer."""


@dataclass(frozen=True)
class Assessment:
    """The rows of one method, in columns; an instance without an estimate has infinite errors, NaN is unknown."""

    method: str
    scene_id: Int[np.ndarray, "n"]
    im_id: Int[np.ndarray, "n"]
    obj_id: Int[np.ndarray, "n"]
    gt_index: Int[np.ndarray, "n"]
    """Index of the instance among the image's annotations; -1 for an estimate that no instance is left for."""
    estimate: Int[np.ndarray, "n"]
    """Row of the results file; -1 where the method gave none."""
    score: Float[np.ndarray, "n"]
    diameter: Float[np.ndarray, "n"]
    """Metres."""
    mssd: Float[np.ndarray, "n"]
    """Metres."""
    mspd: Float[np.ndarray, "n"]
    """Pixels, scaled to an image width of 640 as in BOP."""
    add: Float[np.ndarray, "n"]
    """Metres; ADI for objects with symmetries, NaN for them until `with_adi`."""
    vsd: Float[np.ndarray, "n"]
    """NaN without depth, and until `with_vsd`."""
    visible_fraction: Float[np.ndarray, "n"]
    visibility_estimated: bool = False
    """True where fractions do not come from `scene_gt_info.json` but from `with_visibility`."""
    problems: tuple[str, ...] = ()
    """What could not be assessed, one line each."""

    def __len__(self) -> int:
        return len(self.obj_id)


class _Row(NamedTuple):
    """One row; the fields are the columns of an Assessment, in order."""

    scene_id: int
    im_id: int
    obj_id: int
    gt_index: int
    estimate: int
    score: float
    diameter: float
    mssd: float = np.nan
    mspd: float = np.nan
    add: float = np.nan
    vsd: float = np.nan
    visible_fraction: float = np.nan


def assess(
    dataset: Dataset,
    results: Results | None,
    progress: Progress = lambda _: None,
    so_far: Callable[[Assessment], None] = lambda _: None,
) -> Assessment:
    """Pair the estimates of a results file with the annotated instances and compute MSSD, MSPD and ADD.

    With `results` None the rows are the annotated instances alone. Of the estimates of a target only the
    `inst_count` of highest score count, as in BOP. Images without ground truth give one row per estimate.
    Where there is neither, every image is a row of `NO_OBJECT`.
    Scenes and models that cannot be read are named in `problems`; the others are assessed. `so_far` is given the rows
    that are ready after a second, and again whenever the time has doubled.
    """
    targets = targets_of(dataset, results)
    method = "ground truth" if results is None else results.method or "results"
    rows: list[_Row] = []
    problems: dict[str, None] = {}
    begun, patience = time.monotonic(), 1.0
    for done, target in enumerate(targets):
        try:
            rows += _assess_target(dataset, results, target)
        except InputError as error:
            problems[str(error)] = None
        if done % 64 == 0:
            progress(done / len(targets))
            if time.monotonic() - begun > patience:
                so_far(_assessment(method, rows, problems))
                patience *= 2
    problems |= dict.fromkeys(map(str, dataset.problems()))
    return _assessment(method, rows if targets else _images_alone(dataset), problems)


def with_known(assessment: Assessment, earlier: Assessment) -> Assessment:
    """Take over what an earlier assessment knows of the same pairs: of a run that has grown, all but the new images."""
    before = {pair: row for row, pair in enumerate(_pairs(earlier))}
    places = np.array([before.get(pair, -1) for pair in _pairs(assessment)], dtype=int)
    known = places >= 0
    columns = {}
    for name in ("add", "vsd", "visible_fraction"):
        values = getattr(assessment, name).copy()
        values[known] = getattr(earlier, name)[places[known]]
        columns[name] = values
    return replace(assessment, visibility_estimated=earlier.visibility_estimated, **columns)


def with_adi(
    dataset: Dataset, results: Results, assessment: Assessment, progress: Progress = lambda _: None
) -> Assessment:
    """Fill in ADI for objects with symmetries, which takes about ten times as long as all other errors together.

    It stays unknown for models of so many vertices that one pair may take a minute; `problems` names them.
    """
    values = assessment.add.copy()
    problems = dict.fromkeys(assessment.problems)
    for key, rows in _by_image(assessment, np.isnan(values) & (assessment.estimate >= 0), progress):
        truths = {gt.index: gt for gt in dataset.ground_truth(key)}
        for row in rows[assessment.gt_index[rows] >= 0]:
            model = dataset.model(int(assessment.obj_id[row]))
            if len(model.vertices) > MOST_ADI_VERTICES:
                size = f"{len(model.vertices)} vertices, above {MOST_ADI_VERTICES}"
                problems[f"{dataset.models.path(model.obj_id)}: has {size}: ADI is left out; simplify the mesh"] = None
                continue
            estimate = results.estimate(int(assessment.estimate[row])).camera_from_model
            values[row] = errors.adi(model, estimate, truths[int(assessment.gt_index[row])].camera_from_model)
    return replace(assessment, add=values, problems=tuple(problems))


def with_vsd(
    dataset: Dataset,
    results: Results,
    assessment: Assessment,
    tau: float,
    delta: float,
    progress: Progress = lambda _: None,
) -> Assessment:
    """Fill in VSD (2019) at one misalignment tolerance `tau` and visibility tolerance `delta`, both in metres.

    Rows of images without depth, and without ground truth, stay NaN.
    """
    values = assessment.vsd.copy()
    problems = dict.fromkeys(assessment.problems)
    for key, rows in _by_image(assessment, np.isnan(values) & (assessment.gt_index >= 0), progress):
        try:
            values[rows] = _vsd_of_rows(dataset, results, assessment, key, rows, tau, delta)
        except InputError as error:
            problems[str(error)] = None
    return replace(assessment, vsd=values, problems=tuple(problems))


def with_visibility(dataset: Dataset, assessment: Assessment, progress: Progress = lambda _: None) -> Assessment:
    """Fill in the visible fractions that the dataset does not tell, from the annotated models alone.

    What the annotated objects hide of each other is seen; what anything else hides is not, so the fractions are
    upper bounds.
    """
    unknown = np.isnan(assessment.visible_fraction) & (assessment.gt_index >= 0)
    if not unknown.any():
        return assessment
    fractions = assessment.visible_fraction.copy()
    for key, rows in _by_image(assessment, unknown, progress):
        try:
            visible = _visible_fractions(dataset, key)
        except InputError:
            continue
        for row in rows:
            fractions[row] = visible.get(int(assessment.gt_index[row]), np.nan)
    return replace(assessment, visible_fraction=fractions, visibility_estimated=True)


def targets_of(dataset: Dataset, results: Results | None) -> list[Target]:
    """The dataset's targets, and what a results file claims for images of scenes that have no ground truth.

    Where the list of targets is damaged, the annotated instances are taken.
    """
    try:
        targets = list(dataset.targets())
    except InputError:  # told by `Dataset.problems`
        targets = list(dataset.annotated_targets())
    if results is None:
        return targets
    claimed = np.unique(np.stack([results.scene_id, results.im_id, results.obj_id], axis=1), axis=0, return_counts=True)
    images = {
        scene: frozenset(dataset.image_ids(scene)) for scene in dataset.scene_ids if not _annotated(dataset, scene)
    }
    covered = {target[:3] for target in targets}
    for (scene_id, im_id, obj_id), count in zip(*claimed, strict=True):
        ids = (int(scene_id), int(im_id), int(obj_id))
        if ids not in covered and im_id in images.get(scene_id, ()):
            targets.append(Target(*ids, int(count)))
    return targets


def _images_alone(dataset: Dataset) -> list[_Row]:
    """A row per image, of no object, for data that have neither ground truth nor estimates but can be looked at."""
    return [_Row(*key, NO_OBJECT, -1, -1, np.nan, np.nan) for key in dataset.images()]


def _annotated(dataset: Dataset, scene_id: int) -> bool:
    try:
        return dataset.has_ground_truth(scene_id)
    except InputError:
        return True  # damaged: said elsewhere, and no reason to take its estimates for rows


class _Pairing(NamedTuple):
    """The annotated instances of a target and the rows of the results file held against them."""

    annotations: list[GroundTruth]
    partners: list[int]
    """Row of the results file for each annotation, -1 where there is none."""
    mssd: list[float]
    """Metres, of each pair; infinite without a partner."""
    extra: list[int]
    """Rows of the results file that no annotation is left for."""


def pair(dataset: Dataset, results: Results, target: Target) -> list[tuple[GroundTruth, PoseEstimate | None]]:
    """The annotated instances of a target, each with the estimate that is held against it (None: none was left)."""
    found = _pair(dataset, results, target)
    return [
        (gt, results.estimate(row) if row >= 0 else None)
        for gt, row in zip(found.annotations, found.partners, strict=True)
    ]


def _pair(dataset: Dataset, results: Results | None, target: Target) -> _Pairing:
    annotations = [gt for gt in dataset.ground_truth(target.image) if gt.obj_id == target.obj_id]
    if len(annotations) > target.inst_count:  # BOP19: the most visible ones
        annotations.sort(key=lambda gt: -(gt.visible_fraction or 0.0))
        annotations = sorted(annotations[: target.inst_count], key=lambda gt: gt.index)
    rows = _best_estimates(results, target)
    model = dataset.model(target.obj_id)
    distances = np.full((len(rows), len(annotations)), np.inf)
    for e, row in enumerate(rows):
        assert results is not None
        found = results.estimate(row).camera_from_model
        distances[e] = [errors.mssd(model, found, gt.camera_from_model).value for gt in annotations]
    partners = assign(distances)
    return _Pairing(
        annotations,
        [rows[e] if e >= 0 else -1 for e in partners],
        [float(distances[e, g]) if e >= 0 else np.inf for g, e in enumerate(partners)],
        [row for e, row in enumerate(rows) if e not in partners],
    )


def _assess_target(dataset: Dataset, results: Results | None, target: Target) -> list[_Row]:
    pairing = _pair(dataset, results, target)
    model, camera = dataset.model(target.obj_id), dataset.camera(target.image)
    symmetric = len(model.symmetries) > 1
    rows = []
    for gt, partner, mssd in zip(pairing.annotations, pairing.partners, pairing.mssd, strict=True):
        row = _row(target, gt, model)
        if results is not None:
            row = row._replace(mssd=mssd, mspd=np.inf, add=np.inf)
        if results is not None and partner >= 0:
            estimate = results.estimate(partner)
            poses = estimate.camera_from_model, gt.camera_from_model
            mspd = errors.mspd(model, camera.K, *poses).value * 640 / camera.width
            add = np.nan if symmetric else errors.add(model, *poses)
            row = row._replace(estimate=partner, score=estimate.score, mspd=mspd, add=add)
        rows.append(row)
    for extra in pairing.extra:
        assert results is not None
        rows.append(_row(target, None, model)._replace(estimate=extra, score=results.estimate(extra).score))
    return rows


def _best_estimates(results: Results | None, target: Target) -> list[int]:
    """Rows of the results file for the target, the `inst_count` of highest score."""
    if results is None:
        return []
    return [int(row) for row in results.rows(target.image, target.obj_id)[: target.inst_count]]


def _row(target: Target, gt: GroundTruth | None, model: Model) -> _Row:
    visible = gt.visible_fraction if gt is not None else None
    return _Row(
        *target[:3],
        gt_index=-1 if gt is None else gt.index,
        estimate=-1,
        score=np.nan,
        diameter=model.diameter,
        visible_fraction=np.nan if visible is None else visible,
    )


def _assessment(method: str, rows: list[_Row], problems: Iterable[str]) -> Assessment:
    return Assessment(method=method, problems=tuple(problems), visibility_estimated=False, **_columns(rows))


def _columns(rows: list[_Row]) -> dict[str, np.ndarray]:
    kinds = {name: np.int64 if kind is int else np.float64 for name, kind in _Row.__annotations__.items()}
    values = zip(*rows, strict=True) if rows else ((),) * len(kinds)
    return {name: np.array(column, kind) for (name, kind), column in zip(kinds.items(), values, strict=True)}


def _pairs(assessment: Assessment) -> list[tuple[int, ...]]:
    a = assessment
    columns = (a.scene_id, a.im_id, a.obj_id, a.gt_index, a.estimate)
    return list(zip(*(column.tolist() for column in columns), strict=True))


def _by_image(
    assessment: Assessment, wanted: Bool[np.ndarray, "n"], progress: Progress
) -> Iterator[tuple[ImageKey, Int[np.ndarray, "k"]]]:
    """Yield each image with its wanted rows."""
    rows = np.flatnonzero(wanted)
    keys = np.stack([assessment.scene_id[rows], assessment.im_id[rows]], axis=1)
    images, group = np.unique(keys, axis=0, return_inverse=True)
    order = np.argsort(group, kind="stable")
    parts = np.split(rows[order], np.searchsorted(group[order], np.arange(1, len(images))))
    for done, (image, part) in enumerate(zip(images, parts, strict=False)):
        progress(done / len(images))
        yield ImageKey(int(image[0]), int(image[1])), part


def _vsd_of_rows(
    dataset: Dataset,
    results: Results,
    assessment: Assessment,
    key: ImageKey,
    rows: Int[np.ndarray, "k"],
    tau: float,
    delta: float,
) -> Float[np.ndarray, "k"]:
    """VSD of rows of one image; NaN without depth, 1 without an estimate."""
    from pipeline.bop.vsd import vsd_of_poses

    depth = dataset.depth(key)
    if depth is None:
        return np.full(len(rows), np.nan)
    camera, truths = dataset.camera(key), {gt.index: gt for gt in dataset.ground_truth(key)}
    values = np.ones(len(rows))
    for place in np.flatnonzero(assessment.estimate[rows] >= 0):
        row = rows[place]
        model = dataset.model(int(assessment.obj_id[row]))
        estimate = results.estimate(int(assessment.estimate[row])).camera_from_model
        truth = truths[int(assessment.gt_index[row])].camera_from_model
        share = tau / model.diameter  # the tolerance is a fraction of the diameter there
        values[place] = vsd_of_poses(model, camera, estimate, truth, depth, [share], delta).values[0]
    return values


def _visible_fractions(dataset: Dataset, key: ImageKey) -> dict[int, float]:
    """Visible share of each annotated instance's silhouette, hidden only by the other annotated instances."""
    from pipeline.rendering import render_scene

    annotations = dataset.ground_truth(key)
    scene = render_scene([(dataset.model(gt.obj_id), gt.camera_from_model) for gt in annotations], dataset.camera(key))
    fractions = {}
    for position, (gt, alone) in enumerate(zip(annotations, scene.renderings, strict=True)):
        whole = np.count_nonzero(alone.mask_crop)
        seen = np.count_nonzero(scene.instance_ids[alone.box.slices] == position)
        fractions[gt.index] = seen / whole if whole else 0.0
    return fractions


assert tuple(_Row._fields) == tuple(f.name for f in fields(Assessment))[1:13]
