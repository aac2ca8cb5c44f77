"""The JSON files of one scene as bulk arrays: cameras (`scene_camera`) and ground truth (`scene_gt`, `scene_gt_info`).

A damaged entry costs its image only, a damaged file its scene only: what is wrong is kept as text and raised when
that image is asked for. Millimetres become metres here.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from pipeline.bop.annotation_entries import (
    camera_columns,
    camera_problem,
    columns_of,
    ground_truth_columns,
    ground_truth_problem,
    short,
)
from pipeline.bop.json_files import collection_paused, read_json_object
from pipeline.exceptions import FormatError, InputError
from pipeline.geometry import inverse
from pipeline.scene import GroundTruth


@dataclass(frozen=True, eq=False)
class SceneCameras:
    """The cameras of a scene's images."""

    path: Path
    rows: Mapping[int, int]
    """Row in the arrays of each image id."""
    K: Float[np.ndarray, "n 3 3"]
    depth_scale_mm: Float[np.ndarray, "n"]
    """Millimetres of one unit of the depth image; 1 where the file says nothing."""
    world_from_camera: Float[np.ndarray, "n 4 4"]
    """Metres; NaN where the file says nothing."""
    damage: Mapping[int | None, str] = field(default_factory=dict)
    """What is wrong by image id; None stands for the whole file."""

    def row(self, im_id: int) -> int:
        """Row of an image. Raises FormatError if its entry is damaged or missing."""
        _raise_damage(self.damage, im_id)
        if im_id not in self.rows:
            raise FormatError(f"{self.path}: image {im_id} has no entry; add its cam_K")
        return self.rows[im_id]


@dataclass(frozen=True, eq=False)
class SceneGroundTruth:
    """All annotations of a scene, image by image."""

    path: Path
    spans: Mapping[int, slice]
    """Rows in the arrays of each image id."""
    im_ids: Int[np.ndarray, "n"]
    obj_ids: Int[np.ndarray, "n"]
    camera_from_model: Float[np.ndarray, "n 4 4"]
    """Metres; rotations as annotated."""
    visible_fraction: Float[np.ndarray, "n"]
    """0..1, NaN where unknown."""
    visible_pixels: Float[np.ndarray, "n"]
    """NaN where unknown."""
    bbox_visible: Float[np.ndarray, "n 4"]
    """x, y, width, height in pixels, NaN where unknown."""
    damage: Mapping[int | None, str] = field(default_factory=dict)
    """What is wrong by image id; None stands for the whole file."""
    warnings: tuple[str, ...] = ()
    """What is wrong with `scene_gt_info`, without which poses are still usable."""

    def of_image(self, im_id: int) -> tuple[GroundTruth, ...]:
        """Annotations of an image, in the order of the file. Raises FormatError if one of them is damaged."""
        _raise_damage(self.damage, im_id)
        span = self.spans.get(im_id, slice(0, 0))
        poses = self.camera_from_model[span]
        fractions, pixels = self.visible_fraction[span].tolist(), self.visible_pixels[span].tolist()
        rows = zip(self.obj_ids[span].tolist(), poses, fractions, pixels, self.bbox_visible[span].tolist(), strict=True)
        return tuple(
            GroundTruth(obj_id, pose, index, _known(share), None if count != count else int(count), _known_box(box))
            for index, (obj_id, pose, share, count, box) in enumerate(rows)
        )


@collection_paused()
def read_cameras(path: Path) -> SceneCameras:
    """Read a `scene_camera.json`; never raises for its content, see `damage`."""
    content, damage = _read_by_image(path, dict)
    images, (K, scales, R, t), damaged = columns_of(content, camera_columns, camera_problem)
    damage |= {im_id: f"{path}: image {im_id}{text}" for im_id, text in damaged.items()}
    return SceneCameras(
        path=path,
        rows={im_id: row for row, im_id in enumerate(images)},
        K=K.reshape(-1, 3, 3),
        depth_scale_mm=scales,
        world_from_camera=_poses(R, t, invert=True),
        damage=damage,
    )


@collection_paused()
def read_ground_truth(path: Path, info_path: Path) -> SceneGroundTruth:
    """Read `scene_gt.json` and `scene_gt_info.json`, if they exist; never raises for their content, see `damage`."""
    content, damage = _read_by_image(path, list) if path.is_file() else ({}, {})
    images, (obj_ids, R, t), damaged = columns_of(content, ground_truth_columns, ground_truth_problem)
    damage |= {im_id: f"{path}: image {im_id}{text}" for im_id, text in damaged.items()}
    counts = np.array([len(entries) for entries in images.values()], dtype=int)
    ends = np.cumsum(counts)
    warnings: list[str] = []
    fraction, pixels, boxes = _read_info(info_path, images, warnings)
    return SceneGroundTruth(
        path=path,
        spans={
            im_id: slice(end - n, end) for im_id, n, end in zip(images, counts.tolist(), ends.tolist(), strict=True)
        },
        im_ids=np.repeat(np.array(list(images), dtype=np.int64), counts),
        obj_ids=obj_ids,
        camera_from_model=_poses(R, t),
        visible_fraction=fraction,
        visible_pixels=pixels,
        bbox_visible=boxes,
        damage=damage,
        warnings=tuple(warnings),
    )


def _read_by_image(path: Path, kind: type) -> tuple[dict[int, Any], dict[int | None, str]]:
    """Entries of a file by image id in order, and what is wrong."""
    try:
        content = read_json_object(path)
        entries = {int(key): value for key, value in content.items()}
    except InputError as error:
        return {}, {None: str(error)}
    except ValueError as error:
        return {}, {None: f"{path}: a key is no image id ({error}); expected whole numbers as keys"}
    name = {dict: "an object {...}", list: "a list [...]"}[kind]
    wrong: dict[int | None, str] = {
        i: f"{path}: image {i} holds {short(v)}; expected {name}" for i, v in entries.items() if type(v) is not kind
    }
    return {im_id: entries[im_id] for im_id in sorted(entries) if im_id not in wrong}, wrong


def _read_info(path: Path, images: dict[int, list], warnings: list[str]) -> tuple[np.ndarray, ...]:
    """Visible fraction, visible pixels and visible box of every annotation, NaN where unknown."""
    infos: dict[int, Any] = {}
    if path.is_file():
        infos, damage = _read_by_image(path, list)
        warnings += damage.values()
    unmatched = [im_id for im_id, gts in images.items() if im_id in infos and len(infos[im_id]) != len(gts)]
    if unmatched:
        warnings.append(
            f"{path}: image {unmatched[0]} has {len(infos[unmatched[0]])} entries for {len(images[unmatched[0]])} "
            f"annotations (so do {len(unmatched)} images); compute the file again"
        )
        infos = {im_id: infos[im_id] for im_id in infos.keys() - set(unmatched)}
    entries = [info for im_id, gts in images.items() for info in infos.get(im_id, [{}] * len(gts))]
    try:
        values = np.array(
            [
                (e.get("visib_fract", _NAN), e.get("px_count_visib", _NAN), *e.get("bbox_visib", _NO_BOX))
                for e in entries
            ],
            dtype=float,
        ).reshape(-1, 6)
        if len(values) != len(entries):
            raise ValueError
    except (AttributeError, TypeError, ValueError):
        warnings.append(f"{path}: an entry is not as expected, all are ignored; compute the file again")
        values = np.full((len(entries), 6), _NAN)
    return values[:, 0], values[:, 1], values[:, 2:]


_NAN = float("nan")
_NO_BOX = (_NAN,) * 4


def _poses(
    R: Float[np.ndarray, "n 9"], t_mm: Float[np.ndarray, "n 3"], invert: bool = False
) -> Float[np.ndarray, "n 4 4"]:
    poses = np.zeros((len(R), 4, 4))
    poses[:, :3, :3] = R.reshape(-1, 3, 3)
    poses[:, :3, 3] = t_mm / 1000.0
    poses[:, 3, 3] = 1.0
    if invert:
        known = np.isfinite(poses).all(axis=(1, 2))
        poses[~known] = np.eye(4)
        known &= np.linalg.det(poses[:, :3, :3]) != 0
        poses[known] = inverse(poses[known])
        poses[~known] = _NAN
    return poses


def _raise_damage(damage: Mapping[int | None, str], im_id: int) -> None:
    text = damage.get(None) or damage.get(im_id)
    if text:
        raise FormatError(text)


def _known(value: float) -> float | None:
    return None if value != value else value


def _known_box(box: list[float]) -> tuple[float, float, float, float] | None:
    return None if box[0] != box[0] else (box[0], box[1], box[2], box[3])
