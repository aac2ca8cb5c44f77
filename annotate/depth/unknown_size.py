"""Depth correction from markers of unknown size and layout: what they tell, and what they cannot.

Images see a scene of twice the size at twice the distance alike. So the size of the markers comes from the measured
depth, and a factor a of the depth cannot be told apart from it: with d_c = a d + b only side / a and b / a are
determined. They are stated for a = 1; if the true side is known, a is its ratio to the stated one.
"""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from annotate.calibration.dictionary import MarkerDictionary
from annotate.calibration.learned_board import LearnedBoard, learn_boards
from annotate.calibration.markers import detect_markers
from annotate.depth.corner_depth import corner_depths
from annotate.depth.estimate import DepthEstimate, estimate
from annotate.depth.from_board import Collected, collected
from annotate.depth.samples import DepthSamples
from pipeline.bop.dataset import Dataset
from pipeline.exceptions import InputError
from pipeline.geometry import project, transform_points
from pipeline.scene import Camera, ImageKey
from pipeline.synth.boards import Detections

FEWEST_MARKERS = 2
"""In one image; the tilt of one alone is ambiguous."""
COMMON = ("samples", "images", "depth_range", "mean_abs_before", "mean_abs_after_held_out")
"""What is said of the fit behind an estimate."""
FARTHEST_PX = 3.0
"""Corners that lie farther from their place on the learned board are left out."""


@dataclass(frozen=True, eq=False)
class UnknownSizeEstimate:
    """What markers of unknown size tell of the depth."""

    side: float
    """Metres, if a = 1 and b as below."""
    side_std: float | None
    """None for fewer than three images."""
    b: float
    """Metres, if a = 1."""
    b_std: float | None
    side_without_offset: float
    """Metres, if a = 1 and b = 0."""
    rms_px: float
    """Of the learned boards' corners in all images."""
    estimate: DepthEstimate
    """The fit behind it, with the markers' side taken to be `side_without_offset`."""
    notes: tuple[str, ...]

    def as_dict(self) -> dict[str, Any]:
        """For JSON, metres."""
        return {
            "unit": "m",
            "a": None,
            "side_if_a_is_1": self.side,
            "std_side": self.side_std,
            "b_if_a_is_1": self.b,
            "std_b": self.b_std,
            "side_if_a_is_1_and_b_0": self.side_without_offset,
            "rms_px": self.rms_px,
            **{name: value for name, value in self.estimate.as_dict().items() if name in COMMON},
            "notes": list(self.notes),
        }


@dataclass(frozen=True, eq=False)
class MarkerSamples:
    """Depth at the corners of markers, expected in units of their side."""

    collected: Collected
    boards: tuple[LearnedBoard, ...]

    def with_side(self, side: float) -> DepthSamples:
        """The samples with expected depth in metres, for markers of this side."""
        found = self.collected.samples
        return DepthSamples(
            found.measured, side * found.expected, found.pixels, found.images, found.keys, found.image_size
        )


def marker_samples(dataset: Dataset, keys: Sequence[ImageKey], dictionary: MarkerDictionary) -> MarkerSamples:
    """Find the markers of a dictionary in all images, learn how they lie, scene by scene, and collect.

    Raises InputError if no image has two of them with measured depth about.
    """
    found: dict[int, DepthSamples | str] = {}
    boards: list[LearnedBoard] = []
    scenes: dict[int, list[int]] = defaultdict(list)
    for position, key in enumerate(keys):
        scenes[key.scene_id].append(position)
    for positions in scenes.values():
        seen, cameras, usable = [], [], []
        for position in positions:
            detections = _detected(dataset, keys[position], dictionary)
            if isinstance(detections, str):
                found[position] = detections
            else:
                seen.append(detections)
                cameras.append(dataset.camera(keys[position]))
                usable.append(position)
        for board in learn_boards(seen, cameras):
            boards.append(board)
            for row in board.views:
                samples = _samples(dataset, keys[usable[row]], board, row, seen[row], cameras[row])
                found[usable[row]] = samples
    return MarkerSamples(collected(keys, found, str(dataset.root)), tuple(boards))


def estimate_unknown_size(samples: MarkerSamples, near: float = 0.0, far: float = float("inf")) -> UnknownSizeEstimate:
    """Estimate size and offset together; `near` and `far` are metres of measured depth.

    Raises InputError if too few samples are in the range.
    """
    units = samples.collected.samples
    rough = float(np.median(units.measured / units.expected))
    found = estimate(samples.with_side(rough), near, far, samples.collected.notes)
    correction, std = found.fit.correction, found.confidence.std
    notes = [
        "the size of the markers is not known: it takes up the factor a, which cannot be told; give it with --side",
        *found.notes,
    ]
    errors = np.concatenate([board.errors_px for board in samples.boards])
    rms = float(np.sqrt((errors**2).mean()))
    if correction.kind == "offset":
        return UnknownSizeEstimate(rough, None, 0.0, None, rough, rms, found, tuple(notes))
    side, b = rough / correction.a, correction.b / correction.a
    side_std = None if std is None else float(side * std[0] / correction.a)
    b_std = None if std is None else float(std[1] / correction.a)
    if b_std is not None and abs(b) < 2 * b_std:
        notes.append(f"b = {1000 * b:.1f} +- {1000 * b_std:.1f} mm is not told apart from 0")
    return UnknownSizeEstimate(side, side_std, b, b_std, rough, rms, found, tuple(notes))


def _detected(dataset: Dataset, key: ImageKey, dictionary: MarkerDictionary) -> Detections | str:
    try:
        rgb, depth = dataset.rgb(key), dataset.depth(key)
    except InputError as error:
        return str(error)
    if rgb is None or depth is None:
        return f"has no {'colour' if rgb is None else 'depth'} image"
    if not (depth > 0).any():
        return "depth is 0 in all pixels; give images whose depth was measured"
    detections = detect_markers(rgb, dictionary)
    if len(detections.ids) < FEWEST_MARKERS:
        seen = len(detections.ids)
        return f"{seen} marker{'' if seen == 1 else 's'} of the dictionary seen; at least {FEWEST_MARKERS} are needed"
    return detections


def _samples(
    dataset: Dataset, key: ImageKey, board: LearnedBoard, row: int, seen: Detections, camera: Camera
) -> DepthSamples | str:
    corners = np.concatenate([board.placements[k].corners for k in seen.ids])
    in_camera = transform_points(board.views[row], corners)
    pixels = project(camera.K, in_camera)
    depth = dataset.depth(key)
    assert depth is not None  # `_detected` has seen it
    measured = corner_depths(depth, pixels)
    known = np.isfinite(measured) & (np.linalg.norm(pixels - seen.pixels.reshape(-1, 2), axis=1) < FARTHEST_PX)
    if not known.any():
        return f"depth is measured about none of the {len(corners)} corners, or not on one plane"
    images = np.zeros(int(known.sum()), int)
    return DepthSamples(measured[known], in_camera[known, 2], pixels[known], images, (), (camera.width, camera.height))
