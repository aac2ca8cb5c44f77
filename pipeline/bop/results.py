"""Pose estimates in BOP's results format: a CSV file with `scene_id,im_id,obj_id,score,R,t,time`.

Numbers are kept as they were submitted, millimetres included, so that reading and writing again changes nothing.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from pipeline.bop.json_files import write_atomically
from pipeline.bop.results_csv import HEADER, MAX_ROWS, Scan, scan
from pipeline.bop.units import millimetres
from pipeline.exceptions import FormatError, MissingFileError
from pipeline.geometry import transform
from pipeline.scene import ImageKey, PoseEstimate

_FILE_NAME = re.compile(
    r"(?P<method>.+?)_(?P<dataset>[A-Za-z0-9]+)-(?P<split>(?:test|val|train)[A-Za-z0-9]*)(?:-[A-Za-z0-9]+)?(?:_.*)?"
)


@dataclass(frozen=True, eq=False)
class Results:
    """All pose estimates of a method on a dataset split, in the order of the file."""

    scene_id: Int[np.ndarray, "n"]
    im_id: Int[np.ndarray, "n"]
    obj_id: Int[np.ndarray, "n"]
    score: Float[np.ndarray, "n"]
    rotation: Float[np.ndarray, "n 3 3"]
    """Model to camera, as submitted."""
    translation_mm: Float[np.ndarray, "n 3"]
    """Model to camera, as submitted."""
    time_s: Float[np.ndarray, "n"]
    """Seconds for the whole image; -1 where not reported."""
    method: str = ""
    """From the file name `METHOD_DATASET-SPLIT.csv`, else the name itself."""
    dataset_name: str = ""
    split: str = ""

    def __len__(self) -> int:
        return len(self.score)

    @staticmethod
    def from_estimates(
        estimates: Sequence[PoseEstimate], method: str = "", dataset_name: str = "", split: str = ""
    ) -> "Results":
        """Results of estimates whose translations are in metres."""
        poses = np.array([estimate.camera_from_model for estimate in estimates], dtype=float).reshape(-1, 4, 4)
        return Results(
            scene_id=np.array([estimate.scene_id for estimate in estimates], dtype=np.int64),
            im_id=np.array([estimate.im_id for estimate in estimates], dtype=np.int64),
            obj_id=np.array([estimate.obj_id for estimate in estimates], dtype=np.int64),
            score=np.array([estimate.score for estimate in estimates], dtype=float),
            rotation=poses[:, :3, :3].copy(),
            translation_mm=millimetres(poses[:, :3, 3]),
            time_s=np.array([estimate.time_s for estimate in estimates], dtype=float),
            method=method,
            dataset_name=dataset_name,
            split=split,
        )

    def rows(self, key: ImageKey, obj_id: int | None = None) -> Int[np.ndarray, "m"]:
        """Rows of an image (of one object, if given) by falling score; equal scores stay in the order of the file."""
        order, scenes, images = self._by_image
        begin = np.searchsorted(scenes, key.scene_id, "left")
        end = np.searchsorted(scenes, key.scene_id, "right")
        span = images[begin:end]
        rows = order[
            begin + np.searchsorted(span, key.im_id, "left") : begin + np.searchsorted(span, key.im_id, "right")
        ]
        return rows if obj_id is None else rows[self.obj_id[rows] == obj_id]

    def estimates(self, key: ImageKey, obj_id: int | None = None) -> tuple[PoseEstimate, ...]:
        """Estimates of an image (of one object, if given) by falling score; equal scores stay in the file's order."""
        return tuple(self.estimate(row) for row in self.rows(key, obj_id).tolist())

    def estimate(self, row: int) -> PoseEstimate:
        """The estimate of a row, in metres."""
        return PoseEstimate(
            scene_id=int(self.scene_id[row]),
            im_id=int(self.im_id[row]),
            obj_id=int(self.obj_id[row]),
            score=float(self.score[row]),
            camera_from_model=transform(self.rotation[row], self.translation_mm[row] / 1000.0),
            time_s=float(self.time_s[row]),
        )

    def images(self) -> tuple[ImageKey, ...]:
        """All images with an estimate, in order."""
        pairs = np.unique(np.stack([self.scene_id, self.im_id], axis=1), axis=0)
        return tuple(ImageKey(scene_id, im_id) for scene_id, im_id in pairs.tolist())

    @cached_property
    def _by_image(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows by scene, image and falling score, with the scene and the image of each."""
        order = np.lexsort((-self.score, self.im_id, self.scene_id))
        return order, self.scene_id[order], self.im_id[order]


def read_results(path: Path, max_rows: int = MAX_ROWS) -> Results:
    """Read a results file; a missing header, a byte order mark, CRLF and spare spaces are tolerated.

    Raises MissingFileError if it cannot be read, and FormatError if it holds more than `max_rows` rows, or a bad one:
    then it names the line, the column and the value of the first and says how many more there are.
    """
    path = Path(path)
    found = scan_results(path, max_rows)
    if found.faults.counts:
        raise FormatError(f"{path}: {found.faults}")
    return results_of(found, path.name)


def scan_results(path: Path, max_rows: int = MAX_ROWS) -> Scan:
    """Read the good rows of a results file and what is wrong with the others; raises where none can be read."""
    path = Path(path)
    if not path.is_file():
        problem = "is no file" if path.exists() else "no such file"
        raise MissingFileError(f"{path}: {problem}; give a results file (CSV)")
    return scan(path, max_rows)


def results_of(found: Scan, file_name: str) -> Results:
    """The good rows as results of the method, dataset and split that the file's name tells."""
    name = name_parts(file_name)
    columns = found.columns
    return Results(
        scene_id=columns["scene_id"],
        im_id=columns["im_id"],
        obj_id=columns["obj_id"],
        score=columns["score"],
        rotation=columns["R"].reshape(-1, 3, 3),
        translation_mm=columns["t"],
        time_s=columns["time"],
        method=name.method,
        dataset_name=name.dataset,
        split=name.split,
    )


class NameParts(NamedTuple):
    """What the name of a results file tells; dataset and split are empty where it does not."""

    method: str
    dataset: str
    split: str


def name_parts(file_name: str) -> NameParts:
    """Method, dataset and split of `METHOD_DATASET-SPLIT.csv`; underscores in the method are put up with."""
    stem = Path(file_name).stem
    found = _FILE_NAME.fullmatch(stem)
    return NameParts(found["method"], found["dataset"], found["split"]) if found else NameParts(stem, "", "")


def write_results(path: Path, results: Results) -> None:
    """Write a results file, in whole or not at all; `read_results` gives the very same numbers back.

    Raises InputError if the file cannot be written.
    """
    columns = (
        results.scene_id.tolist(),
        results.im_id.tolist(),
        results.obj_id.tolist(),
        results.score.tolist(),
        results.rotation.reshape(-1, 9).tolist(),
        results.translation_mm.tolist(),
        results.time_s.tolist(),
    )
    rows = (
        f"{scene},{image},{obj},{score!r},{' '.join(map(repr, R))},{' '.join(map(repr, t))},{time!r}"
        for scene, image, obj, score, R, t, time in zip(*columns, strict=True)
    )
    write_atomically(Path(path), "\n".join([HEADER, *rows, ""]).encode())
