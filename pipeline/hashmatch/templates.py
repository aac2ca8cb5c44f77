"""Templates of an object: what matching needs of its views, in compact arrays (thesis sec. Object Detection)."""

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from jaxtyping import Float, Integer, UInt8

from pipeline.hashmatch.config import TEMPLATE_SIZE

DISTANCE_UNIT = 1e-4
"""Metres; distances are stored as 16-bit multiples of it, relative to the distance of the centroid."""

NO_DISTANCE = np.int16(-32768)
"""Stored where there is no surface."""


@dataclass(frozen=True, eq=False)
class Templates:
    """t templates of an object, and what they have in common."""

    obj_id: int
    diameter: float
    """Metres."""
    distance: float
    """Metres; |t_t|, from the camera centre to the object's centroid, the same for all templates."""
    focal_px: float
    """Focal length of the camera of the templates."""
    centroid: Float[np.ndarray, "3"]
    """Centre of the bounding box, model frame, metres."""
    edgels: int
    """Least number of depth edgels in a template, with the edgel threshold of this object."""
    colored: bool
    """Whether the views have colour; without, test T5 says nothing."""
    rotations: Float[np.ndarray, "t 3 3"]
    """R_t, camera from model, float32."""
    areas: Integer[np.ndarray, "t"]
    """a: pixels of the silhouette."""
    boxes: UInt8[np.ndarray, "t 4"]
    """x0, y0, x1, y1 of the silhouette in the window, pixels, x1 and y1 included."""
    nearest: Float[np.ndarray, "t"]
    """Metres, float32; middle of the distances of the surface at the five reference points of T1, else of all of it."""
    grid_distances: Integer[np.ndarray, "t g"]
    """Stored distances at the reference points, row by row."""
    grid_normals: UInt8[np.ndarray, "t g"]
    """Normal bins at the reference points."""
    normal_points: UInt8[np.ndarray, "t p 2"]
    """Pixels (x, y) of the tests T2, T4 and T5; the first `normal_counts` of each row."""
    normal_bits: UInt8[np.ndarray, "t p"]
    point_distances: Integer[np.ndarray, "t p"]
    """Stored distances."""
    point_hues: UInt8[np.ndarray, "t p"]
    normal_counts: UInt8[np.ndarray, "t"]
    gradient_points: UInt8[np.ndarray, "t p 2"]
    """Pixels (x, y) of test T3."""
    gradient_bits: UInt8[np.ndarray, "t p"]
    gradient_counts: UInt8[np.ndarray, "t"]

    def __len__(self) -> int:
        return len(self.rotations)

    def nbytes(self) -> int:
        """Memory of the arrays."""
        return sum(value.nbytes for value in vars(self).values() if isinstance(value, np.ndarray))

    def pose(self, template: int) -> Float[np.ndarray, "4 4"]:
        """P_t: camera_from_model with the centroid on the optical axis."""
        pose = np.eye(4)
        pose[:3, :3] = self.rotations[template]
        pose[:3, 3] = np.array([0, 0, self.distance]) - pose[:3, :3] @ self.centroid
        return pose


PER_TEMPLATE = tuple(field.name for field in fields(Templates) if field.name not in {
    "obj_id", "diameter", "distance", "focal_px", "centroid", "edgels", "colored"
})  # fmt: skip
"""Names of the arrays with a row per template."""


def joined(parts: Sequence[Templates]) -> Templates:
    """Templates of one object from those of its parts."""
    arrays = {name: np.concatenate([getattr(part, name) for part in parts]) for name in PER_TEMPLATE}
    return replace(parts[0], edgels=min(part.edgels for part in parts), **arrays)


def reference_points(grid: int) -> Integer[np.ndarray, "g 2"]:
    """Pixels (x, y) in the window of the grid of r x r reference points, row by row."""
    along = ((np.arange(grid) + 0.5) * (TEMPLATE_SIZE / grid)).astype(int)
    x, y = np.meshgrid(along, along)
    return np.stack([x.ravel(), y.ravel()], axis=-1)


def size_points() -> Integer[np.ndarray, "5 2"]:
    """Pixels (x, y) of test T1: the centres of the window and of its quadrants."""
    middle, low, high = TEMPLATE_SIZE // 2, TEMPLATE_SIZE // 4, TEMPLATE_SIZE * 3 // 4
    return np.array([(middle, middle), (low, low), (high, low), (low, high), (high, high)])


def stored_distances(distances: np.ndarray, centroid: float) -> Integer[np.ndarray, "*n"]:
    """Distances in metres as they are stored; 0 becomes NO_DISTANCE."""
    relative = np.rint((distances - centroid) / DISTANCE_UNIT)
    return np.where(distances > 0, np.clip(relative, -32767, 32767), NO_DISTANCE).astype(np.int16)
