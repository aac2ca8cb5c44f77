"""Checks of poses by themselves: units, rotations, in front of the camera, annotated once; results files too."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.bop.annotations import SceneGroundTruth
from pipeline.bop.doctor.findings import Finding, count_of, ok, some
from pipeline.bop.doctor.survey import SceneSurvey, Survey
from pipeline.bop.results import Results, read_results
from pipeline.exceptions import InputError

NEAREST_MM, FARTHEST_MM = 10.0, 50_000.0
"""Plausible distances of an object from the camera: one below is surely in metres."""
ROTATION_NOTE, ROTATION_WARNING, ROTATION_ERROR = 1e-4, 2e-2, 1e-1
"""Largest entry of |R R^T - I|. LM-O's published poses reach 9.6e-3; rounding to six digits gives 1e-6."""
HIDDEN = 0.1
"""Visible fraction below which an object need not be in the image."""


class Annotations(NamedTuple):
    """All annotations that are looked at and whose image has a camera."""

    poses: Float[np.ndarray, "n 4 4"]
    """camera_from_model, metres."""
    K: Float[np.ndarray, "n 3 3"]
    sizes: Float[np.ndarray, "n 2"]
    """Width and height of the image in pixels, NaN where unknown."""
    diameters: Float[np.ndarray, "n"]
    """Metres, NaN where unknown."""
    hidden: Bool[np.ndarray, "n"]
    """Whether the object is said to be hardly visible; False where unknown."""
    names: list[str]


def _annotations(survey: Survey) -> Annotations | None:
    """The annotations of all scenes; None if there are none."""
    parts = [_scene_annotations(survey, scene, scene.ground_truth) for scene in survey.scenes if scene.ground_truth]
    parts = [part for part in parts if part.names]
    if not parts:
        return None
    *arrays, names = zip(*parts, strict=True)
    return Annotations(*map(np.concatenate, arrays), names=[name for part in names for name in part])


def _scene_annotations(survey: Survey, scene: SceneSurvey, gt: SceneGroundTruth) -> Annotations:
    chosen = np.isin(gt.im_ids, list(scene.cameras.rows))
    ids = list(zip(gt.im_ids[chosen].tolist(), gt.obj_ids[chosen].tolist(), strict=True))
    diameters = {obj_id: survey.diameter(obj_id) for obj_id in {obj_id for _, obj_id in ids}}
    return Annotations(
        poses=gt.camera_from_model[chosen],
        K=scene.cameras.K[[scene.cameras.rows[im_id] for im_id, _ in ids]],
        sizes=np.tile(np.array(scene.size or (np.nan, np.nan)), (len(ids), 1)),
        diameters=np.array([diameters[obj_id] for _, obj_id in ids]),
        hidden=gt.visible_fraction[chosen] < HIDDEN,
        names=[f"scene {scene.scene_id} image {im_id} object {obj_id}" for im_id, obj_id in ids],
    )


def _named(names: list[str], chosen: Bool[np.ndarray, "n"]) -> str:
    return some([names[i] for i in np.flatnonzero(chosen)], 3)


def check_pose_units(survey: Survey) -> Iterator[Finding]:
    """Whether translations are in millimetres, judged by the distance from the camera."""
    if found := _annotations(survey):
        yield from _judge_distances(found.poses, "scene_gt.json", "cam_t_m2c", "Poses")


def _judge_distances(poses: Float[np.ndarray, "n 4 4"], subject: str, what: str, title: str) -> Iterator[Finding]:
    distances = np.linalg.norm(poses[:, :3, 3], axis=1) * 1000.0
    near, far = distances < NEAREST_MM, distances > FARTHEST_MM
    of_all = f"of {count_of(len(poses), 'pose')} are"
    if near.any():
        evidence = f"{near.sum()} {of_all} {np.median(distances[near]):.3g} mm from the camera (median)"
        fix = f"multiply {what} by 1000: BOP translations are in millimetres"
        yield Finding("error", f"{title} in metres", subject, evidence, fix)
    if far.any():
        evidence = f"{far.sum()} {of_all} {np.median(distances[far]) / 1000:.3g} m from the camera (median)"
        fix = f"divide {what} by the right power of ten: BOP translations are in millimetres"
        yield Finding("error", f"{title} too far away", subject, evidence, fix)
    if not near.any() and not far.any():
        span = f"{distances.min():.0f} to {distances.max():.0f} mm"
        yield ok(f"{title}: units", f"{count_of(len(poses), 'pose')}, {span} from the camera", subject)


def check_apparent_size(survey: Survey) -> Iterator[Finding]:
    """Whether objects are neither around the camera nor smaller than a pixel, which mixed units bring about."""
    found = _annotations(survey)
    if found is None:
        return
    distances = np.maximum(np.linalg.norm(found.poses[:, :3, 3], axis=1), 1e-9)
    pixels = found.K[:, 0, 0] * found.diameters / distances
    cases = (
        ("Camera inside objects", "within 0.3 diameters of the camera", distances < 0.3 * found.diameters),
        ("Objects smaller than 2 pixels", "smaller than 2 pixels", pixels < 2.0),
    )
    for title, text, wrong in cases:
        if wrong.any():
            evidence = f"{wrong.sum()} of {count_of(len(pixels), 'object')} are {text}: {_named(found.names, wrong)}"
            fix = "bring models and cam_t_m2c to the same unit, millimetres"
            yield Finding("error" if wrong.mean() > 0.5 else "warning", title, "scene_gt.json", evidence, fix)
    if not any(wrong.any() for *_, wrong in cases) and np.isfinite(pixels).any():
        span = f"{np.nanmin(pixels):.0f} to {np.nanmax(pixels):.0f} pixels"
        yield ok("Apparent size", f"{count_of(len(pixels), 'object')} appear {span} large", "scene_gt.json")


def check_rotations(survey: Survey) -> Iterator[Finding]:
    """Whether rotation matrices are orthonormal and right-handed."""
    if found := _annotations(survey):
        yield from _judge_rotations(found.poses[:, :3, :3], "scene_gt.json", found.names)


def _judge_rotations(R: Float[np.ndarray, "n 3 3"], subject: str, names: list[str]) -> Iterator[Finding]:
    mirrored = np.linalg.det(R) <= 0
    deviations = np.abs(R @ R.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    worst = float(deviations.max())
    if mirrored.any():
        evidence = f"{mirrored.sum()} of {len(R)} have a determinant of 0 or less: {_named(names, mirrored)}"
        fix = "negate one axis of these matrices: the tool that wrote them mixed left- and right-handed frames"
        yield Finding("error", "Mirrored rotations", subject, evidence, fix)
    if worst > ROTATION_NOTE:
        yield _not_orthonormal(R, deviations, subject, names)
    elif not mirrored.any():
        yield ok("Rotations", f"{len(R)} matrices, |R R^T - I| at most {worst:.1e}", subject)


def _not_orthonormal(R: np.ndarray, deviations: np.ndarray, subject: str, names: list[str]) -> Finding:
    worst = int(np.argmax(deviations))
    deviation = deviations[worst]
    stretch = np.abs(np.linalg.svd(R[worst], compute_uv=False) - 1.0).max()
    evidence = (
        f"{(deviations > ROTATION_NOTE).sum()} of {len(R)}: |R R^T - I| up to {deviation:.1e} ({names[worst]}), "
        f"which stretches the object by {stretch:.1%}"
    )
    fix = "replace R by the nearest rotation (U V^T of its SVD)"
    if deviation > ROTATION_WARNING:
        severity = "error" if deviation > ROTATION_ERROR else "warning"
        return Finding(severity, "Rotations not orthonormal", subject, evidence, fix)
    fix = f"nothing to do: evaluation takes the matrices as they are, as BOP's does; else {fix}"
    return Finding("note", "Rotations not quite orthonormal", subject, evidence, fix)


def check_in_view(survey: Survey) -> Iterator[Finding]:
    """Whether annotated objects are before the camera and inside the image, unless they are said to be hidden."""
    found = _annotations(survey)
    if found is None:
        return
    subject, of_all = "scene_gt.json", f"of {count_of(len(found.names), 'object')}"
    behind = (found.poses[:, 2, 3] <= 0) & ~found.hidden
    outside = _outside(found) & ~found.hidden & ~behind
    if behind.any():
        evidence = f"{behind.sum()} {of_all} have z <= 0: {_named(found.names, behind)}"
        fix = "the camera looks along +z (OpenCV); negate y and z of poses that come from OpenGL tools"
        yield Finding("error", "Objects behind the camera", subject, evidence, fix)
    if outside.any():
        evidence = f"{outside.sum()} {of_all} lie wholly outside the image: {_named(found.names, outside)}"
        fix = "check cam_K and the poses of these images, or remove the annotations"
        severity = "error" if outside.mean() > 0.5 else "warning"
        yield Finding(severity, "Objects outside the image", subject, evidence, fix)
    if not behind.any() and not outside.any():
        yield ok("Objects in view", f"{count_of(len(behind), 'object')} before the camera and in the image", subject)


def _outside(found: Annotations) -> Bool[np.ndarray, "n"]:
    """Whether even a ball of the object's diameter around its origin would be outside of the image."""
    t = found.poses[:, :3, 3]
    depth = np.maximum(t[:, 2], 1e-6)
    u = found.K[:, 0, 0] * t[:, 0] / depth + found.K[:, 0, 2]
    v = found.K[:, 1, 1] * t[:, 1] / depth + found.K[:, 1, 2]
    reach = found.K[:, 0, 0] * found.diameters / depth
    width, height = found.sizes.T
    return (u < -reach) | (v < -reach) | (u > width + reach) | (v > height + reach)  # NaN: not known, so not outside


def check_duplicates(survey: Survey) -> Iterator[Finding]:
    """Whether an object is annotated twice at the same place."""
    places, total = [], 0
    for scene in survey.scenes:
        gt = scene.ground_truth
        if gt is None:
            continue
        total += len(gt.obj_ids)
        keys = np.column_stack([gt.im_ids, gt.obj_ids, np.round(gt.camera_from_model[:, :3, 3] * 1000.0)])
        unique, numbers = np.unique(keys, axis=0, return_counts=True)
        repeated = unique[numbers > 1].astype(int).tolist()
        places += [f"scene {scene.scene_id} image {im_id} object {obj_id}" for im_id, obj_id, *_ in repeated]
    if places:
        evidence = f"{count_of(len(places), 'place')} with the same object more than once: {some(places, 3)}"
        fix = "remove the repeated annotations (and their masks): a method can find only one of them"
        yield Finding("warning", "Duplicate annotations", survey.split, evidence, fix)
    elif total:
        yield ok("Duplicates", f"none among {count_of(total, 'annotation')}")


def check_results(survey: Survey) -> Iterator[Finding]:
    """Whether the poses of results files are in millimetres, rotations, and of objects that exist."""
    for path in survey.results:
        yield from _check_results_file(survey, path)


def _check_results_file(survey: Survey, path: Path) -> Iterator[Finding]:
    try:
        results = read_results(path)
    except (InputError, OSError) as error:
        text = str(error).removeprefix(f"{path}: ")
        yield Finding("error", "Unreadable results", path.name, text, "mend the line, or write the file again")
        return
    yield from _judge_images(survey, path.name, results)
    if not len(results):
        yield Finding("warning", "No estimates", path.name, "the file holds no estimate", "run the method again")
        return
    poses = np.tile(np.eye(4), (len(results), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = results.rotation, results.translation_mm / 1000.0
    ids = zip(results.scene_id.tolist(), results.im_id.tolist(), results.obj_id.tolist(), strict=True)
    names = [f"scene {scene_id} image {im_id} object {obj_id}" for scene_id, im_id, obj_id in ids]
    with np.errstate(over="ignore"):  # of numbers that cannot be meant, which this is about
        yield from _judge_distances(poses, path.name, "t", "Estimates")
    yield from _judge_rotations(poses[:, :3, :3], path.name, names)
    unknown = sorted(set(results.obj_id.tolist()) - survey.model_ids)
    if unknown and survey.model_ids:
        number = int(np.isin(results.obj_id, unknown).sum())
        evidence = (
            f"{number} of {count_of(len(results), 'estimate')}: {some([f'object {obj_id}' for obj_id in unknown])}"
        )
        fix = "get the missing models, or check that the results belong to this dataset"
        yield Finding("warning", "Estimates of objects without model", path.name, evidence, fix)


def _judge_images(survey: Survey, name: str, results: Results) -> Iterator[Finding]:
    """Whether the estimates are for images of this split, as far as its scenes are looked at."""
    absent = ~np.isin(results.scene_id, survey.scene_ids)
    for scene in survey.scenes:
        known = [*scene.images.keys(), *scene.depths.keys(), *scene.cameras.rows]
        absent |= (results.scene_id == scene.scene_id) & ~np.isin(results.im_id, known)
    if absent.any():
        first = int(np.argmax(absent))
        evidence = (
            f"{int(absent.sum())} of {count_of(len(results), 'estimate')}, first scene {results.scene_id[first]} "
            f"image {results.im_id[first]}"
        )
        fix = f"check that the results belong to {survey.split} of this dataset; these are left out"
        yield Finding("warning", "Estimates for images that are not there", name, evidence, fix)
