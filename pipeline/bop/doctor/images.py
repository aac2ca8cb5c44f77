"""Checks of image files: there, whole, and depth as depth should be."""

import zlib
from collections.abc import Iterator
from pathlib import Path

from pipeline.bop.doctor.findings import Finding, Severity, count_of, ok, some
from pipeline.bop.doctor.survey import SceneSurvey, Survey, bits_of_png, by_scene, file_name, number_of, size_of, spread
from pipeline.bop.images import read_rgb
from pipeline.exceptions import InputError

_PNG_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_PNG_END = b"\x00\x00\x00\x00IEND\xaeB`\x82"


def check_image_files(survey: Survey) -> Iterator[Finding]:
    """Whether listed images exist and existing ones are listed; one finding for all images of a kind."""
    scenes = survey.scenes
    listed = sum(len(scene.cameras.rows) for scene in scenes)
    with_image = any(scene.images for scene in scenes)
    with_depth = any(scene.depths for scene in scenes)
    if with_image or not with_depth:
        missing = {scene.scene_id: _absent(scene, scene.images) for scene in scenes}
        yield from _missing_files(survey, missing, listed, "image", "warning" if with_image else "error")
    if with_depth:
        missing = {scene.scene_id: _absent(scene, scene.depths) for scene in scenes}
        yield from _missing_files(survey, missing, listed, "depth image", "warning")
    elif listed:
        fix = "nothing to do for colour-only methods; VSD and the depth views need depth"
        yield Finding("note", "No depth images", survey.split, f"none of {listed} images has depth", fix)
    extra = {scene.scene_id: _unlisted(scene) for scene in scenes}
    if any(extra.values()):
        evidence = (
            f"{count_of(number_of(extra), 'image')} on disk without entry in scene_camera.json ({by_scene(extra)})"
        )
        fix = "add their cam_K and depth_scale to scene_camera.json, or remove the files"
        yield Finding("warning", "Images without camera", survey.split, evidence, fix)
    images, depths = sum(len(scene.images) for scene in scenes), sum(len(scene.depths) for scene in scenes)
    yield ok("Image files", f"{count_of(images, 'image')} and {count_of(depths, 'depth image')} for {listed} entries")


def _unlisted(scene: SceneSurvey) -> list[int]:
    return sorted((scene.images.keys() | scene.depths.keys()) - scene.cameras.rows.keys() - scene.cameras.damage.keys())


def _absent(scene: SceneSurvey, files: dict[int, Path]) -> list[int]:
    return sorted(scene.cameras.rows.keys() - files.keys())


def _missing_files(
    survey: Survey, missing: dict[int, list[int]], listed: int, noun: str, severity: Severity
) -> Iterator[Finding]:
    if any(missing.values()):
        evidence = (
            f"{number_of(missing)} of {listed} images in scene_camera.json have no {noun} file ({by_scene(missing)})"
        )
        fix = f"get the missing files (inspector download {survey.facts.name}), or keep to the images that are here"
        yield Finding(severity, f"Missing {noun}s", survey.split, evidence, fix)


def check_image_content(survey: Survey) -> Iterator[Finding]:
    """Whether image files are whole, depth has 16 bits and the size of the image, and measures something."""
    broken: list[str] = []
    shallow: list[str] = []
    unequal: list[str] = []
    count = 0
    for _, _, image, depth in survey.sampled_files():
        for path in filter(None, (image, depth)):
            count += 1
            if problem := file_problem(path, survey.effort.whole_files):
                broken.append(f"{file_name(path, survey)} {problem}")
        if depth and bits_of_png(depth) == 8:
            shallow.append(file_name(depth, survey))
        sizes = size_of(image), size_of(depth)
        if image and depth and sizes[0] and sizes[1] and sizes[0] != sizes[1]:
            unequal.append("{} {}x{} against {}x{}".format(file_name(depth, survey), *sizes[1], *sizes[0]))
    looked = f"of {count} files looked at"
    if broken:
        yield Finding(
            "error",
            "Broken image files",
            survey.split,
            f"{len(broken)} {looked}: {some(broken, 3)}",
            "get these files again",
        )
    if shallow:
        fix = "export depth as 16-bit PNG; 8 bits are a picture of depth, its values are lost"
        yield Finding("error", "Depth with 8 bits", survey.split, f"{len(shallow)} {looked}: {some(shallow, 3)}", fix)
    if unequal:
        fix = "register depth to the colour image and write it at the same size"
        yield Finding(
            "error",
            "Depth of another size than the image",
            survey.split,
            f"{len(unequal)} {looked}: {some(unequal, 3)}",
            fix,
        )
    yield from _empty_depth(survey)
    yield ok("Image content", f"{count} files looked at")


def _empty_depth(survey: Survey) -> Iterator[Finding]:
    items = [(scene, im_id) for scene in survey.scenes for im_id in scene.depths if im_id in scene.cameras.rows]
    sample = spread(items, survey.effort.rendered_images)
    depths = [(scene, im_id, survey.depth(scene, im_id)) for scene, im_id in sample]
    empty = [
        f"scene {scene.scene_id} image {im_id}"
        for scene, im_id, depth in depths
        if depth is not None and not depth.any()
    ]
    if empty:
        evidence = f"{len(empty)} of {len(sample)} depth images looked at are 0 everywhere: {some(empty, 3)}"
        severity = "error" if len(empty) == len(sample) else "warning"
        yield Finding(
            severity, "Depth without any measurement", survey.split, evidence, "export the depth again, as 16-bit PNG"
        )


def file_problem(path: Path, whole: bool = False) -> str:
    """What is wrong with an image file, judged by its first and last bytes, or by all of them; empty: nothing."""
    try:
        size = path.stat().st_size
        with path.open("rb") as file:
            head = file.read(16)
            file.seek(max(0, size - 64))
            tail = file.read()
        if whole:
            return _content_problem(path)
    except OSError as error:
        return f"cannot be read ({error.strerror})"
    if not size:
        return "is empty"
    if head.startswith(_PNG_SIGNATURE):
        return "" if _PNG_END in tail else f"is cut off after {size} bytes"
    if head.startswith(b"\xff\xd8"):
        return "" if b"\xff\xd9" in tail else f"is cut off after {size} bytes"
    return "" if head[:4] in (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+") else "is no PNG, JPEG or TIFF"


def _content_problem(path: Path) -> str:
    data = path.read_bytes()
    if not data.startswith(_PNG_SIGNATURE):
        try:
            read_rgb(path)
        except InputError as error:
            return str(error).removeprefix(f"{path}: ")
        return (
            ""
            if not data.startswith(b"\xff\xd8") or b"\xff\xd9" in data[-64:]
            else f"is cut off after {len(data)} bytes"
        )
    at = len(_PNG_SIGNATURE)
    while at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        kind, end = data[at + 4 : at + 8], at + 8 + length
        if end + 4 > len(data):
            break
        if zlib.crc32(data[at + 4 : end]) != int.from_bytes(data[end : end + 4], "big"):
            return f"has a wrong checksum at byte {at}"
        if kind == b"IEND":
            return ""
        at = end + 4
    return f"is cut off after {len(data)} bytes"
