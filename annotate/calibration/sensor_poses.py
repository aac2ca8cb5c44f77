"""Where a camera stood in each image, from a marker board (thesis sec. tless_calibration)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pipeline.bop.dataset import Dataset
from pipeline.exceptions import InputError
from pipeline.parallel import HERE, Workers
from pipeline.scene import ImageKey
from pipeline.synth.boards import BoardPose, MarkerBoard, camera_pose, detect


@dataclass(frozen=True, eq=False)
class SensorPoses:
    """Poses of a camera by the markers that it sees."""

    poses: dict[ImageKey, BoardPose]
    failures: dict[ImageKey, str]
    """Why other images have none."""

    @property
    def rms_px(self) -> float:
        """Root mean square of the reprojection errors over all corners of all images, as the thesis states it."""
        return float(np.sqrt(np.concatenate([pose.errors_px.ravel() ** 2 for pose in self.poses.values()]).mean()))

    @property
    def corners(self) -> int:
        """Corners in all images."""
        return sum(pose.errors_px.size for pose in self.poses.values())


def sensor_poses(
    dataset: Dataset, keys: Sequence[ImageKey], boards: Mapping[int, MarkerBoard], workers: Workers = HERE
) -> SensorPoses:
    """Estimate the camera's pose in each image from the board of its scene. Raises InputError if none can be told."""
    poses: dict[ImageKey, BoardPose] = {}
    failures: dict[ImageKey, str] = {}
    for position, found in workers.map_unordered(_pose, keys, (dataset, boards), total=len(keys)):
        if isinstance(found, str):
            failures[keys[position]] = found
        else:
            poses[keys[position]] = found
    if not poses:
        key, reason = next(iter(failures.items()), (None, "there are no images"))
        where = f"scene {key.scene_id} image {key.im_id}: " if key else ""
        raise InputError(f"{dataset.root}: no pose can be told; {where}{reason}")
    return SensorPoses(dict(sorted(poses.items())), dict(sorted(failures.items())))


def _pose(shared: tuple[Dataset, Mapping[int, MarkerBoard]], key: ImageKey) -> BoardPose | str:
    """What a worker does: the pose of one image, or why there is none."""
    dataset, boards = shared
    board = boards.get(key.scene_id)
    try:
        rgb = dataset.rgb(key)
        if rgb is None or board is None:
            return "has no colour image" if rgb is None else "its scene has no board"
        return camera_pose(detect(rgb, board), board, dataset.camera(key))
    except InputError as error:
        return str(error)
