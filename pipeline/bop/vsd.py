"""Visible surface discrepancy, with every map that goes into it (thesis sec. bop_vsd and its figure of quantities)."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float

from pipeline.exceptions import FormatError
from pipeline.ray_casting import Box
from pipeline.rendering import Rendering, render_depths
from pipeline.scene import Camera, Model

Variant = Literal["bop19", "bop18"]
"""bop19: the object counts as visible where depth was not measured; bop18 (2017 challenge): as not visible there."""

TAUS = tuple(i / 20 for i in range(1, 11))
"""Misalignment tolerances of BOP since 2019: 0.05, 0.10, ..., 0.50 of the object's diameter."""

DELTA = 0.015
"""Metres; tolerance of the visibility masks in BOP (0.005 for ITODD)."""


@dataclass(frozen=True, eq=False)
class Vsd:
    """VSD of one estimate and the maps behind it, all cut to `box`, distances in the unit of the depth (metres)."""

    values: Float[np.ndarray, "t"]
    """The error for each of `taus`, 0..1; 1 where nothing is visible."""
    taus: tuple[float, ...]
    """Misalignment tolerances, as fractions of `diameter`."""
    diameter: float
    delta: float
    """Tolerance of the visibility masks, in the unit of the depth."""
    box: Box
    """Where the maps lie in the image."""
    image_shape: tuple[int, int]
    """Rows and columns of the whole image."""
    distance_estimate: Float[np.ndarray, "h w"]
    """Distance from the camera centre to the model at the estimate, 0 outside it."""
    distance_gt: Float[np.ndarray, "h w"]
    """The same at the ground truth."""
    distance_test: Float[np.ndarray, "h w"]
    """Measured distance, 0 where nothing was measured."""
    visible_estimate: Bool[np.ndarray, "h w"]
    """Where the model at the estimate is visible in the image."""
    visible_gt: Bool[np.ndarray, "h w"]
    """Where the model at the ground truth is visible in the image."""

    @property
    def difference(self) -> Float[np.ndarray, "h w"]:
        """Distance at the estimate minus distance at the ground truth where both are visible, NaN elsewhere."""
        both = self.visible_estimate & self.visible_gt
        return np.where(both, self.distance_estimate - self.distance_gt, np.nan)

    def cost(self, tau: float) -> Float[np.ndarray, "h w"]:
        """What each pixel contributes at a tolerance (fraction of diameter): 0 or 1, NaN where nothing is visible.

        Its mean over the other pixels is the error.
        """
        union = self.visible_estimate | self.visible_gt
        matched = np.abs(self.difference) / self.diameter < tau  # false for NaN
        return np.where(union, np.where(matched, 0.0, 1.0), np.nan)

    def expand(self, crop: np.ndarray, fill: float = 0) -> np.ndarray:
        """Put one of the maps into a whole image of `fill`."""
        image = np.full(self.image_shape, fill, crop.dtype)
        image[self.box.slices] = crop
        return image


def vsd(
    estimate: Rendering,
    ground_truth: Rendering,
    depth: Float[np.ndarray, "H W"],
    K: Float[np.ndarray, "3 3"],
    diameter: float,
    taus: Sequence[float] = TAUS,
    delta: float = DELTA,
    variant: Variant = "bop19",
) -> Vsd:
    """Compare two renderings of a model with each other and with the measured depth.

    Distances, masks and counts follow BOP's scripts to the data type: depth becomes distance in float64 with integer
    pixel centres, though the renderings must sample at +0.5; visibility compares in float32. With `diameter` 1,
    `taus` are lengths (2017: tau 0.020 m, delta 0.015 m, variant "bop18"). Raises FormatError if the depth image is
    not of the renderings' size.
    """
    if depth.shape != estimate.image_shape:
        (height, width), (rows, columns) = estimate.image_shape, depth.shape
        raise FormatError(
            f"depth image has {columns} x {rows} pixels, but its camera has {width} x {height}; "
            "resize the depth image or correct the camera's size and K"
        )
    box = _union(estimate.box, ground_truth.box)
    rays = _ray_lengths(K, box)
    distance_estimate = _in_box(estimate, box) * rays
    distance_gt = _in_box(ground_truth, box) * rays
    distance_test = depth[box.slices].astype(np.float32) * rays
    visible_gt = _visible(distance_gt, distance_test, delta, variant)
    visible_estimate = _visible(distance_estimate, distance_test, delta, variant)
    visible_estimate |= visible_gt & (distance_estimate > 0)
    values = _values(distance_estimate, distance_gt, visible_estimate, visible_gt, diameter, taus)
    return Vsd(
        values=values,
        taus=tuple(taus),
        diameter=diameter,
        delta=delta,
        box=box,
        image_shape=estimate.image_shape,
        distance_estimate=distance_estimate,
        distance_gt=distance_gt,
        distance_test=distance_test,
        visible_estimate=visible_estimate,
        visible_gt=visible_gt,
    )


def vsd_of_poses(
    model: Model,
    camera: Camera,
    estimate: Float[np.ndarray, "4 4"],
    ground_truth: Float[np.ndarray, "4 4"],
    depth: Float[np.ndarray, "H W"],
    taus: Sequence[float] = TAUS,
    delta: float = DELTA,
    variant: Variant = "bop19",
) -> Vsd:
    """Render the model in both poses, in one call of the ray caster, and compare (see `vsd`).

    A pose that is not finite renders as nothing, so that its error is 1. BOP's scripts also take it for 1 where
    `errors.sphere_projections_overlap` is false.
    """
    at_estimate, at_gt = render_depths(model, camera, np.stack([estimate, ground_truth]))
    return vsd(at_estimate, at_gt, depth, camera.K, model.diameter, taus, delta, variant)


def _union(a: Box, b: Box) -> Box:
    if not (a.x1 and b.x1):  # one is empty
        return a if a.x1 else b
    return Box(min(a.x0, b.x0), min(a.y0, b.y0), max(a.x1, b.x1), max(a.y1, b.y1))


def _in_box(rendering: Rendering, box: Box) -> Float[np.ndarray, "h w"]:
    """Depth of a rendering cut to a box around it."""
    depth = np.zeros(box.shape, np.float32)
    own = rendering.box
    depth[own.y0 - box.y0 : own.y1 - box.y0, own.x0 - box.x0 : own.x1 - box.x0] = rendering.depth_crop
    return depth


def _ray_lengths(K: Float[np.ndarray, "3 3"], box: Box) -> Float[np.ndarray, "h w"]:
    """Distance from the camera centre at depth 1, for integer pixel centres; float64."""
    x = (np.arange(box.x0, box.x1) - K[0, 2]) / K[0, 0]
    y = (np.arange(box.y0, box.y1) - K[1, 2]) / K[1, 1]
    return np.sqrt(x**2 + (y**2)[:, None] + 1.0)


def _visible(
    distance: Float[np.ndarray, "h w"], distance_test: Float[np.ndarray, "h w"], delta: float, variant: Variant
) -> Bool[np.ndarray, "h w"]:
    """Where the model is at most delta behind the measured surface (thesis eq. visibility_gt)."""
    not_behind = distance.astype(np.float32) - distance_test.astype(np.float32) <= np.float32(delta)
    if variant == "bop18":
        return not_behind & (distance > 0) & (distance_test > 0)
    return (not_behind | (distance_test == 0)) & (distance > 0)


def _values(
    distance_estimate: Float[np.ndarray, "h w"],
    distance_gt: Float[np.ndarray, "h w"],
    visible_estimate: Bool[np.ndarray, "h w"],
    visible_gt: Bool[np.ndarray, "h w"],
    diameter: float,
    taus: Sequence[float],
) -> Float[np.ndarray, "t"]:
    both = visible_estimate & visible_gt
    union_size = np.count_nonzero(visible_estimate | visible_gt)
    if not union_size:
        return np.ones(len(taus))
    differences = np.sort(np.abs(distance_gt[both] - distance_estimate[both]) / diameter)
    matched = np.searchsorted(differences, taus, side="left")  # those below tau
    return (union_size - matched) / union_size
