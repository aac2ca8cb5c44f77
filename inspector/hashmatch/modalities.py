"""The window and a template side by side, in what each test compares, with the points that matched or did not."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Integer, UInt8

from inspector import layers
from pipeline.hashmatch.config import TEMPLATE_SIZE
from pipeline.hashmatch.pictures import gradients_rgb, normals_rgb
from pipeline.hashmatch.window_report import Pictures, PointsOfTests

MATCHED, UNMATCHED, MASKED = (64, 220, 110), (255, 70, 60), (150, 150, 150)
"""Colours of points."""
ZOOM = 4
"""How many times larger pictures with points are drawn than they are."""
MODALITIES = ("colour", "distance", "normals", "gradients")
_OF_TESTS = {1: "distance", 2: "normals", 3: "gradients", 4: "distance", 5: "colour"}


class Pair(NamedTuple):
    """A window and a template in one modality."""

    window: UInt8[np.ndarray, "h w 3"]
    template: UInt8[np.ndarray, "h w 3"]


def pairs(window: Pictures, template: Pictures) -> dict[str, Pair]:
    """Both in all modalities, with colours that can be compared between the two."""
    near, far = distance_range(template.distance)
    shift = median_shift(window.distance, template.distance)
    normals, gradients = (window.normals, template.normals), (window, template)
    return {
        "colour": Pair(window.rgb, template.rgb),
        "distance": Pair(
            layers.near_far(window.distance, near + shift, far + shift), layers.near_far(template.distance, near, far)
        ),
        "normals": Pair(*(normals_rgb(one) for one in normals)),
        "gradients": Pair(*(gradients_rgb(one.gradients, one.orientations) for one in gradients)),
    }


def with_points(pair: Pair, points: PointsOfTests, test: int) -> Pair:
    """Both pictures of a test, enlarged, with its points: green where the window matches the template, else red."""
    chosen = points.test == test
    at = points.template_pixels[chosen].astype(int)
    colors = colors_of_points(points.matched[chosen], points.masked[chosen])
    return Pair(*(_dotted(one, at, colors, 11 if test == 1 else 5) for one in pair))


def modality_of(test: int) -> str:
    """What a test compares."""
    return _OF_TESTS[test]


def colors_of_points(matched: Bool[np.ndarray, "n"], masked: Bool[np.ndarray, "n"]) -> UInt8[np.ndarray, "n 3"]:
    """Green, red, or gray where a mask covers the point."""
    colors = np.where(matched[:, None], np.array(MATCHED), np.array(UNMATCHED))
    return np.where(masked[:, None], np.array(MASKED), colors).astype(np.uint8)


def distance_range(distance: Float[np.ndarray, "h w"]) -> tuple[float, float]:
    """Metres; nearest and farthest measured distance of a template, with a little room."""
    shown = distance[distance > 0]
    if not len(shown):
        return 0.0, 1.0
    low, high = float(shown.min()), float(shown.max())
    room = 0.25 * (high - low) + 1e-3
    return low - room, high + room


def median_shift(window: Float[np.ndarray, "h w"], template: Float[np.ndarray, "h w"]) -> float:
    """Metres by which the window is farther than the template where both are measured, as T4's med_delta."""
    both = (window > 0) & (template > 0)
    return float(np.median(window[both] - template[both])) if both.any() else 0.0


def _dotted(
    pixels: UInt8[np.ndarray, "h w 3"], at: Integer[np.ndarray, "n 2"], colors: UInt8[np.ndarray, "n 3"], radius: int
) -> UInt8[np.ndarray, "H W 3"]:
    size = TEMPLATE_SIZE * ZOOM
    dim = (pixels.astype(np.float32) * 0.8).astype(np.uint8)
    large = cv2.resize(dim, (size, size), interpolation=cv2.INTER_NEAREST)
    for (x, y), color in zip(at * ZOOM + ZOOM // 2, colors, strict=True):
        place = (int(x), int(y))
        cv2.circle(large, place, radius + 2, (15, 15, 15), -1, cv2.LINE_AA)
        cv2.circle(large, place, radius, tuple(map(int, color)), -1, cv2.LINE_AA)
    return large
