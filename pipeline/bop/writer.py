"""Writing scenes in the BOP scenewise format; every file appears in whole or not at all, the JSON files last."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import orjson
from jaxtyping import Bool, Float

from pipeline.bop.json_files import read_json_object, write_atomically, write_json_by_id
from pipeline.bop.units import millimetres
from pipeline.exceptions import InputError
from pipeline.geometry import inverse
from pipeline.scene import Camera, GroundTruth, Image, Target

Mask = Bool[np.ndarray, "h w"]


@dataclass(frozen=True, eq=False)
class AnnotatedImage:
    """An image with what is to be written about it."""

    image: Image
    ground_truth: Sequence[GroundTruth] | None = None
    """None where nothing is known; an empty sequence says that the image shows no object."""
    masks: Sequence[Mask] | None = None
    """Full silhouette of each annotation, in the order of `ground_truth`."""
    visible_masks: Sequence[Mask] | None = None
    """Visible silhouette of each annotation, in the order of `ground_truth`."""


def write_scene(
    root: Path,
    split: str,
    scene_id: int,
    images: Iterable[AnnotatedImage],
    depth_scale_mm: float = 0.1,
    rgb_suffix: str = ".png",
) -> Path:
    """Write images of one scene and return its folder; images that the scene already has and that are not given stay.

    `images` may be a generator: each is written when it comes. Depth is stored in 16 bits, `depth_scale_mm`
    millimetres each. Masks give `scene_gt_info.json` with the sizes of the silhouettes inside the image.
    Raises InputError if a depth does not fit or a file cannot be written.
    """
    folder = Path(root) / split / f"{scene_id:06d}"
    cameras: dict[int, Any] = {}
    truths: dict[int, Any] = {}
    infos: dict[int, Any] = {}
    for item in images:
        im_id = item.image.key.im_id
        write_image_files(folder, item, depth_scale_mm, rgb_suffix)
        cameras[im_id] = camera_entry(item.image.camera, depth_scale_mm)
        if item.ground_truth is not None:
            truths[im_id] = [ground_truth_entry(truth) for truth in item.ground_truth]
            infos[im_id] = _info_entries(item)
    for stem, entries in (("scene_camera", cameras), ("scene_gt_info", infos), ("scene_gt", truths)):
        if entries:
            _update_json(folder / f"{stem}.json", entries)
    return folder


def write_ground_truth(path: Path, ground_truth: Mapping[int, Sequence[GroundTruth]]) -> None:
    """Write a whole `scene_gt.json` of annotations by image id. Raises InputError if it cannot be written."""
    write_json_by_id(
        path, {im_id: [ground_truth_entry(truth) for truth in truths] for im_id, truths in ground_truth.items()}
    )


def write_targets(path: Path, targets: Iterable[Target]) -> None:
    """Write a list of targets such as `test_targets_bop19.json`. Raises InputError if it cannot be written."""
    lines = [f"  {orjson.dumps(target._asdict()).decode()}" for target in targets]
    write_atomically(path, ("[\n" + ",\n".join(lines) + "\n]\n").encode())


def ground_truth_entry(truth: GroundTruth) -> dict[str, Any]:
    """An annotation as in `scene_gt.json`."""
    pose = truth.camera_from_model
    return {**_pose_entry(pose, "m2c"), "obj_id": truth.obj_id}


def camera_entry(camera: Camera, depth_scale_mm: float) -> dict[str, Any]:
    """A camera as in `scene_camera.json`."""
    entry: dict[str, Any] = {"cam_K": np.asarray(camera.K, float).ravel().tolist(), "depth_scale": depth_scale_mm}
    if camera.world_from_camera is not None:
        entry |= _pose_entry(inverse(camera.world_from_camera), "w2c")
    return entry


def _pose_entry(pose: Float[np.ndarray, "4 4"], frames: str) -> dict[str, list[float]]:
    rotation = np.asarray(pose[:3, :3], dtype=float)
    return {f"cam_R_{frames}": rotation.ravel().tolist(), f"cam_t_{frames}": millimetres(pose[:3, 3]).tolist()}


def write_image_files(folder: Path, item: AnnotatedImage, depth_scale_mm: float, rgb_suffix: str) -> None:
    """Write colour, depth and masks of an image into the scene's folder, and none of its JSON files.

    Raises InputError if a depth does not fit or a file cannot be written.
    """
    name = f"{item.image.key.im_id:06d}"
    if item.image.rgb is not None:
        _write_image(folder / "rgb" / f"{name}{rgb_suffix}", cv2.cvtColor(item.image.rgb, cv2.COLOR_RGB2BGR))
    if item.image.depth is not None:
        path = folder / "depth" / f"{name}.png"
        _write_image(path, _raw_depth(path, item.image.depth, depth_scale_mm))
    for kind, masks in (("mask", item.masks), ("mask_visib", item.visible_masks)):
        for index, mask in enumerate(masks or ()):
            _write_image(folder / kind / f"{name}_{index:06d}.png", np.asarray(mask, bool).astype(np.uint8) * 255)


def _write_image(path: Path, pixels: np.ndarray) -> None:
    quality = [cv2.IMWRITE_JPEG_QUALITY, 95] if path.suffix in (".jpg", ".jpeg") else []
    write_atomically(path, cv2.imencode(path.suffix, pixels, quality)[1].tobytes())


def _raw_depth(path: Path, depth: Float[np.ndarray, "h w"], depth_scale_mm: float) -> np.ndarray:
    raw = np.round(depth.astype(np.float64) * (1000.0 / depth_scale_mm))
    if not (raw.min(initial=0) >= 0 and raw.max(initial=0) <= 65535):  # also false for NaN
        limit = 65.535 * depth_scale_mm
        raise InputError(
            f"{path}: depth from {np.min(depth):.4g} to {np.max(depth):.4g} m does not fit in 0 to {limit:.4g} m; "
            f"take a depth_scale above {depth_scale_mm:g} and 0 for what is not measured"
        )
    return raw.astype(np.uint16)


def _info_entries(item: AnnotatedImage) -> list[dict[str, Any]]:
    """Entries of `scene_gt_info.json`: from the masks where they are given, else what the annotations know."""
    truths = item.ground_truth or ()
    if item.masks is None or item.visible_masks is None:
        return [_known_info(truth) for truth in truths]
    triples = zip(truths, item.masks, item.visible_masks, strict=True)
    return [_measured_info(mask, visible, item.image.depth) | _known_info(truth) for truth, mask, visible in triples]


def _known_info(truth: GroundTruth) -> dict[str, Any]:
    bbox = None if truth.bbox_visible is None else list(truth.bbox_visible)
    entry = {"bbox_visib": bbox, "px_count_visib": truth.visible_pixels, "visib_fract": truth.visible_fraction}
    return {name: value for name, value in entry.items() if value is not None}


def _measured_info(mask: Mask, visible: Mask, depth: Float[np.ndarray, "h w"] | None) -> dict[str, Any]:
    count, count_visible = int(mask.sum()), int(visible.sum())
    return {
        "bbox_obj": _bbox(mask),
        "bbox_visib": _bbox(visible),
        "px_count_all": count,
        "px_count_valid": count if depth is None else int((mask & (depth > 0)).sum()),
        "px_count_visib": count_visible,
        "visib_fract": count_visible / count if count else 0.0,
    }


def _bbox(mask: Mask) -> list[int]:
    """x, y and the differences to the last column and row, as BOP counts them; -1 four times for an empty mask."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    if not len(rows):
        return [-1, -1, -1, -1]
    left, top = int(columns[0]), int(rows[0])
    return [left, top, int(columns[-1]) - left, int(rows[-1]) - top]


def _update_json(path: Path, entries: dict[int, Any]) -> None:
    old = {int(key): value for key, value in read_json_object(path).items()} if path.is_file() else {}
    write_json_by_id(path, old | entries)
