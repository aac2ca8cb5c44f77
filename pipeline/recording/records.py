"""What a stage can show: one frozen dataclass per kind, which is what is logged and exactly what is read back.

Estimates and ground truth are recorded as the dataclasses of `pipeline.scene`. Arrays keep their dtype, shape
and values; those that a reader returns are read-only. Pixels are (u, v) = (column, row), pixel centres at integers.
A wrong shape raises a ValueError that states the expected one.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Num, UInt8

from pipeline.scene import Camera, GroundTruth, ImageKey, PoseEstimate


@dataclass(frozen=True, eq=False)
class View:
    """The image that a recording is about, and its camera; written by the recorder itself."""

    scene_id: int
    im_id: int
    K: Float[np.ndarray, "3 3"] | None = None
    width: int | None = None
    """Pixels."""
    height: int | None = None
    """Pixels."""
    world_from_camera: Float[np.ndarray, "4 4"] | None = None
    """Metres; None where the dataset has none."""

    @property
    def key(self) -> ImageKey:
        """The image."""
        return ImageKey(self.scene_id, self.im_id)

    @property
    def camera(self) -> Camera | None:
        """The camera; None where the recording was made without one (network training, for example)."""
        if self.K is None or self.width is None or self.height is None:
            return None
        return Camera(self.K, self.width, self.height, self.world_from_camera)


@dataclass(frozen=True, eq=False)
class ColorImage:
    """A colour image."""

    rgb: UInt8[np.ndarray, "h w 3"]

    def __post_init__(self) -> None:
        _check_shapes(self, rgb="h w 3")
        if self.rgb.dtype != np.uint8:
            raise ValueError(f"ColorImage.rgb is {self.rgb.dtype}; expected uint8")


@dataclass(frozen=True, eq=False)
class DepthMap:
    """A depth image."""

    depth: Float[np.ndarray, "h w"]
    """Metres along z, 0 where not measured."""

    def __post_init__(self) -> None:
        _check_shapes(self, depth="h w")


@dataclass(frozen=True, eq=False)
class Heatmap:
    """A number per pixel, or per square cell of pixels: counts of candidates, costs, differences."""

    values: Num[np.ndarray, "h w"]
    cell_px: int = 1
    """Side of a cell in image pixels; cell (row, column) starts at pixel (column, row) * cell_px."""
    unit: str = ""
    """What the numbers are, for the colour bar: "candidates", "m"."""

    def __post_init__(self) -> None:
        _check_shapes(self, values="h w")


@dataclass(frozen=True, eq=False)
class Mask:
    """A set of pixels."""

    mask: Bool[np.ndarray, "h w"]

    def __post_init__(self) -> None:
        _check_shapes(self, mask="h w")
        if self.mask.dtype != np.bool_:
            raise ValueError(f"Mask.mask is {self.mask.dtype}; expected bool")


@dataclass(frozen=True, eq=False)
class Probabilities:
    """Distributions over c classes (objects, surface fragments) at k cells of an image, and only at those.

    Listing the cells keeps a recording small: EPOS looks at fragments only where the object is likely
    (thesis sec. EPOS, tau_a). float16 values halve it again; what is logged is kept as it is.
    """

    values: Float[np.ndarray, "k c"]
    """Probability of each class, 0..1."""
    cells: Int[np.ndarray, "k 2"]
    """(column, row) of each cell in the grid."""
    grid: tuple[int, int]
    """Height and width of the grid, in cells."""
    cell_px: int = 1
    """Side of a cell in image pixels (4 for EPOS)."""
    labels: tuple[str, ...] = ()
    """Name of each class; empty or c names."""
    points_in_model: Float[np.ndarray, "k c 3"] | None = None
    """The 3D point that each class predicts at each cell, model frame, metres."""

    def __post_init__(self) -> None:
        _check_shapes(self, values="k c", cells="k 2", points_in_model="k c 3")
        if self.labels and len(self.labels) != self.values.shape[1]:
            raise ValueError(f"Probabilities.labels has {len(self.labels)} names; expected {self.values.shape[1]}")

    def dense(self) -> Float[np.ndarray, "h w c"]:
        """The probabilities over the whole grid, 0 at cells that are not listed."""
        maps = np.zeros((*self.grid, self.values.shape[1]), self.values.dtype)
        maps[self.cells[:, 1], self.cells[:, 0]] = self.values
        return maps


@dataclass(frozen=True, eq=False)
class Correspondences:
    """Pixels of an image paired with points of a model (thesis sec. EPOS, many-to-many 2D-3D correspondences)."""

    obj_id: int
    pixels: Float[np.ndarray, "n 2"]
    """(u, v)."""
    points_in_model: Float[np.ndarray, "n 3"]
    """Metres, model frame."""
    confidence: Float[np.ndarray, "n"]
    """Larger is better (thesis: s = a * b)."""
    fragment_ids: Int[np.ndarray, "n"] | None = None
    """Surface fragment that each came from."""

    def __post_init__(self) -> None:
        _check_shapes(self, pixels="n 2", points_in_model="n 3", confidence="n", fragment_ids="n")


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Poses that a search looked at, in the order in which it did: RANSAC, Progressive-X, particle swarm."""

    obj_id: int
    camera_from_model: Float[np.ndarray, "n 4 4"]
    """Metres."""
    quality: Float[np.ndarray, "n"]
    """The search's own score; larger is better."""
    steps: Int[np.ndarray, "n"] | None = None
    """Iteration of the search that each belongs to."""
    instances: Int[np.ndarray, "n"] | None = None
    """Which of the sought instances each was for, from 0."""
    samples: Int[np.ndarray, "n 3"] | None = None
    """Indices of the sampled triplet in the object's correspondences; -1 where there was none."""
    labels: tuple[str, ...] = ()
    """What each is: "sample", "local optimization", "final"; empty or n names."""

    def __post_init__(self) -> None:
        _check_shapes(self, camera_from_model="n 4 4", quality="n", steps="n", instances="n", samples="n 3")
        if self.labels and len(self.labels) != len(self.quality):
            raise ValueError(f"Hypotheses.labels has {len(self.labels)} names; expected {len(self.quality)}")


@dataclass(frozen=True, eq=False)
class Series:
    """A number over steps: a loss, the score of the best particle."""

    values: Num[np.ndarray, "n"]
    steps: Int[np.ndarray, "n"]

    def __post_init__(self) -> None:
        _check_shapes(self, values="n", steps="n")


@dataclass(frozen=True)
class Text:
    """One entry of a log, or a verdict."""

    text: str
    level: str = "INFO"
    """TRACE, DEBUG, INFO, WARN, ERROR or CRITICAL."""


@dataclass(frozen=True, eq=False)
class Table:
    """n rows of named columns, for what no other kind holds: candidate windows, votes, test results.

    A column is an array (n, ...) of numbers, booleans or strings. Columns called `pixels` (n, 2) and
    `points_in_camera` (n, 3) are also drawn by rerun's viewer.
    """

    columns: Mapping[str, np.ndarray]

    def __post_init__(self) -> None:
        lengths = {name: len(column) for name, column in self.columns.items()}
        if len(set(lengths.values())) > 1:
            raise ValueError(f"Table columns differ in length: {lengths}")

    def __len__(self) -> int:
        return len(next(iter(self.columns.values()), ()))


Record = (
    View
    | ColorImage
    | DepthMap
    | Heatmap
    | Mask
    | Probabilities
    | Correspondences
    | PoseEstimate
    | GroundTruth
    | Hypotheses
    | Series
    | Text
    | Table
)

RECORD_TYPES: dict[str, Any] = {
    "view": View,
    "image": ColorImage,
    "depth": DepthMap,
    "heatmap": Heatmap,
    "mask": Mask,
    "probabilities": Probabilities,
    "correspondences": Correspondences,
    "estimate": PoseEstimate,
    "ground_truth": GroundTruth,
    "hypotheses": Hypotheses,
    "series": Series,
    "text": Text,
    "table": Table,
}
"""Dataclass of each kind."""

KINDS: dict[type, str] = {record_type: kind for kind, record_type in RECORD_TYPES.items()}
"""Kind of each dataclass."""


def _check_shapes(record: object, **expected: str) -> None:
    """Compare arrays with shapes such as "n 3"; a letter must mean the same size in all of them."""
    sizes: dict[str, int] = {}
    for name, shape in expected.items():
        array = getattr(record, name)
        if array is None:
            continue
        axes = shape.split()
        wanted = [int(axis) if axis.isdigit() else sizes.get(axis) for axis in axes]
        fits = array.ndim == len(axes) and all(
            size is None or size == found for size, found in zip(wanted, array.shape, strict=True)
        )
        if not fits:
            known = "".join(f", {axis} = {size}" for axis, size in sizes.items() if axis in axes)
            raise ValueError(f"{type(record).__name__}.{name} has shape {array.shape}; expected ({shape}){known}")
        sizes.update(zip(axes, array.shape, strict=True))
