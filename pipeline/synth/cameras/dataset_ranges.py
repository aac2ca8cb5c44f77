"""The ranges of cameras that a dataset's ground-truth poses cover (thesis sec. synth_composition, synth_bop20)."""

from collections.abc import Iterator
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Float

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.exceptions import InputError
from pipeline.geometry import inverse
from pipeline.scene import ImageKey
from pipeline.synth.cameras.ranges import FULL_TURN, CameraRanges, Range, Viewpoint, viewpoints_of

Axes = Literal["world", "model"]
"""Whose z axis is up: the scene's world frame or the annotated object's own frame."""


def ranges_of_dataset(
    dataset: Dataset | Path,
    split: str | None = None,
    axes: Axes | None = None,
    roll_deg: Range | None = (-180.0, 180.0),
) -> CameraRanges:
    """Find the smallest ranges that hold the cameras of all annotated instances, each camera seen from its instance.

    The distance is |t| of `camera_from_model`: that of the camera from the origin of the model frame, which in BOP is
    the centre of the model's bounding box. The direction from that origin to the camera gives azimuth and elevation,
    in the world frame (`axes` "world") or in the frame of the model ("model"); in both, z counts as up. "world" needs
    camera poses and is right where the world stands upright, as on a turntable. "model" is right where the objects do,
    as in LM and LM-O, whose models have z up; objects that lie on their sides lend it other elevations. By default it
    is "world" where every annotated image has a camera pose, else "model". Azimuths make up the smallest arc that
    holds them all. The in-plane rotation is random in the thesis: `roll_deg` is taken as given, None measures it too.
    Raises InputError if nothing is annotated or "world" is asked for and an image has no camera pose.
    """
    if not isinstance(dataset, Dataset):
        dataset = open_dataset(dataset, split)
    elif split is not None and split != dataset.split:
        dataset = open_dataset(dataset.root, split)
    found = viewpoints_of_dataset(dataset, axes)
    return CameraRanges(
        azimuth_deg=smallest_arc(np.asarray(found.azimuth_deg)),
        elevation_deg=(float(np.min(found.elevation_deg)), float(np.max(found.elevation_deg))),
        distance=(float(np.min(found.distance)), float(np.max(found.distance))),
        roll_deg=smallest_arc(np.asarray(found.roll_deg)) if roll_deg is None else roll_deg,
    )


def viewpoints_of_dataset(dataset: Dataset, axes: Axes | None = None) -> Viewpoint:
    """Viewpoints of all annotated instances, as arrays; see `ranges_of_dataset`."""
    im_keys, poses = _annotations(dataset)
    if not len(poses):
        raise InputError(
            f"{dataset.root / dataset.split}: has no ground-truth poses; give the ranges yourself or take another split"
        )
    worlds = None if axes == "model" else _world_from_cameras(dataset, im_keys, needed=axes == "world")
    if worlds is None:
        cameras, centres = inverse(poses), np.zeros((len(poses), 3))
    else:
        cameras, centres = worlds, (worlds @ poses)[:, :3, 3]
    found = viewpoints_of(cameras, centres)
    return found._replace(distance=np.linalg.norm(poses[:, :3, 3], axis=1))


def smallest_arc(angles_deg: Float[np.ndarray, "n"]) -> Range:
    """Begin and end of the shortest arc that holds all angles; it begins in -180..180 and may end beyond 180."""
    found = np.unique(angles_deg % FULL_TURN)
    gaps = np.diff(found, append=found[0] + FULL_TURN)
    widest = int(np.argmax(gaps))
    low = float(found[(widest + 1) % len(found)])
    low -= FULL_TURN if low >= 180 else 0.0
    return low, low + FULL_TURN - float(gaps[widest])


def _annotations(dataset: Dataset) -> tuple[list[ImageKey], Float[np.ndarray, "n 4 4"]]:
    """Image and `camera_from_model` of every annotated instance whose object is before the camera."""
    keys: list[ImageKey] = []
    poses: list[Float[np.ndarray, "4 4"]] = []
    for key, pose in _each(dataset):
        if pose[2, 3] > 0:
            keys.append(key)
            poses.append(pose)
    return keys, np.array(poses).reshape(-1, 4, 4)


def _each(dataset: Dataset) -> Iterator[tuple[ImageKey, Float[np.ndarray, "4 4"]]]:
    for scene_id in dataset.scene_ids:
        truth = dataset.scene_ground_truth(scene_id)
        for im_id, pose in zip(truth.im_ids.tolist(), truth.camera_from_model, strict=True):
            yield ImageKey(scene_id, im_id), pose


def _world_from_cameras(dataset: Dataset, im_keys: list[ImageKey], needed: bool) -> Float[np.ndarray, "n 4 4"] | None:
    """Camera pose of each image; None where one has none, unless it is needed."""
    known: dict[ImageKey, Float[np.ndarray, "4 4"]] = {}
    for key in dict.fromkeys(im_keys):
        pose = dataset.camera(key).world_from_camera
        if pose is None:
            if needed:
                raise InputError(
                    f"{dataset.root / dataset.split}: scene {key.scene_id}, image {key.im_id} has no camera pose "
                    "(cam_R_w2c, cam_t_w2c); take the axes of the models"
                )
            return None
        known[key] = pose
    return np.array([known[key] for key in im_keys])
