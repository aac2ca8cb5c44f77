"""Checks of cameras: intrinsics against the image size, and the direction of world poses."""

import math
from collections import defaultdict
from collections.abc import Iterator
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.bop.doctor.findings import Finding, Severity, count_of, ok, scenes_named, some
from pipeline.bop.doctor.survey import SceneSurvey, Survey, size_of, spread
from pipeline.geometry import inverse

_USUAL_FACTORS = (4.0, 3.0, 2.5, 2.0, 1.5, 0.75, 2 / 3, 0.5, 0.4, 1 / 3, 0.25)
_PAIRS = 60


class Fault(NamedTuple):
    """What is wrong with an intrinsic matrix."""

    severity: Severity
    title: str
    evidence: str
    fix: str


def check_intrinsics(survey: Survey) -> Iterator[Finding]:
    """Whether cam_K fits the size of the images."""
    faults: dict[str, list[tuple[Fault, int, int]]] = defaultdict(list)
    sound = 0
    for scene in survey.scenes:
        size = scene.size
        if size is None or not len(scene.cameras.K):
            continue
        matrices, numbers = np.unique(scene.cameras.K.reshape(-1, 9), axis=0, return_counts=True)
        for K, number in zip(matrices.reshape(-1, 3, 3), numbers.tolist(), strict=True):
            fault = intrinsics_fault(K, *size)
            sound += number * (fault is None)
            if fault:
                faults[fault.title].append((fault, scene.scene_id, number))
    for title, found in faults.items():
        fault = found[0][0]
        where = (
            f"{sum(number for *_, number in found)} images, {scenes_named(sorted({scene for _, scene, _ in found}))}"
        )
        yield Finding(fault.severity, title, "scene_camera.json", f"{fault.evidence} ({where})", fault.fix)
    yield from _check_camera_json(survey)
    if sound and not faults:
        yield ok("Intrinsics", f"cam_K of {count_of(sound, 'image')} fits the image size")


def intrinsics_fault(K: Float[np.ndarray, "3 3"], width: int, height: int) -> Fault | None:
    """Judge an intrinsic matrix by the size of its image in pixels."""
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    shown = f"fx {fx:.5g}, fy {fy:.5g}, cx {cx:.5g}, cy {cy:.5g} for {width}x{height} images"
    if K[2, 0] > 1 and K[2, 1] > 1 and cx == 0 and cy == 0:
        return Fault(
            "error",
            "cam_K is transposed",
            f"cx and cy stand in the last row: {K[2].tolist()}",
            "write cam_K row by row",
        )
    if not np.allclose(K[2], (0, 0, 1)) or K[1, 0] != 0 or fx <= 0 or fy <= 0:
        return Fault(
            "error", "cam_K is no intrinsic matrix", f"rows {K.tolist()}", "write cam_K as fx 0 cx 0 fy cy 0 0 1"
        )
    scale_x, scale_y = 2 * cx / width, 2 * cy / height
    if _agree(scale_x, scale_y) and not 0.72 < math.sqrt(scale_x * scale_y) < 1.38:
        factor = math.sqrt(scale_x * scale_y)
        factor = min(_USUAL_FACTORS, key=lambda usual: abs(math.log(usual / factor)))
        middle = f"cx {width / 2:g}, cy {height / 2:g}"
        evidence = f"{shown}: the middle is {middle}, as if K were for images {factor:.3g} times as large"
        fix = f"divide fx, fy, cx and cy by {factor:.3g}, or use the images at their original size"
        return Fault("error", "cam_K is for another resolution", evidence, fix)
    if not 0 < cx < width or not 0 < cy < height:
        return Fault(
            "error",
            "Principal point outside the image",
            shown,
            "check cx and cy, and whether the image was cropped after calibration",
        )
    return _field_of_view_fault(fx, fy, width, shown) or _centre_fault(scale_x, scale_y, shown)


def _agree(a: float, b: float) -> bool:
    return bool(a > 0 and b > 0 and 0.8 < a / b < 1.25)


def _field_of_view_fault(fx: float, fy: float, width: int, shown: str) -> Fault | None:
    angle = math.degrees(2 * math.atan(width / (2 * fx)))
    evidence = f"{shown}: a field of view of {angle:.3g} degrees"
    fix = "give fx and fy in pixels (focal length in mm / pixel size in mm)"
    if not 2 < angle < 160:
        return Fault("error", "Impossible focal length", evidence, fix)
    if not 8 < angle < 130:
        return Fault("warning", "Unusual focal length", evidence, fix)
    if not 0.9 < fx / fy < 1.11:
        evidence = f"{shown}: pixels {fx / fy:.3g} times as wide as high"
        return Fault("warning", "fx and fy differ", evidence, "check whether the image was stretched after calibration")
    return None


def _centre_fault(scale_x: float, scale_y: float, shown: str) -> Fault | None:
    if abs(scale_x - 1) > 0.5 or abs(scale_y - 1) > 0.5:
        fix = "right only for cropped images; else check cx and cy"
        return Fault("warning", "Principal point far from the middle", shown, fix)
    return None


def _check_camera_json(survey: Survey) -> Iterator[Finding]:
    camera = survey.camera_json
    if isinstance(camera, str):
        problem = camera.removeprefix(f"{survey.root / 'camera.json'}: ")
        yield Finding("warning", "Unreadable camera.json", "camera.json", problem, "get the file again")
        return
    sizes = {size for scene in survey.scenes if (size := size_of(next(iter(scene.images.values()), None)))}
    wanted = camera.get("width"), camera.get("height")
    if sizes and None not in wanted and wanted not in sizes:
        evidence = f"it says {wanted[0]}x{wanted[1]}, the images are {some([f'{w}x{h}' for w, h in sorted(sizes)])}"
        fix = "correct width and height, or use the images at their original size"
        yield Finding("warning", "camera.json is of another size", "camera.json", evidence, fix)


def check_world_direction(survey: Survey) -> Iterator[Finding]:
    """Whether cam_R_w2c and cam_t_w2c map from the world to the camera, judged by objects that stand still."""
    for scene in survey.scenes:
        if scene.ground_truth is None:
            continue
        tracks = _tracks(scene)
        if tracks is None:
            continue
        yield _judge_direction(scene, *tracks)


def _tracks(scene: SceneSurvey) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """World poses and positions in the camera of one object in the two images of many pairs, metres.

    Only objects that occur once in either image and moved in the camera's frame; None if there are none.
    """
    gt, cameras = scene.ground_truth, scene.cameras
    assert gt
    known = [i for i in scene.annotated() if np.isfinite(cameras.world_from_camera[cameras.rows[i]]).all()]
    positions = {
        i: _single_objects(gt.obj_ids[gt.spans[i]], gt.camera_from_model[gt.spans[i], :3, 3]) for i in spread(known, 24)
    }
    found = []
    for a, b in spread(list(combinations(positions, 2)), _PAIRS):
        for obj_id in positions[a].keys() & positions[b].keys():
            p, q = positions[a][obj_id], positions[b][obj_id]
            if np.linalg.norm(p - q) > 0.02:
                found.append((cameras.rows[a], cameras.rows[b], p, q))
    if not found:
        return None
    rows_a, rows_b, p, q = map(np.array, zip(*found, strict=True))
    return cameras.world_from_camera[rows_a], cameras.world_from_camera[rows_b], p, q


def _single_objects(obj_ids: np.ndarray, positions: np.ndarray) -> dict[int, np.ndarray]:
    ids, first, numbers = np.unique(obj_ids, return_index=True, return_counts=True)
    return {int(i): positions[at] for i, at, number in zip(ids, first, numbers, strict=True) if number == 1}


def _judge_direction(
    scene: SceneSurvey, first: np.ndarray, second: np.ndarray, p: np.ndarray, q: np.ndarray
) -> Finding:
    """Under the right reading of the world poses an object that stands still stays where it is."""
    readings = {
        "": lambda pose: pose,
        "inverted": inverse,
        "in metres": lambda pose: _scaled(pose, 1000.0),
        "inverted and in metres": lambda pose: _scaled(inverse(pose), 1000.0),
    }
    wander = {
        name: 1000.0 * float(np.median(np.linalg.norm(_apply(read(first), p) - _apply(read(second), q), axis=1)))
        for name, read in readings.items()
    }
    best = min(wander, key=lambda name: wander[name])
    subject, given = f"scene {scene.scene_id}, scene_camera.json", wander[""]
    moved = 1000.0 * float(np.median(np.linalg.norm(p - q, axis=1)))
    pairs = f"median of {count_of(len(p), 'pair')}"
    if given > 10.0 and wander[best] < given / 3.0:
        evidence = (
            f"objects wander {given:.3g} mm in the world between images ({pairs}), {wander[best]:.3g} mm if read {best}"
        )
        return Finding("error", f"World poses are {best}", subject, evidence, _DIRECTION_FIXES[best])
    if given > 0.3 * moved and given > 30.0:
        evidence = f"objects wander {given:.3g} mm in the world between images ({pairs}), {moved:.3g} mm in the camera"
        fix = "expected if objects move; else calibrate cam_R_w2c and cam_t_w2c again"
        return Finding("note", "World poses do not hold objects still", subject, evidence, fix)
    evidence = f"objects stay within {given:.3g} mm in the world ({pairs}), {moved:.3g} mm in the camera"
    return ok("World poses", evidence, subject)


_DIRECTION_FIXES = {
    "inverted": "write the inverse: cam_R_w2c = R^T and cam_t_w2c = -R^T t of the camera-to-world pose",
    "in metres": "multiply cam_t_w2c by 1000: BOP translations are in millimetres",
    "inverted and in metres": "multiply t by 1000 and write the inverse: cam_R_w2c = R^T, cam_t_w2c = -R^T t",
}


def _scaled(poses: np.ndarray, factor: float) -> np.ndarray:
    poses = poses.copy()
    poses[:, :3, 3] *= factor
    return poses


def _apply(poses: np.ndarray, points: np.ndarray) -> np.ndarray:
    return np.einsum("nij,nj->ni", poses[:, :3, :3], points) + poses[:, :3, 3]
