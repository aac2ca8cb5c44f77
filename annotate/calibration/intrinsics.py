"""Intrinsic and distortion parameters of a camera from images of a pattern (thesis sec. tless_calibration)."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float

from annotate.calibration.patterns import Pattern, PatternView
from pipeline.bop.images import read_rgb
from pipeline.exceptions import InputError
from pipeline.parallel import HERE, Workers

FEWEST_IMAGES = 3
UNSURE = 0.01
"""Relative standard deviation of the focal length from which it is told that the views are too alike."""
BAD_IMAGE = 3.0
"""Times the median RMS of all images: one so bad is named."""


@dataclass(frozen=True, eq=False)
class CalibratedImage:
    """One image of the pattern."""

    name: str
    rms_px: float
    pixels: Float[np.ndarray, "n 2"]
    residuals: Float[np.ndarray, "n 2"]
    """Seen minus projected corners, pixels."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """A camera with its lens."""

    K: Float[np.ndarray, "3 3"]
    distortion: Float[np.ndarray, "5"]
    """OpenCV's k1, k2, p1, p2, k3."""
    width: int
    height: int
    std: Float[np.ndarray, "4"]
    """Standard deviations of fx, fy, cx, cy in pixels, as far as the corners show them."""
    rms_px: float
    """Root mean square of the reprojection errors over all corners, as the thesis states it."""
    images: tuple[CalibratedImage, ...]
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """As in a BOP dataset's `camera.json`, with the distortion and what the calibration is worth."""
        fx, fy, cx, cy = self.K[0, 0], self.K[1, 1], self.K[0, 2], self.K[1, 2]
        intrinsics = {
            name: float(value) for name, value in zip(("fx", "fy", "cx", "cy"), (fx, fy, cx, cy), strict=True)
        }
        return {
            **intrinsics,
            "width": self.width,
            "height": self.height,
            "distortion": self.distortion.tolist(),
            "std": self.std.tolist(),
            "rms_px": self.rms_px,
            "images": {image.name: image.rms_px for image in self.images},
            "notes": list(self.notes),
        }


def calibrate(paths: Sequence[Path], pattern: Pattern, workers: Workers = HERE) -> Calibration:
    """Calibrate from image files of a pattern.

    Raises InputError if fewer than three show it, or if they differ in size.
    """
    found: dict[int, tuple[PatternView | None, tuple[int, int]]] = {}
    for position, answer in workers.map_unordered(_find, paths, pattern, total=len(paths)):
        found[position] = answer
    seen = {paths[i].name: view for i in sorted(found) if (view := found[i][0]) is not None}
    if len(seen) < FEWEST_IMAGES:
        where = paths[0].parent if paths else "no images"
        raise InputError(
            f"{where}: {len(seen)} of {len(paths)} images show the pattern; at least {FEWEST_IMAGES} are needed, so check"
            " its rows and columns"
        )
    sizes = {found[i][1] for i in found if found[i][0] is not None}
    if len(sizes) > 1:
        texts = " and ".join(f"{width} x {height}" for width, height in sorted(sizes))
        raise InputError(f"{paths[0].parent}: images of {texts} pixels; a calibration is of one size only")
    unseen = len(paths) - len(seen)
    notes = (f"{unseen} of {len(paths)} images do not show the pattern",) if unseen else ()
    return calibrate_views(seen, sizes.pop(), notes)


def calibrate_views(views: dict[str, PatternView], size: tuple[int, int], notes: tuple[str, ...] = ()) -> Calibration:
    """Calibrate from corners by the name of their image; `size` is width and height in pixels."""
    points = [view.points.astype(np.float32) for view in views.values()]
    pixels = [view.pixels.astype(np.float32) for view in views.values()]
    start_K, start_lens = np.eye(3), np.zeros(5)
    _, K, lens, turns, shifts, stds, _, _ = cv2.calibrateCameraExtended(points, pixels, size, start_K, start_lens)
    K, lens = np.asarray(K, float), np.ravel(lens)[:5].astype(float)
    images = []
    for (name, view), turn, shift in zip(views.items(), turns, shifts, strict=True):
        projected = cv2.projectPoints(view.points, turn, shift, K, lens)[0].reshape(-1, 2)
        residuals = view.pixels - projected
        images.append(CalibratedImage(name, _rms(residuals), view.pixels, residuals))
    std = np.ravel(stds)[:4].astype(float)
    rms = _rms(np.concatenate([image.residuals for image in images]))
    return Calibration(K, lens, *size, std, rms, tuple(images), (*notes, *_doubts(K, std, images)))


def _rms(residuals: Float[np.ndarray, "n 2"]) -> float:
    return float(np.sqrt((residuals**2).sum(axis=1).mean()))


def _doubts(K: Float[np.ndarray, "3 3"], std: Float[np.ndarray, "4"], images: Sequence[CalibratedImage]) -> list[str]:
    found = []
    if std[0] > UNSURE * K[0, 0]:
        found.append(f"fx = {K[0, 0]:.1f} +- {std[0]:.1f} px is unsure: add images with the pattern tilted more ways")
    usual = float(np.median([image.rms_px for image in images]))
    bad = [image for image in images if image.rms_px > BAD_IMAGE * usual and image.rms_px > 0.5]
    found += [f"{image.name}: RMS of {image.rms_px:.2f} px, {usual:.2f} as a rule; leave it out" for image in bad]
    return found


def _find(pattern: Pattern, path: Path) -> tuple[PatternView | None, tuple[int, int]]:
    """What a worker does: the pattern in one image, and the image's width and height."""
    gray = cv2.cvtColor(read_rgb(path), cv2.COLOR_RGB2GRAY)
    return pattern.find(gray), (gray.shape[1], gray.shape[0])


def undistorted(image: np.ndarray, calibration: Calibration, is_depth: bool = False) -> np.ndarray:
    """The image as a pinhole camera with the same matrix K would see it; a new array, 0 where nothing was seen.

    Colour is interpolated; depth is taken from the nearest pixel, for values between two surfaces are of none. Raises
    InputError for an image of another size.
    """
    if image.shape[:2] != (calibration.height, calibration.width):
        found, wanted = f"{image.shape[1]} x {image.shape[0]}", f"{calibration.width} x {calibration.height}"
        raise InputError(f"image of {found} pixels: the calibration is of {wanted}; calibrate at this size")
    size = (calibration.width, calibration.height)
    maps = cv2.initUndistortRectifyMap(calibration.K, calibration.distortion, None, calibration.K, size, cv2.CV_32FC1)
    return cv2.remap(image, *maps, cv2.INTER_NEAREST if is_depth else cv2.INTER_CUBIC)
