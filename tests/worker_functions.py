"""What tests have other processes do: functions that these can import."""

import os
import signal
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.evaluation.columns import Columns
from pipeline.bop.evaluation.evaluate import localization_columns
from pipeline.bop.results import Results
from pipeline.exceptions import InputError, UnknownIdError
from pipeline.recording import StageRecorder
from pipeline.scene import Image, PoseEstimate, Target


def square(offset: int, item: int) -> int:
    return offset + item * item


def process_of(_: Any, item: float) -> int:
    """The process that an item is done in, after some work."""
    time.sleep(item)
    return os.getpid()


def remember(seen: list[int], item: int) -> tuple[int, int]:
    """Process, and number of items that have been given the same `seen`."""
    seen.append(item)
    return os.getpid(), len(seen)


def fail(kind: str, item: int) -> int:
    if item != 5:
        return item
    if kind == "system":
        raise FileNotFoundError(2, "No such file", "depth.png")
    if kind == "foreign":
        raise ForeignError(open)
    raise UnknownIdError("object", 31, "lmo", [1, 5])


class ForeignError(Exception):
    """Holds what cannot be pickled."""

    def __init__(self, thing: Any) -> None:
        super().__init__("it is foreign")
        self.thing = lambda: thing


def unfit_to_send(_: None, item: int) -> Any:
    return lambda: item


def die_once(folder: Path, item: int) -> int:
    """Kill the process at the first try of every fifth item."""
    try:
        if item % 5 == 0:
            (folder / str(item)).touch(exist_ok=False)
            os.kill(os.getpid(), signal.SIGKILL)
    except FileExistsError:
        pass
    return item


def die(_: None, item: int) -> int:
    """Kill the process at one of the items, always."""
    if item == 3:
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def wait_for_ever(folder: Path, item: int) -> None:
    """Leave a file that is removed when the work is ended in good order."""
    path = folder / f"{os.getpid()}"
    try:
        path.touch()
        while True:
            time.sleep(0.01)
    finally:
        path.unlink(missing_ok=True)


def threads(_: None, item: int) -> tuple[int, int]:
    """Number of threads after rays were cast, and of the cores that this one may use."""
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    triangle = o3d.core.Tensor.from_numpy(np.eye(3, dtype=np.float32))
    scene.add_triangles(triangle, o3d.core.Tensor.from_numpy(np.array([[0, 1, 2]], np.uint32)))
    scene.cast_rays(o3d.core.Tensor.from_numpy(np.ones((100_000, 6), np.float32)))
    return len(list(Path("/proc/self/task").iterdir())), len(os.sched_getaffinity(0))


def slow_columns(
    dataset: Dataset, results: Results, targets: Sequence[Target], seconds: float = 0.0, folder: Path | None = None
) -> Columns:
    """Columns of localization without VSD, later; each call leaves a file named by its first image."""
    time.sleep(seconds)
    if folder is not None:
        first = targets[0]
        (folder / f"{first.scene_id}-{first.im_id}-{time.monotonic_ns()}").touch()
    return localization_columns(dataset, results, targets, with_vsd=False)


def rows_of_results(dataset: Dataset, results: Results, targets: Sequence[Target]) -> Columns:
    """Rows of the estimates of every target, and -1 for its instance."""
    return {"row": np.array([row for target in targets for row in [*results.rows(target.image, target.obj_id), -1]])}


class Annotated:
    """Gives the annotated poses; at some images it fails, or ends its process once or always."""

    def __init__(self, root: Path, marks: Path, fails: int = -1, dies_once: int = -1, dies: int = -1) -> None:
        self._dataset, self._marks = open_dataset(root), marks
        self._fails, self._dies_once, self._dies = fails, dies_once, dies
        with (marks / f"made-{os.getpid()}").open("a") as mark:
            mark.write("made\n")

    def estimate(self, image: Image, targets: Sequence[Target], recorder: StageRecorder) -> list[PoseEstimate]:
        im_id = image.key.im_id
        with (self._marks / f"image-{im_id}").open("a") as mark:
            mark.write(f"{os.getpid()}\n")
        if im_id == self._fails:
            raise InputError(f"image {im_id} is too dark; light it")
        if im_id == self._dies or (im_id == self._dies_once and not (self._marks / "died").exists()):
            (self._marks / "died").touch()
            os.kill(os.getpid(), signal.SIGKILL)
        truths = self._dataset.ground_truth(image.key)
        return [PoseEstimate(*image.key, gt.obj_id, 0.5, gt.camera_from_model) for gt in truths]


def without_network(root: Path) -> Annotated:
    raise InputError(f"{root}: the network file is absent; download it")
