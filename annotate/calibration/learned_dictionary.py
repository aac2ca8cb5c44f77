"""Learning a dictionary of markers from images of them: squares with a black border and black or white cells."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from annotate.calibration.dictionary import CELLS, MarkerDictionary, distance, symmetry
from pipeline.exceptions import InputError
from pipeline.synth.boards.marker_board import opencv_dictionary

PIXELS_PER_CELL = 8
BORDERS = (1, 2)
CLEAR = 0.8
"""Least share of the pixels about the middle of each cell that are of its colour, in a marker that counts."""
LEAST_CONTRAST = 40.0
"""Gray levels between black and white."""
LEAST_IMAGES = 3
"""Images that a pattern must be seen in."""
ALIKE = 1
"""Cells by which readings of one marker may differ: the most frequent one wins."""


@dataclass(frozen=True, eq=False)
class LearnedDictionary:
    """Markers that images show again and again."""

    dictionary: MarkerDictionary
    counts: tuple[int, ...]
    """In how many images each was seen, by id."""
    symmetric: tuple[int, ...]
    """In how many images each pattern was seen that was left out, for it looks alike in several orientations."""


def learn_dictionary(images: Sequence[UInt8[np.ndarray, "h w *rgb"]]) -> LearnedDictionary:
    """Learn which markers images show; the number of cells and the width of the border are found too.

    Most frequent markers have the lowest ids. Raises InputError if no marker is seen in three images.
    """
    patches = [list(_squares(image)) for image in images]
    best: tuple[float, int, int] | None = None
    for border in BORDERS:
        for cells in range(CELLS[0], CELLS[1] + 1):
            clear = sum(_reading(patch, cells, border) is not None for own in patches for patch in own)
            score = clear * (1 - 0.02 * cells)  # halved cells are as clear as whole ones: the fewest are meant
            if clear and (best is None or score > best[0]):
                best = score, cells, border
    if best is None:
        raise InputError(
            f"no markers in {len(images)} images: squares with a black border and cells of black and white"
        )
    _, cells, border = best
    readings = [[r for patch in own if (r := _reading(patch, cells, border)) is not None] for own in patches]
    return _gathered(readings, border, len(images))


def _squares(image: UInt8[np.ndarray, "h w *rgb"]) -> Iterable[UInt8[np.ndarray, "s s"]]:
    """All dark squares of an image as seen from the front."""
    gray = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_NONE
    # What OpenCV takes for squares but cannot decode is what we are after; any dictionary will do.
    detector = cv2.aruco.ArucoDetector(opencv_dictionary("DICT_4X4_50"), parameters)
    found, _, rejected = detector.detectMarkers(gray)
    side = PIXELS_PER_CELL * 24
    target = np.array([[0, 0], [side, 0], [side, side], [0, side]], np.float32) - 0.5
    for quad in (*found, *rejected):
        onto = cv2.getPerspectiveTransform(np.reshape(quad, (4, 2)).astype(np.float32), target)
        yield cv2.warpPerspective(gray, onto, (side, side), flags=cv2.INTER_LINEAR)


def _reading(patch: UInt8[np.ndarray, "s s"], cells: int, border: int) -> Bool[np.ndarray, "c c"] | None:
    """White cells of a patch; None if it is no marker of so many cells, or not a clear one."""
    across = cells + 2 * border
    share = _white_shares(patch, across)
    if share is None:
        return None
    clear = np.maximum(share, 1 - share)
    inner = np.s_[border:-border, border:-border]
    frame = share.copy()
    frame[inner] = 0.0
    white = share[inner] > 0.5
    if clear.min() < CLEAR or frame.max() > 1 - CLEAR or white.all() or not white.any():
        return None
    return white


def _white_shares(patch: UInt8[np.ndarray, "s s"], across: int) -> Float[np.ndarray, "a a"] | None:
    """Share of white pixels about the middle of each cell; None without contrast."""
    threshold, binary = cv2.threshold(patch, 0, 1, cv2.THRESH_BINARY | cv2.THRESH_OTSU)
    if not 0 < binary.mean() < 1:
        return None
    contrast = float(patch[binary == 1].mean()) - float(patch[binary == 0].mean())
    if contrast < LEAST_CONTRAST:
        return None
    size = PIXELS_PER_CELL * across
    fine = (cv2.resize(patch, (size, size), interpolation=cv2.INTER_AREA) > threshold).astype(float)
    middle = slice(PIXELS_PER_CELL // 4, PIXELS_PER_CELL - PIXELS_PER_CELL // 4)
    blocks = fine.reshape(across, PIXELS_PER_CELL, across, PIXELS_PER_CELL)
    return blocks[:, middle, :, middle].mean(axis=(1, 3))


def _gathered(readings: list[list[Bool[np.ndarray, "c c"]]], border: int, images: int) -> LearnedDictionary:
    """Patterns by how many images show them, those that are nearly like a more frequent one taken for it."""
    seen: dict[bytes, tuple[np.ndarray, set[int]]] = {}
    for image, own in enumerate(readings):
        for pattern in own:
            upright = _upright(pattern)
            seen.setdefault(upright.tobytes(), (upright, set()))[1].add(image)
    patterns: list[np.ndarray] = []
    counts: list[int] = []
    symmetric: list[int] = []
    for pattern, where in sorted(seen.values(), key=lambda one: -len(one[1])):
        if len(where) < min(LEAST_IMAGES, images):
            break
        if symmetry(pattern) > 1:
            symmetric.append(len(where))
        elif not any(distance(pattern, known) <= ALIKE for known in patterns) or _often(len(where), counts):
            patterns.append(pattern)
            counts.append(len(where))
    if not patterns:
        raise InputError(f"no marker is seen in {min(LEAST_IMAGES, images)} of {images} images; give more images")
    return LearnedDictionary(MarkerDictionary(np.stack(patterns), border), tuple(counts), tuple(symmetric))


def _often(count: int, counts: Sequence[int]) -> bool:
    """Whether a pattern is seen too often to be a misreading of one that it is nearly like."""
    return count > 0.3 * max(counts, default=0)


def _upright(pattern: Bool[np.ndarray, "c c"]) -> Bool[np.ndarray, "c c"]:
    """The same of the four orientations for all readings of one marker."""
    return np.ascontiguousarray(max((np.rot90(pattern, turn) for turn in range(4)), key=lambda one: one.tobytes()))
