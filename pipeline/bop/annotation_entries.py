"""Entries of `scene_camera.json` and `scene_gt.json` as columns of numbers, and words for what is wrong with one."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

Columns = tuple[np.ndarray, ...]

_ODD = (KeyError, TypeError, ValueError, OverflowError, AttributeError)
"""What bulk conversion raises when an entry is not as expected."""
_NO_R, _NO_T = [float("nan")] * 9, [float("nan")] * 3


def columns_of(
    images: dict[int, Any], columns: Callable[[dict[int, Any]], Columns], problem: Callable[[Any], str | None]
) -> tuple[dict[int, Any], Columns, dict[int, str]]:
    """The sound images, their columns, and what is wrong with each of the others.

    All images are converted at once; only if that fails is the damage looked for one by one.
    """
    try:
        return images, columns(images), {}
    except _ODD:
        pass
    sound: dict[int, Any] = {}
    parts, damage = [columns({})], {}
    for im_id, entry in images.items():
        try:
            parts.append(columns({im_id: entry}))
            sound[im_id] = entry
        except _ODD:
            damage[im_id] = problem(entry) or ": is not as expected; get the file again"
    return sound, tuple(np.concatenate(column) for column in zip(*parts, strict=True)), damage


def camera_columns(images: dict[int, dict]) -> Columns:
    """K, depth scale, R and t of the world (NaN where absent). Raises one of several errors if anything is odd."""
    cameras = images.values()
    K = _finite([camera["cam_K"] for camera in cameras], 9)
    scales = _finite([[camera.get("depth_scale", 1.0)] for camera in cameras], 1)[:, 0]
    if not (K[:, [0, 4]] != 0).all() or not np.linalg.det(K.reshape(-1, 3, 3)).all() or not (scales > 0).all():
        raise ValueError
    R = np.array([camera.get("cam_R_w2c", _NO_R) for camera in cameras], dtype=float).reshape(-1, 9)
    t = np.array([camera.get("cam_t_w2c", _NO_T) for camera in cameras], dtype=float).reshape(-1, 3)
    if len(R) != len(K) or len(t) != len(K):
        raise ValueError
    return K, scales, R, t


def camera_problem(camera: dict) -> str | None:
    """What is wrong with a camera, as the end of a sentence that begins with its image; None if nothing is."""
    if "cam_K" not in camera and "cam_model" in camera:
        return " has a cam_model and no cam_K; undistort the images to a pinhole camera first"
    for name, count in (("cam_K", 9), ("cam_R_w2c", 9), ("cam_t_w2c", 3)):
        if name == "cam_K" or name in camera:
            text = _numbers_problem(camera, name, count)
            if text:
                return f": {text}"
    if not all(camera["cam_K"][i] for i in (0, 4)):
        return f": cam_K has a focal length of 0 ({short(camera['cam_K'])}); expected fx and fy in pixels"
    if not np.linalg.det(np.reshape(camera["cam_K"], (3, 3))):
        return f": cam_K cannot be inverted ({short(camera['cam_K'])}); expected fx 0 cx 0 fy cy 0 0 1"
    scale = camera.get("depth_scale", 1.0)
    if not _is_number(scale) or not scale > 0:
        return f": depth_scale is {short(scale)}; expected the millimetres of one unit of the depth image"
    return None


def ground_truth_columns(images: dict[int, list[dict]]) -> Columns:
    """Object ids, R and t. Raises one of several errors if anything is odd."""
    entries = [entry for image in images.values() for entry in image]
    obj_ids = np.array([int(entry["obj_id"]) for entry in entries], dtype=np.int64)
    R = _finite([entry["cam_R_m2c"] for entry in entries], 9)
    return obj_ids, R, _finite([entry["cam_t_m2c"] for entry in entries], 3)


def ground_truth_problem(entries: list) -> str | None:
    """What is wrong with an image's annotations, as the end of a sentence that begins with the image."""
    for index, entry in enumerate(entries):
        text = _entry_problem(entry)
        if text:
            return f", annotation {index}: {text}"
    return None


def _entry_problem(entry: Any) -> str | None:
    if not isinstance(entry, dict):
        return f"holds {short(entry)}; expected an object with obj_id, cam_R_m2c and cam_t_m2c"
    obj_id = entry.get("obj_id")
    if not isinstance(obj_id, int) or not 0 <= obj_id < 1 << 31:
        return f"obj_id is {short(obj_id)}; expected a whole number"
    return _numbers_problem(entry, "cam_R_m2c", 9) or _numbers_problem(entry, "cam_t_m2c", 3)


def _numbers_problem(entry: dict, name: str, count: int) -> str | None:
    if name not in entry:
        return f"{name} is missing; add its {count} numbers"
    values = entry[name]
    if not isinstance(values, list):
        return f"{name} is {short(values)}; expected {count} numbers"
    if len(values) != count:
        return f"{name} has {len(values)} numbers; expected {count}"
    bad = [value for value in values if not _is_number(value)]
    return f"{name} holds {short(bad[0])}; expected {count} finite numbers" if bad else None


def _finite(rows: list, width: int) -> Float[np.ndarray, "n w"]:
    array = np.array(rows, dtype=float).reshape(len(rows), width)
    if not np.isfinite(array).all():
        raise ValueError
    return array


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float) and abs(value) < 1e300  # false for NaN


def short(value: Any) -> str:
    """The value as text, on one line and cut off when long; it comes from a file that may hold anything."""
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
