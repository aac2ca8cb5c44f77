"""Potential 2D-3D correspondences of one object, many to many (thesis sec. epos_establish_coords, C_o)."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from pipeline.exceptions import InputError


@dataclass(frozen=True, eq=False)
class PotentialCorrespondences:
    """n pairs of a pixel and a model point; a pixel may have several points, of which at most one is right per instance."""

    obj_id: int
    pixels: Float[np.ndarray, "n 2"]
    """(u, v), pixel centres at integers."""
    points_in_model: Float[np.ndarray, "n 3"]
    """Metres, model frame."""
    confidence: Float[np.ndarray, "n"]
    """s = a * b: larger is better, none negative."""
    pixel_ids: Int[np.ndarray, "n"]
    """Equal where correspondences share a pixel; any integers."""
    fragment_ids: Int[np.ndarray, "n"] | None = None
    """Surface fragment that each came from, where known; not used for fitting."""

    def __post_init__(self) -> None:
        count = len(self.pixels)
        expected = {
            "pixels": (count, 2),
            "points_in_model": (count, 3),
            "confidence": (count,),
            "pixel_ids": (count,),
            "fragment_ids": (count,),
        }
        for name, shape in expected.items():
            array = getattr(self, name)
            if array is not None and array.shape != shape:
                raise InputError(
                    f"correspondences of object {self.obj_id}: {name} has shape {array.shape}; expected {shape}"
                )

    def __len__(self) -> int:
        return len(self.pixels)

    def at(self, rows: Int[np.ndarray, "m"]) -> "PotentialCorrespondences":
        """Those at the given positions, in that order."""
        fragment_ids = None if self.fragment_ids is None else self.fragment_ids[rows]
        arrays = {name: getattr(self, name)[rows] for name in ("pixels", "points_in_model", "confidence", "pixel_ids")}
        return replace(self, **arrays, fragment_ids=fragment_ids)


def correspondences_of_pixels(
    obj_id: int,
    pixels: Float[np.ndarray, "n 2"],
    points_in_model: Float[np.ndarray, "n 3"],
    confidence: Float[np.ndarray, "n"],
    fragment_ids: Int[np.ndarray, "n"] | None = None,
) -> PotentialCorrespondences:
    """Correspondences whose pixels are told apart by their coordinates; arguments as the fields of the result."""
    pixel_ids = np.unique(pixels, axis=0, return_inverse=True)[1].reshape(-1) if len(pixels) else np.zeros(0, np.int64)
    return PotentialCorrespondences(obj_id, pixels, points_in_model, confidence, pixel_ids, fragment_ids)


def usable(correspondences: PotentialCorrespondences) -> Int[np.ndarray, "m"]:
    """Positions of the correspondences that can be fitted, sorted by pixel: finite numbers, confidence not negative."""
    c = correspondences
    with np.errstate(invalid="ignore"):
        good = np.isfinite(c.pixels).all(1) & np.isfinite(c.points_in_model).all(1)
        good &= np.isfinite(c.confidence) & (c.confidence >= 0) & (np.abs(c.pixels).max(1, initial=0) < _FARTHEST_PX)
    rows = np.flatnonzero(good)
    ids = c.pixel_ids[rows]
    return rows if np.all(ids[1:] >= ids[:-1]) else rows[np.argsort(ids, kind="stable")]


_FARTHEST_PX = 1e6
"""Pixel coordinates beyond are garbage, and would make the grid of pixels useless."""
