"""The recorder: the only way in which a stage shows what it saw."""

from abc import ABC, abstractmethod
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Num, UInt8

from pipeline.recording.entities import check_entity
from pipeline.recording.files import write_checked
from pipeline.recording.records import (
    KINDS,
    ColorImage,
    Correspondences,
    DepthMap,
    Heatmap,
    Hypotheses,
    Mask,
    Probabilities,
    Record,
    Series,
    Table,
    Text,
    View,
)
from pipeline.scene import Camera, GroundTruth, ImageKey, Model, PoseEstimate

MODELS_FILE = "models.rrd"
"""Recording of the meshes that rerun's viewer draws at the poses of all images of a run."""

IMAGE_TIMELINE = "image"
"""Timeline on which scene 2, image 3 is at 2000003."""

POSE_PATHS = ("estimates", "ground_truth")
"""Paths of the poses at which the viewer draws models."""

_IMAGES_PER_SCENE = 1_000_000


class StageRecorder(ABC):
    """What a stage is given: one method per kind of thing, each with the entity path first.

    Paths are those of `pipeline.recording.entities`, or anything below `method/`; shapes, frames and units are
    those of the dataclasses in `pipeline.recording.records`. What is costly to compute and only for recording stands
    behind `if recorder.enabled:`.
    """

    enabled: bool
    """False when nothing is kept."""

    @abstractmethod
    def __enter__(self) -> "StageRecorder": ...

    @abstractmethod
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None: ...

    @abstractmethod
    def log(self, path: str, record: Record) -> None:
        """Record a thing of any kind; several at one path are kept in order.

        Raises:
            UnknownIdError: the path is neither in the table of entities nor below `method/`.
            ValueError: the path is for another kind.

        """

    def image(self, path: str, rgb: UInt8[np.ndarray, "h w 3"]) -> None:
        """Record a colour image."""
        self.log(path, ColorImage(rgb))

    def depth(self, path: str, depth: Float[np.ndarray, "h w"]) -> None:
        """Record a depth image in metres, 0 where not measured."""
        self.log(path, DepthMap(depth))

    def heatmap(self, path: str, values: Num[np.ndarray, "h w"], *, cell_px: int = 1, unit: str = "") -> None:
        """Record a number per pixel, or per square of `cell_px` pixels."""
        self.log(path, Heatmap(values, cell_px, unit))

    def mask(self, path: str, mask: Bool[np.ndarray, "h w"]) -> None:
        """Record a set of pixels."""
        self.log(path, Mask(mask))

    def probabilities(
        self,
        path: str,
        values: Float[np.ndarray, "k c"],
        *,
        cells: Int[np.ndarray, "k 2"],
        grid: tuple[int, int],
        cell_px: int = 1,
        labels: Sequence[str] = (),
        points_in_model: Float[np.ndarray, "k c 3"] | None = None,
    ) -> None:
        """Record distributions over c classes at k cells (column, row) of a grid (height, width)."""
        self.log(path, Probabilities(values, cells, grid, cell_px, tuple(labels), points_in_model))

    def correspondences(
        self,
        path: str,
        obj_id: int,
        pixels: Float[np.ndarray, "n 2"],
        points_in_model: Float[np.ndarray, "n 3"],
        confidence: Float[np.ndarray, "n"],
        *,
        fragment_ids: Int[np.ndarray, "n"] | None = None,
    ) -> None:
        """Record 2D-3D correspondences: pixels (u, v), points in metres."""
        self.log(path, Correspondences(obj_id, pixels, points_in_model, confidence, fragment_ids))

    def poses(self, path: str, poses: Sequence[PoseEstimate] | Sequence[GroundTruth]) -> None:
        """Record poses below a path: estimates at their position in the sequence, ground truth at its index."""
        for position, pose in enumerate(poses):
            self.log(f"{path}/{pose.index if isinstance(pose, GroundTruth) else position}", pose)

    def hypotheses(
        self,
        path: str,
        obj_id: int,
        camera_from_model: Float[np.ndarray, "n 4 4"],
        quality: Float[np.ndarray, "n"],
        *,
        steps: Int[np.ndarray, "n"] | None = None,
        instances: Int[np.ndarray, "n"] | None = None,
        samples: Int[np.ndarray, "n 3"] | None = None,
        labels: Sequence[str] = (),
    ) -> None:
        """Record the poses that a search looked at, in its order; metres."""
        self.log(path, Hypotheses(obj_id, camera_from_model, quality, steps, instances, samples, tuple(labels)))

    def scalars(self, path: str, values: Num[np.ndarray, "n"], steps: Int[np.ndarray, "n"] | None = None) -> None:
        """Record a number over steps (0, 1, 2, ... when not given)."""
        self.log(path, Series(values, np.arange(len(values)) if steps is None else steps))

    def text(self, path: str, text: str, level: str = "INFO") -> None:
        """Record a message."""
        self.log(path, Text(text, level))

    def table(self, path: str, columns: Mapping[str, np.ndarray]) -> None:
        """Record named columns of equal length."""
        self.log(path, Table(columns))


class NullRecorder(StageRecorder):
    """Records nothing, at no cost."""

    enabled = False

    def __enter__(self) -> "NullRecorder":
        return self

    def log(self, *args: Any, **kwargs: Any) -> None:
        """Nothing."""

    image = depth = heatmap = mask = probabilities = correspondences = log
    poses = hypotheses = scalars = text = table = __exit__ = log


class Recorder(StageRecorder):
    """Records one image to one file, written whole when its `with` block ends, or not at all if that fails.

        with run.recorder(key, camera) as recorder:
            recorder.image("image/rgb", image.rgb)

    Everything is held in memory until then. One recorder belongs to one thread.
    """

    enabled = True

    def __init__(
        self,
        path: Path,
        recording_id: str,
        key: ImageKey,
        camera: Camera | None = None,
        *,
        model_ids: Collection[int] = (),
    ) -> None:
        """Begin a recording.

        Args:
            path: The file; its folder is made if absent.
            recording_id: Shared by the images of a run.
            key: The image.
            camera: Its camera, None where there is none (training of a network).
            model_ids: Objects whose meshes `save_models` has written for this run.

        """
        from pipeline.recording.stream import ChunkStream

        self._path = path
        self._model_ids = model_ids
        self._undrawn = set(POSE_PATHS)
        self._stream = ChunkStream(recording_id)
        self._stream.set_name(f"scene {key.scene_id}, image {key.im_id}")
        self._stream.set_time(IMAGE_TIMELINE, key.scene_id * _IMAGES_PER_SCENE + key.im_id)
        if camera is None:
            self.log("image", View(*key))
        else:
            self.log("image", View(*key, camera.K, camera.width, camera.height, camera.world_from_camera))

    def log(self, path: str, record: Record) -> None:
        """Record a thing of any kind."""
        kind = KINDS.get(type(record))
        if kind is None:
            raise ValueError(f"cannot record a {type(record).__name__}; known: {', '.join(t.__name__ for t in KINDS)}")
        check_entity(path, kind)
        self._stream.log(path, record)

    def poses(self, path: str, poses: Sequence[PoseEstimate] | Sequence[GroundTruth]) -> None:
        """Record poses, and let the viewer draw the models of the run there."""
        super().poses(path, poses)
        by_object: dict[int, list[PoseEstimate | GroundTruth]] = defaultdict(list)
        for pose in poses:
            by_object[pose.obj_id].append(pose)
        self._stream.draw_models(path, by_object, self._model_ids)
        self._undrawn.discard(path)

    def finish(self) -> None:
        """Write the file; called at the end of the `with` block.

        Raises:
            RecordingError: it cannot be written.

        """
        for path in self._undrawn:
            self._stream.draw_models(path, {}, self._model_ids)
        write_checked(self._path, self._stream.close())

    def __enter__(self) -> "Recorder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        if error is None:
            self.finish()
        else:
            self._stream.close()


def save_models(folder: Path, recording_id: str, models: Sequence[Model]) -> None:
    """Write the meshes that rerun's viewer draws at the poses of a run's recordings.

    Raises:
        RecordingError: the file cannot be written.

    """
    from pipeline.recording.stream import ChunkStream

    stream = ChunkStream(recording_id)
    for model in models:
        stream.log_mesh(model)
    write_checked(folder / MODELS_FILE, stream.close())


def saved_models(folder: Path) -> frozenset[int]:
    """Ids of the objects whose meshes are in a folder of recordings."""
    path = folder / MODELS_FILE
    if not path.is_file():
        return frozenset()
    from rerun.chunk import RrdReader

    columns = RrdReader(path).store().schema().component_columns()
    parts = [column.entity_path.split("/") for column in columns]
    return frozenset(int(part[-1]) for part in parts if part[1] == "models")
