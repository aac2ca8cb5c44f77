"""Checks that compare rendered ground truth with what was measured: depth scale, poses, silhouettes."""

from collections import defaultdict
from collections.abc import Callable, Iterator
from shlex import quote

import numpy as np
from jaxtyping import Float

from pipeline.bop.doctor.findings import Finding, count_of, ok, scenes_named, some
from pipeline.bop.doctor.survey import Survey, View, spread
from pipeline.rendering import render_depths

_USUAL_SCALES = tuple(mantissa * 10.0**power for power in range(-5, 4) for mantissa in (1.0, 1.25, 2.0, 2.5, 5.0))
PLAUSIBLE_DEPTH = (0.05, 30.0)
"""Metres; a depth image whose median lies outside has a wrong scale."""
FIT = 0.02
"""Metres within which rendered and measured depth agree."""
LARGE_GAP = 0.010
"""Metres of median difference that are worth a warning; LM-O has 2.4 to 6.0 mm, YCB-V 0.8 to 1.7 mm."""
_FEW_PIXELS = 50


def check_depth_scale(survey: Survey) -> Iterator[Finding]:
    """Whether depth_scale is right, judged by rendered ground truth where there is any, else by plausibility."""
    ratios: dict[float, list[np.ndarray]] = defaultdict(list)
    scenes: dict[float, set[int]] = defaultdict(set)
    for view in survey.views:
        if view.depth is not None:
            scale = float(view.scene.cameras.depth_scale_mm[view.scene.cameras.row(view.im_id)])
            pairs = [view.measured_and_rendered(i) for i in range(len(view.instances))]
            ratios[scale] += [measured / rendered for measured, rendered in pairs]
            scenes[scale].add(view.scene.scene_id)
    for scale, found in ratios.items():
        pooled = np.concatenate(found) if found else np.empty(0)
        if len(pooled) >= _FEW_PIXELS:
            yield _judge_scale(scale, pooled, scenes_named(sorted(scenes[scale])))
    yield from _plausible_depth(survey, set().union(*scenes.values()))


def _judge_scale(scale: float, ratios: Float[np.ndarray, "n"], subject: str) -> Finding:
    ratio, share = most_frequent_ratio(ratios)
    evidence = f"with depth_scale {scale:g}, measured depth is {ratio:.4g} times that of the rendered ground truth"
    evidence += f" ({share:.0%} of {len(ratios)} pixels within 5 %)"
    if share < 0.25:
        return Finding(
            "note",
            "Depth scale not judged",
            subject,
            evidence,
            "see poses against depth: too few pixels agree on one factor",
        )
    if not 0.8 < ratio < 1.25:
        return Finding(
            "error",
            "Wrong depth_scale",
            subject,
            evidence,
            f"set depth_scale to {_usual(scale / ratio):.4g} in scene_camera.json",
        )
    if not 0.98 < ratio < 1.02:
        fix = f"check depth_scale ({scale / ratio:.4g} would fit), the focal length and the size of the models"
        return Finding("warning", "Depth scale a little off", subject, evidence, fix)
    return ok("Depth scale", evidence, subject)


def most_frequent_ratio(ratios: Float[np.ndarray, "n"]) -> tuple[float, float]:
    """The ratio that most values agree on within 5 %, and their share; occluders and holes do not sway it."""
    logs = np.sort(np.log(ratios))
    start, count = _densest(logs, 2 * np.log(1.05))
    return float(np.exp(np.median(logs[start : start + count]))), count / len(logs)


def _usual(scale: float) -> float:
    nearest = min(_USUAL_SCALES, key=lambda usual: abs(np.log(usual / scale)))
    return nearest if abs(np.log(nearest / scale)) < 0.05 else scale


def _plausible_depth(survey: Survey, judged: set[int]) -> Iterator[Finding]:
    """Judge scenes without ground truth by the middle of their depth."""
    scenes = [scene for scene in survey.scenes if scene.scene_id not in judged and scene.depths]
    medians = {}
    for scene in scenes:
        sample = spread(sorted(scene.depths), 2)
        depths = [depth[depth > 0] for im_id in sample if (depth := survey.depth(scene, im_id)) is not None]
        if depths and sum(map(len, depths)):
            medians[scene] = float(np.median(np.concatenate(depths)))
    for scene, median in medians.items():
        subject, scale = f"scene {scene.scene_id}", float(np.median(scene.cameras.depth_scale_mm))
        evidence = (
            f"without ground truth to compare with: median depth {median * 1000:.4g} mm with depth_scale {scale:g}"
        )
        if PLAUSIBLE_DEPTH[0] < median < PLAUSIBLE_DEPTH[1]:
            yield ok("Depth is plausible", evidence, subject)
        else:
            power = 10.0 ** round(np.log10(1.0 / median))
            fix = f"set depth_scale to the millimetres of one unit; {scale * power:g} would give {median * power:.3g} m"
            yield Finding("error", "Implausible depth_scale", subject, evidence, fix)


def check_poses_against_depth(survey: Survey) -> Iterator[Finding]:
    """Whether models at their ground-truth poses lie on the measured surface."""
    views = [view for view in survey.views if view.depth is not None]
    gaps: dict[int, list[float]] = defaultdict(list)
    shares = []
    for view in views:
        for i, (gt, _) in enumerate(view.instances):
            measured, rendered = view.measured_and_rendered(i)
            if len(measured) < _FEW_PIXELS or (gt.visible_fraction or 1.0) < 0.3:
                continue
            shares.append(float((np.abs(measured - rendered) < FIT).mean()))
            gaps[gt.obj_id].append(typical_gap(measured - rendered))
    if not gaps:
        return
    medians = {obj_id: float(np.median(values)) for obj_id, values in sorted(gaps.items())}
    large = {obj_id: gap for obj_id, gap in medians.items() if gap > LARGE_GAP}
    share = float(np.median(shares))
    listed = some([f"object {obj_id} {gap * 1000:.1f} mm" for obj_id, gap in medians.items()], 12)
    evidence = f"median difference of rendered and measured depth in {count_of(len(views), 'image')}: {listed}"
    if finding := _other_convention(views[:4]):
        yield finding
    elif share < 0.2:
        evidence = f"only {share:.0%} of the pixels of an object measure within {FIT * 1000:.0f} mm of its rendering"
        evidence += f" (median of {count_of(len(shares), 'instance')})"
        fix = "look at the overlays: check cam_K, the frame of the models, and whether depth is registered to the image"
        yield Finding("warning", "Ground truth does not lie on the depth", survey.split, evidence, fix)
    elif large:
        fix = "align these poses to the depth in the inspector's pose editor, or check the size of the models"
        subject = some([f"object {obj_id}" for obj_id in large])
        yield Finding("warning", "Ground truth away from the depth", subject, evidence, fix)
    else:
        yield ok("Poses against depth", evidence)


def typical_gap(differences: Float[np.ndarray, "n"]) -> float:
    """Median size of the differences, metres, apart from occluders and holes.

    Those within FIT of zero if they are many enough to be the object, else those in the densest window of 2 FIT.
    """
    ordered = np.sort(differences)
    start, count = np.searchsorted(ordered, -FIT), int((np.abs(ordered) <= FIT).sum())
    if count < 0.15 * len(ordered):
        start, count = _densest(ordered, 2 * FIT)
    return float(np.median(np.abs(ordered[start : start + count])))


def _densest(ordered: Float[np.ndarray, "n"], width: float) -> tuple[int, int]:
    """Start and length of the window of sorted values that holds most of them."""
    inside = np.searchsorted(ordered, ordered + width, "right") - np.arange(len(ordered))
    start = int(np.argmax(inside))
    return start, int(inside[start])


def _other_convention(views: list[View]) -> Finding | None:
    """The convention under which objects would lie on the measured surface, if as given they do not."""
    given = _fit(views, lambda pose: pose)
    if given > 0.5:
        return None
    flip = np.diag([1.0, -1.0, -1.0, 1.0])
    conventions: dict[str, Callable[[np.ndarray], np.ndarray]] = {
        "their rotations were transposed": _transposed,
        "they were inverted (camera to model)": np.linalg.inv,
        "they were converted from OpenGL's camera (y and z negated)": lambda pose: flip @ pose,
        "they were inverted and converted from OpenGL's camera": lambda pose: flip @ np.linalg.inv(pose),
    }
    fits = {name: _fit(views, change) for name, change in conventions.items()}
    best = max(fits, key=lambda name: fits[name])
    if fits[best] < max(0.4, 2 * given):
        return None
    evidence = f"{given:.0%} of an object's pixels (median) agree with the measured depth, {fits[best]:.0%} if {best}"
    return Finding(
        "error", "Poses in another convention", "scene_gt.json", evidence, f"change the poses so that {best}"
    )


def _transposed(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    changed = pose.copy()
    changed[:3, :3] = pose[:3, :3].T
    return changed


def _fit(views: list[View], change: Callable[[np.ndarray], np.ndarray]) -> float:
    """Median over instances of the share of their pixels that agree with the measured depth."""
    shares = []
    for view in views:
        assert view.depth is not None
        for gt, model in view.instances:
            rendering = render_depths(model, view.camera, change(gt.camera_from_model)[None], pixel_center=0.0)[0]
            measured = view.depth[rendering.box.slices]
            pixels = rendering.mask_crop & (measured > 0)
            agree = np.abs(measured - rendering.depth_crop)[pixels] < min(FIT, 0.1 * model.diameter)
            shares.append(float(agree.mean()) if pixels.sum() >= _FEW_PIXELS else 0.0)
    return float(np.median(shares)) if shares else 0.0


def check_gt_info(survey: Survey) -> Iterator[Finding]:
    """Whether scene_gt_info.json is there and agrees with the silhouettes of the rendered ground truth."""
    scenes = [scene for scene in survey.scenes if scene.ground_truth]
    absent = [scene.scene_id for scene in scenes if not scene.layout.json("scene_gt_info").is_file()]
    fix = f"make it: inspector gt-info {quote(str(survey.root))} --split {survey.split} --only info"
    if absent:
        evidence = f"visible fractions are unknown in {len(absent)} of {count_of(len(scenes), 'scene')}"
        yield Finding("note", "No scene_gt_info.json", scenes_named(absent), evidence, fix)
    compared, wrong = 0, []
    for view in survey.views:
        for i, (gt, _) in enumerate(view.instances):
            text = _silhouette_problem(view, i)
            compared += text is not None
            if text:
                wrong.append(f"scene {view.scene.scene_id} image {view.im_id} object {gt.obj_id} {text}")
    if compared and len(wrong) > 0.1 * compared:
        evidence = f"{len(wrong)} of {compared} annotations: {some(wrong, 2)}"
        yield Finding(
            "warning",
            "scene_gt_info.json disagrees with the poses",
            survey.split,
            evidence,
            f"{fix} --force, after every change of poses",
        )
    elif compared:
        yield ok("scene_gt_info.json", f"silhouettes of {compared} annotations agree with the rendered ones")


def _silhouette_problem(view: View, index: int) -> str | None:
    """What differs between the recorded and the rendered silhouette; empty: nothing, None: cannot be compared."""
    gt, rendering = view.instances[index][0], view.rendering.renderings[index]
    if gt.visible_fraction is None or gt.visible_pixels is None or gt.visible_fraction < 0.2:
        return None
    rows, columns = np.nonzero(rendering.mask)
    height, width = rendering.image_shape
    inside = len(rows) and min(rows.min(), columns.min()) > 0 and rows.max() < height - 1 and columns.max() < width - 1
    if not inside or len(rows) < 2 * _FEW_PIXELS:
        return None
    recorded = gt.visible_pixels / gt.visible_fraction
    if not 0.85 < recorded / len(rows) < 1.18:
        return f"has a silhouette of {recorded:.0f} pixels, rendered {len(rows)}"
    if gt.bbox_visible is not None:
        x, y, w, h = gt.bbox_visible
        overhang = max(columns.min() - x, rows.min() - y, x + w - 1 - columns.max(), y + h - 1 - rows.max())
        if overhang > 5:
            return f"has a visible box that reaches {overhang:.0f} pixels beyond the rendered silhouette"
    return ""
