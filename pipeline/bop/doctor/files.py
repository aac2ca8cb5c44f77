"""Checks of annotation files: scene JSON, masks, target lists."""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from shlex import quote

from pipeline.bop import layout
from pipeline.bop.doctor.findings import Finding, count_of, ok, some
from pipeline.bop.doctor.survey import SceneSurvey, Survey, by_scene, file_name, number_of
from pipeline.bop.json_files import read_json
from pipeline.exceptions import InputError


def check_json(survey: Survey) -> Iterator[Finding]:
    """Whether the scenes' JSON files can be read and every entry has what it needs."""
    sound = 0
    for scene in survey.scenes:
        for content in filter(None, (scene.cameras, scene.ground_truth)):
            damage = list(content.damage.values())
            sound += not damage
            if damage:
                evidence = damage[0] if len(damage) == 1 else f"{damage[0]}; {len(damage)} images have such damage"
                fix = "mend or replace these entries; the images are left out until then"
                yield Finding("error", "Damaged annotations", file_name(content.path, survey), evidence, fix)
        for warning in (scene.ground_truth.warnings if scene.ground_truth else ())[:1]:
            subject = file_name(scene.layout.json("scene_gt_info"), survey)
            yield Finding("warning", "Damaged scene_gt_info.json", subject, warning, "compute the file again")
    bare = [scene.scene_id for scene in survey.scenes if scene.ground_truth is None]
    if bare:
        evidence = f"{len(bare)} of {count_of(len(survey.scenes), 'scene')} without scene_gt.json: {some(bare)}"
        fix = "nothing to do if the annotations are withheld (test images); estimates can be seen but not scored"
        yield Finding("note", "Scenes without ground truth", survey.split, evidence, fix)
    looked, total = len(survey.scenes), len(survey.scene_ids)
    of_all = (
        f"all {count_of(total, 'scene')}" if looked == total else f"{looked} of {total} scenes, the sample looked at"
    )
    yield ok("Scene files", f"{count_of(sound, 'file')} read, of {of_all}")


def check_image_ids(survey: Survey) -> Iterator[Finding]:
    """Whether scene_camera.json and scene_gt.json speak of the same images."""
    unseen, bare, total = {}, {}, 0
    for scene in survey.scenes:
        if not scene.ground_truth or None in scene.cameras.damage or None in scene.ground_truth.damage:
            continue
        cameras = _image_ids(scene.cameras.rows, scene.cameras.damage)
        annotated = _image_ids(scene.ground_truth.spans, scene.ground_truth.damage)
        unseen[scene.scene_id], bare[scene.scene_id] = sorted(annotated - cameras), sorted(cameras - annotated)
        total += len(cameras | annotated)
    if any(unseen.values()):
        evidence = f"{number_of(unseen)} of {total} images are in scene_gt.json only ({by_scene(unseen)})"
        fix = "add their cam_K and depth_scale to scene_camera.json, or correct the image ids"
        yield Finding("error", "Annotated images without camera", survey.split, evidence, fix)
    if any(bare.values()):
        evidence = f"{number_of(bare)} of {total} images are in scene_camera.json only ({by_scene(bare)})"
        fix = 'write an empty list ("12": []) for images without objects, or add the missing annotations'
        yield Finding("warning", "Images without annotation entry", survey.split, evidence, fix)
    if total and not any(unseen.values()) and not any(bare.values()):
        yield ok("Image ids", f"{total} images have a camera and an annotation entry")


def _image_ids(sound: Mapping[int, object], damaged: Mapping[int | None, str]) -> set[int]:
    return set(sound) | {im_id for im_id in damaged if im_id is not None}


def check_masks(survey: Survey) -> Iterator[Finding]:
    """Whether every annotation has its two masks."""
    scenes = [scene for scene in survey.scenes if scene.ground_truth]
    wanted = missing = 0
    examples: list[str] = []
    for scene in scenes:
        for folder in ("mask", "mask_visib"):
            present = _mask_names(scene, folder)
            for im_id in scene.annotated():
                span = scene.ground_truth.spans[im_id]  # type: ignore[union-attr] - scenes have ground truth
                absent = [i for i in range(span.stop - span.start) if f"{im_id:06d}_{i:06d}" not in present]
                wanted += span.stop - span.start
                missing += len(absent)
                examples += [
                    f"scene {scene.scene_id} {folder}/{im_id:06d}_{i:06d}.png" for i in absent[: 4 - len(examples)]
                ]
    fix = f"make them: inspector gt-info {quote(str(survey.root))} --split {survey.split} --only masks"
    if wanted and missing == wanted:
        yield Finding(
            "note", "No masks", survey.split, f"none of {wanted} masks is here; only visibility views need them", fix
        )
    elif missing:
        evidence = f"{missing} of {wanted} masks have no file: {some(examples, 3)}"
        yield Finding("warning", "Missing masks", survey.split, evidence, f"{fix} --force")
    elif wanted:
        yield ok("Masks", f"{wanted} masks are here")


def _mask_names(scene: SceneSurvey, folder: str) -> set[str]:
    suffix = f"_{scene.layout.sensor}" if scene.layout.sensor else ""
    path = scene.layout.folder / f"{folder}{suffix}"
    return {file.stem for file in path.iterdir()} if path.is_dir() else set()


def check_targets(survey: Survey) -> Iterator[Finding]:
    """Whether the target lists name images and objects that exist."""
    for path in layout.target_files(survey.root, survey.split):
        try:
            targets = [
                (int(t["scene_id"]), int(t["im_id"]), t.get("obj_id"), t.get("inst_count", 1)) for t in read_json(path)
            ]
        except (InputError, KeyError, TypeError, ValueError, AttributeError) as error:
            fix = "get the file again; it is a list of objects with scene_id, im_id, obj_id and inst_count"
            yield Finding("error", "Unreadable target list", path.name, f"{type(error).__name__}: {error}", fix)
            continue
        yield from _judge_targets(survey, path.name, targets)


def _judge_targets(survey: Survey, name: str, targets: list[tuple[int, int, int | None, int]]) -> Iterator[Finding]:
    scenes = {scene.scene_id: scene for scene in survey.scenes}
    images = {(s, i) for s, i, _, _ in targets}
    seen = {s for s, _ in images if s in scenes}
    lost = sorted(
        (s, i) for s, i in images if s not in survey.scene_ids or (s in seen and i not in scenes[s].cameras.rows)
    )
    if lost:
        evidence = f"{len(lost)} of {len(images)} images that it names are not in the split: " + some(
            [f"scene {s} image {i}" for s, i in lost]
        )
        fix = "get the missing scenes, or remove these targets; they are skipped until then"
        yield Finding("warning", "Targets in absent images", name, evidence, fix)
    wrong = list(_unannotated(scenes, targets))
    if wrong:
        evidence = f"{len(wrong)} of {len(targets)} targets ask for more instances than are annotated: {some(wrong, 3)}"
        fix = "correct obj_id and inst_count, or add the missing annotations"
        yield Finding("warning", "Targets without annotation", name, evidence, fix)
    if not lost and not wrong:
        yield ok("Targets", f"{len(targets)} targets in {len(images)} images", name)


def _unannotated(scenes: dict[int, SceneSurvey], targets: list[tuple[int, int, int | None, int]]) -> Iterator[str]:
    counted: dict[int, dict[tuple[int, int], int]] = {}
    for scene_id, scene in scenes.items():
        gt = scene.ground_truth
        counted[scene_id] = defaultdict(int)
        for key in zip(gt.im_ids.tolist(), gt.obj_ids.tolist(), strict=True) if gt else ():
            counted[scene_id][key] += 1
    for scene_id, im_id, obj_id, inst_count in targets:
        scene = scenes.get(scene_id)
        if obj_id is None or not scene or not scene.ground_truth or im_id not in scene.ground_truth.spans:
            continue
        have = counted[scene_id][im_id, obj_id]
        if have < inst_count:
            yield f"scene {scene_id} image {im_id} object {obj_id} ({have} of {inst_count})"
