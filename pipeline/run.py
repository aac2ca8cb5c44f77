"""A run folder: what a method found on a dataset, growing image by image.

    RUN/run.json         dataset, method, config, versions, seed, seconds per stage
    RUN/results.csv      a plain BOP results file
    RUN/images.jsonl     one line per finished image, in the order in which they were finished
    RUN/recordings/      one .rrd per image, the meshes and the layout of rerun's viewer

An image counts as finished once its line in `images.jsonl` is whole. The line says how long `results.csv` was then,
so a run that was killed at any moment goes on with exactly the rows of its finished images.
"""

import dataclasses
import fcntl
import json
import math
import os
import threading
from collections import defaultdict
from collections.abc import Iterable, Mapping
from pathlib import Path
from types import TracebackType

import numpy as np

from pipeline.bop.results_csv import HEADER
from pipeline.bop.units import millimetres
from pipeline.exceptions import FormatError, InputError
from pipeline.recording import (
    BLUEPRINT_FILE,
    NullRecorder,
    Recorder,
    recording_name,
    save_blueprint,
    save_models,
    saved_models,
)
from pipeline.run_images import FinishedImage, ImageList, RunWatch
from pipeline.run_info import RUN_FILE, DatasetName, RunInfo, new_info, read_info, same_run, write_info
from pipeline.scene import Camera, ImageKey, Model, PoseEstimate

__all__ = ["IMAGES_FILE", "RECORDINGS_FOLDER", "RESULTS_FILE", "RUN_FILE", "FinishedImage", "Run", "RunWatch"]

RESULTS_FILE = "results.csv"
IMAGES_FILE = "images.jsonl"
RECORDINGS_FOLDER = "recordings"


class Run:
    """A run folder, open for adding images (`create`) or only for reading (`open`)."""

    def __init__(self, root: Path, info: RunInfo, writable: bool) -> None:
        self.root = root
        self.info = info
        self._images = ImageList(root / IMAGES_FILE)
        self._model_ids: frozenset[int] | None = None
        self._lock = threading.Lock()
        self._writer = (root / IMAGES_FILE).open("ab") if writable else None

    @classmethod
    def create(cls, root: Path, *, dataset: DatasetName, method: str, config: object = None, seed: int = 0) -> "Run":
        """Start a run, or go on with the one in the folder if it is of the same dataset, method, config and seed.

        Args:
            root: The folder; made if absent.
            dataset: Name, split and root folder are kept.
            method: Name of the method.
            config: A dataclass or a mapping that JSON can hold.
            seed: Seed of everything random.

        Raises:
            InputError: the folder holds a different run or other files, or another process is writing to it.

        """
        info = cls.check(root, dataset=dataset, method=method, config=config, seed=seed)
        if not (root / RUN_FILE).exists():
            _make_folder(root / RECORDINGS_FOLDER)
            write_info(root, info, {})
        run = cls(root, info, writable=True)
        run._repair()
        return run

    @staticmethod
    def check(root: Path, *, dataset: DatasetName, method: str, config: object = None, seed: int = 0) -> RunInfo:
        """What the run is made of that `create` would start or go on with; nothing is written.

        Raises InputError if the folder holds a different run or other files.
        """
        info = new_info(dataset, method, config, seed)
        if (root / RUN_FILE).exists():
            return same_run(root, read_info(root), info)
        if root.is_dir() and any(not item.name.startswith(".") for item in root.iterdir()):
            raise InputError(f"{root}: holds other files and no {RUN_FILE}; give an empty or new folder")
        return info

    @classmethod
    def open(cls, root: Path) -> "Run":
        """Open a run for reading; it may still be growing.

        Raises:
            MissingFileError: there is no run in the folder.
            FormatError: `run.json` is damaged or of another version.

        """
        return cls(root, read_info(root), writable=False)

    @property
    def results_path(self) -> Path:
        """The BOP results file."""
        return self.root / RESULTS_FILE

    @property
    def recordings(self) -> Path:
        """The folder of recordings."""
        return self.root / RECORDINGS_FOLDER

    def recording_path(self, key: ImageKey) -> Path:
        """Where the recording of an image lies, whether or not it exists."""
        return self.recordings / recording_name(key)

    def recorder(self, key: ImageKey, camera: Camera | None = None, *, enabled: bool = True) -> Recorder | NullRecorder:
        """A recorder for one image, to be used in a `with` block; writes nothing when not enabled."""
        if not enabled:
            return NullRecorder()
        if not (self.recordings / BLUEPRINT_FILE).exists():
            save_blueprint(self.recordings / BLUEPRINT_FILE)
        if self._model_ids is None:
            self._model_ids = saved_models(self.recordings)
        return Recorder(self.recording_path(key), self.info.recording_id, key, camera, model_ids=self._model_ids)

    def save_models(self, models: Iterable[Model]) -> None:
        """Keep the meshes that rerun's viewer draws at the recorded poses."""
        save_models(self.recordings, self.info.recording_id, list(models))
        self._model_ids = None

    def finished(self) -> tuple[FinishedImage, ...]:
        """Everything about the finished images, in the order in which they were finished."""
        self._images.poll()
        return tuple(self._images.images)

    def finished_images(self) -> tuple[ImageKey, ...]:
        """The finished images, in the order in which they were finished."""
        return tuple(image.key for image in self.finished())

    def watch(self) -> "RunWatch":
        """Tell images that are finished from now on; those finished already come with the first `poll`."""
        return RunWatch(self.root / IMAGES_FILE)

    def add(
        self,
        key: ImageKey,
        estimates: Iterable[PoseEstimate],
        timings: Mapping[str, float] | None = None,
        *,
        failure: str | None = None,
    ) -> None:
        """Append the estimates of one image, which is finished thereby; safe from several threads.

        Args:
            key: The image.
            estimates: Poses, all of this image; where `time_s` is -1 the sum of the timings is written.
            timings: Seconds by stage.
            failure: One line that says why the method failed on this image, if it did.

        Raises:
            InputError: an estimate is not finite, or the results cannot be written.
            ValueError: the image is finished already, or an estimate is of another image.

        """
        if self._writer is None:
            raise ValueError(f"{self.root} is open for reading only")
        timings = dict(timings or {})
        rows = [_result_row(self._checked(key, estimate), math.fsum(timings.values())) for estimate in estimates]
        with self._lock:
            if key in self._images.keys:
                raise ValueError(f"scene {key.scene_id}, image {key.im_id} is finished already")
            length = _write_at(self.results_path, self._results_bytes(), "".join(rows).encode())
            image = FinishedImage(*key, len(rows), length, timings, failure)
            line = json.dumps(dataclasses.asdict(image)) + "\n"
            _write_at(self.root / IMAGES_FILE, self._images.offset, line.encode())
            self._images.poll()
            write_info(self.root, self.info, self.timings())

    def timings(self) -> dict[str, float]:
        """Seconds by stage, over all finished images."""
        totals: dict[str, float] = defaultdict(float)
        for image in self.finished():
            for stage, seconds in image.timings.items():
                totals[stage] += seconds
        return dict(totals)

    def close(self) -> None:
        """Let other processes write to the folder."""
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def __enter__(self) -> "Run":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None:
        self.close()

    def _checked(self, key: ImageKey, estimate: PoseEstimate) -> PoseEstimate:
        if estimate.image != key:
            raise ValueError(f"an estimate of {estimate.image} was given with {key}")
        if not (np.isfinite(estimate.camera_from_model).all() and np.isfinite(estimate.score)):
            where = f"scene {key.scene_id}, image {key.im_id}, object {estimate.obj_id}"
            raise InputError(
                f"{where}: {self.info.method} gave a pose or score that is not finite; drop it in the method"
            )
        return estimate

    def _results_bytes(self) -> int:
        """Length of `results.csv` with the rows of the finished images."""
        images = self._images.images
        return images[-1].results_bytes if images else len(HEADER) + 1

    def _repair(self) -> None:
        """Take the folder for this process, and drop what belongs to the image that a killed process was at."""
        assert self._writer is not None
        try:
            fcntl.flock(self._writer, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise InputError(
                f"{self.root}: another process is writing to this run; wait or give another folder"
            ) from error
        finished = self.finished()
        os.truncate(self.root / IMAGES_FILE, self._images.offset)
        length = self._results_bytes()
        found = self.results_path.stat().st_size if self.results_path.exists() else 0
        if not finished and found < length:
            self.results_path.write_text(HEADER + "\n")
        elif found < length:
            text = f"has {found} bytes, {IMAGES_FILE} says {length}; restore it or start a new run"
            raise FormatError(f"{self.results_path}: {text}")
        os.truncate(self.results_path, length)


def _make_folder(path: Path) -> None:
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be made ({error.strerror}); give a folder that you may write to") from error


def _write_at(path: Path, start: int, content: bytes) -> int:
    """Let a file end with this content from `start` on, and wait until it is on the disk; returns its length."""
    try:
        with path.open("r+b", buffering=0) as file:
            try:
                file.seek(start)
                if file.write(content) != len(content):
                    raise OSError(None, "no space left on the device")
                os.fsync(file.fileno())
            except OSError:
                file.truncate(start)
                raise
            return start + len(content)
    except OSError as error:
        raise InputError(f"{path}: cannot write: {error.strerror}; free space and run again to go on") from error


def _result_row(estimate: PoseEstimate, seconds: float) -> str:
    """A line of a BOP results file; floats are written so that they read back exactly."""
    rotation = " ".join(repr(float(value)) for value in estimate.camera_from_model[:3, :3].flat)
    translation_mm = " ".join(repr(float(value)) for value in millimetres(estimate.camera_from_model[:3, 3]))
    time_s = estimate.time_s if estimate.time_s >= 0 or not seconds else seconds
    ids = f"{estimate.scene_id},{estimate.im_id},{estimate.obj_id}"
    return f"{ids},{float(estimate.score)!r},{rotation},{translation_mm},{float(time_s)!r}\n"
