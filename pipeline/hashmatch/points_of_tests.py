"""The points of the tests T1 to T5 at one detection, and which of them match: what a viewer draws green and red.

Slow and plain; the compiled tests in `verification` say only how many match.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer

from pipeline.hashmatch.channels import NONE
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.detector import Detector, Matching
from pipeline.hashmatch.pyramid import Level
from pipeline.hashmatch.templates import DISTANCE_UNIT, Templates, size_points
from pipeline.hashmatch.window_grid import corner_at


class PointsOfTests(NamedTuple):
    """Points of all tests, one test after the other."""

    test: Integer[np.ndarray, "n"]
    """1 to 5."""
    pixels: Float[np.ndarray, "n 2"]
    """(u, v) in the image."""
    template_pixels: Integer[np.ndarray, "n 2"]
    """(x, y) in the template."""
    matched: Bool[np.ndarray, "n"]
    masked: Bool[np.ndarray, "n"]
    """Left out of the test."""


def points_of_tests(detector: Detector, matching: Matching, row: int) -> PointsOfTests:
    """Points of the tests of a detection (row of `matching.detections`)."""
    found = matching.detections
    own = detector.objects[found.objects[row]]
    matched = next(one for one in matching.levels if one.level.index == found.levels[row])
    corner = corner_at(matched.level, found.centers[row])
    return points_at_window(own, matched.level, matched.scale, int(found.templates[row]), corner, detector.config)


def points_at_window(
    own: Templates, level: Level, scale: float, template: int, corner: Integer[np.ndarray, "2"], config: HashMatchConfig
) -> PointsOfTests:
    """Points of the tests of a template at a window, given by its first pixel in the maps of its level.

    `scale` is s_w times the focal length of the templates by that of the image.
    """
    count = int(own.normal_counts[template])
    at_normals = own.normal_points[template, :count].astype(int)
    gradients = int(own.gradient_counts[template])
    at_gradients = own.gradient_points[template, :gradients].astype(int)
    x, y = (at_normals + corner).T
    normal = (level.normal_response[y, x] & own.normal_bits[template, :count]) != 0
    x, y = (at_gradients + corner).T
    gradient = (level.gradient_response[y, x] & own.gradient_bits[template, :gradients]) != 0
    parts = [
        (1, size_points(), _size(own, level, scale, template, corner, config)),
        (2, at_normals, normal),
        (3, at_gradients, gradient),
        (4, at_normals, _distance(own, level, template, at_normals + corner, config)),
    ]
    if own.colored:
        parts.append((5, at_normals, _color(own, level, template, at_normals + corner, config)))
    return _joined(parts, level, corner)


def _size(
    own: Templates, level: Level, scale: float, template: int, corner: np.ndarray, config: HashMatchConfig
) -> Bool[np.ndarray, "5"]:
    near = own.nearest[template]
    behind = near - own.distance if config.size_from_surface and near > 0 else -0.5 * own.diameter
    expected = scale * own.distance + behind
    x, y = (size_points() + corner).T
    measured, factor = level.distance[y, x], np.sqrt(config.scale_factor)
    return np.asarray((measured > 0) & (measured >= expected / factor) & (measured <= expected * factor))


def _distance(
    own: Templates, level: Level, template: int, points: np.ndarray, config: HashMatchConfig
) -> Bool[np.ndarray, "n"]:
    shown = own.distance + own.point_distances[template, : len(points)] * DISTANCE_UNIT
    there = level.distance[points[:, 1], points[:, 0]]
    if not (there > 0).any():
        return np.zeros(len(points), bool)
    goal = shown + np.median((there - shown)[there > 0])
    around = _around(level.distance, points, config.neighborhood_px // 2, 0)
    near = np.abs(around - goal[:, None]) < config.distance_tolerance * own.diameter
    return np.any((around > 0) & near, axis=1)


def _color(
    own: Templates, level: Level, template: int, points: np.ndarray, config: HashMatchConfig
) -> Bool[np.ndarray, "n"]:
    around = _around(level.hue, points, config.neighborhood_px // 2, NONE)
    apart = np.abs(around.astype(int) - own.point_hues[template, : len(points)].astype(int)[:, None])
    return np.any((around != NONE) & (np.minimum(apart, 180 - apart) <= config.hue_tolerance_deg / 2), axis=1)


def _around(values: np.ndarray, points: np.ndarray, reach: int, empty: float) -> np.ndarray:
    """Values in the square around each point, one row per point."""
    padded = np.pad(values, reach, constant_values=empty)
    steps = np.arange(2 * reach + 1)
    rows = (points[:, 1, None, None] + steps[:, None]) + 0 * steps
    columns = (points[:, 0, None, None] + steps) + 0 * steps[:, None]
    return padded[rows, columns].reshape(len(points), -1)


def _joined(parts: list[tuple[int, np.ndarray, np.ndarray]], level: Level, corner: np.ndarray) -> PointsOfTests:
    points = np.concatenate([points for _, points, _ in parts])
    x, y = (points + corner).T
    in_level = points + corner - level.overhang
    return PointsOfTests(
        test=np.concatenate([np.full(len(points), test) for test, points, _ in parts]),
        pixels=(in_level + 0.5) / level.scale - 0.5,
        template_pixels=points,
        matched=np.concatenate([matched for _, _, matched in parts]) & ~level.masked[y, x],
        masked=level.masked[y, x],
    )
