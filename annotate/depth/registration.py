"""Whether depth is registered to colour: how far the outlines of depth lie from the edges of the colour image.

The Kinect's images of T-LESS are slightly misregistered (thesis sec. tless_gt_eval): everything measured lies some
pixels beside what is seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from annotate.edges import Outline, Shift, common_shift, edge_profiles, outline
from pipeline.bop.dataset import Dataset
from pipeline.exceptions import InputError
from pipeline.parallel import HERE, Workers
from pipeline.scene import ImageKey

STEP = 0.03
"""Metres between the two sides of an outline, at least."""
REACH_PX = 8
HOLE_PX = 6
"""Unmeasured pixels between the two sides, at most."""
MOST_POINTS = 6000
FEWEST_POINTS = 200
SCATTER_PX = 0.25
"""Standard deviation of the shift of single images, at least: they differ so much where there is none."""
SIGNIFICANT = 3.0
"""Standard deviations."""


@dataclass(frozen=True, eq=False)
class Registration:
    """The lateral shift between depth and colour of a set of images."""

    shift: Shift
    """Where the colour edges lie, seen from the outlines of depth: pixels, x to the right, y down."""
    by_image: Float[np.ndarray, "n 2"]
    """Shift of each image that has enough outlines."""
    keys: tuple[ImageKey, ...]

    @property
    def is_shifted(self) -> bool:
        """Whether the shift is longer than half a pixel, with certainty."""
        shift = self.shift
        certain = max(abs(shift.x) / shift.std_x, abs(shift.y) / shift.std_y) > SIGNIFICANT
        return shift.length > 0.5 and certain


def check_registration(dataset: Dataset, keys: Sequence[ImageKey], workers: Workers = HERE) -> Registration:
    """Estimate the shift over some images; its standard deviation is that of the mean over images.

    Raises InputError if no image has outlines in depth with edges in colour near them.
    """
    found: dict[int, Shift] = {}
    for position, shift in workers.map_unordered(_of_image, keys, dataset, total=len(keys)):
        if shift is not None:
            found[position] = shift
    if not found:
        raise InputError(
            f"{dataset.root}: none of {len(keys)} images has steps of depth with edges of colour near them;"
            " the registration cannot be checked"
        )
    order = sorted(found)
    shifts = [found[position] for position in order]
    by_image = np.array([(shift.x, shift.y) for shift in shifts])
    return Registration(_mean(shifts), by_image, tuple(keys[position] for position in order))


def registration_shift(rgb: UInt8[np.ndarray, "h w 3"], depth: Float[np.ndarray, "h w"]) -> Shift | None:
    """The shift that brings the outlines of depth onto the edges of colour; None where too few edges tell it.

    Pixels at outlines often are not measured, so outlines may be too small; that does not matter, for it is all around.
    """
    found = depth_outline(depth)
    if len(found.points) < FEWEST_POINTS:
        return None
    every = max(1, len(found.points) // MOST_POINTS)
    thinned = Outline(found.points[::every], found.normals[::every])
    return common_shift(thinned, *edge_profiles(rgb, thinned, REACH_PX), with_margin=True)


def depth_outline(depth: Float[np.ndarray, "h w"]) -> Outline:
    """Where a near surface ends before a far one that is measured, too, perhaps beyond the shadow of the sensor.

    The image is cut into layers of depth, as thick as the step, and the outline of all that is nearer than each is
    kept where the step is.
    """
    farthest = cv2.dilate(depth.astype(np.float32), np.ones((2 * HOLE_PX + 1, 2 * HOLE_PX + 1), np.uint8))
    clean = (depth > 0) & (farthest - depth > STEP)
    parts = [_layer(depth, clean, float(limit)) for limit in _limits(depth)]
    points = np.concatenate([part.points for part in parts]) if parts else np.empty((0, 2))
    normals = np.concatenate([part.normals for part in parts]) if parts else np.empty((0, 2))
    return Outline(points, normals)


def _limits(depth: Float[np.ndarray, "h w"]) -> Float[np.ndarray, "k"]:
    """Depths at which to cut, 0.1 m apart, over what most of the image shows."""
    measured = depth[depth > 0]
    if not len(measured):
        return np.empty(0)
    low, high = np.percentile(measured, [2, 98])
    return np.arange(low, min(high, low + 3.0), 0.1)


def _layer(depth: Float[np.ndarray, "h w"], clean: Bool[np.ndarray, "h w"], limit: float) -> Outline:
    nearer = (depth > 0) & (depth < limit)
    return outline(nearer, clean)


def _mean(shifts: Sequence[Shift]) -> Shift:
    """The mean over images, robust against some that are wrong, with the standard deviation that their spread shows."""
    values = np.array([(shift.x, shift.y) for shift in shifts])
    own = np.maximum([(shift.std_x, shift.std_y) for shift in shifts], SCATTER_PX)
    middle = np.median(values, axis=0)
    spread = np.maximum(1.4826 * np.median(np.abs(values - middle), axis=0), own.mean(axis=0))
    kept = (np.abs(values - middle) <= 3 * spread + 1e-9).all(axis=1)
    std = (spread / np.sqrt(kept.sum())).tolist()
    x, y = values[kept].mean(axis=0).tolist()
    return Shift(x, y, std[0], std[1], int(sum(shift.points for shift in shifts)))


def _of_image(dataset: Dataset, key: ImageKey) -> Shift | None:
    """What a worker does: the shift of one image."""
    try:
        rgb, depth = dataset.rgb(key), dataset.depth(key)
    except InputError:
        return None
    return None if rgb is None or depth is None else registration_shift(rgb, depth)
