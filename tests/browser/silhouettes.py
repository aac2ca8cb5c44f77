"""Where the outline of a coloured silhouette lies in a screenshot, and how far that is from where it belongs."""

from typing import NamedTuple

import cv2
import numpy as np

from inspector.viewport import Viewport
from pipeline.rendering import render
from pipeline.scene import Camera, Model

FINENESS = 8
"""Fine pixels per image pixel of the outline that is expected."""


class Distances(NamedTuple):
    """Between the outline seen and the one expected, in image pixels."""

    of_seen: np.ndarray
    """Of every point of the outline seen: to the expected outline."""
    of_expected: np.ndarray
    """Of every point of the expected outline that is in the window: to the outline seen."""


def outline(colorfulness: np.ndarray, level: float) -> np.ndarray:
    """Points (x, y), in pixels from the upper left corner of the screenshot, at which a level is crossed."""
    values = colorfulness.astype(float)
    points = []
    for axis in (0, 1):
        a, b = (values[:-1], values[1:]) if axis == 0 else (values[:, :-1], values[:, 1:])
        rows, columns = np.nonzero((a < level) != (b < level))
        share = (level - a[rows, columns]) / (b[rows, columns] - a[rows, columns])
        x = columns + 0.5 + (share if axis == 1 else 0)
        y = rows + 0.5 + (share if axis == 0 else 0)
        points.append(np.stack([x, y], axis=1))
    return np.concatenate(points)


def distances(seen: np.ndarray, viewport: Viewport, model: Model, camera_from_model: np.ndarray) -> Distances:
    """Hold an outline in the window (points in CSS pixels) against the model's silhouette in a pose."""
    camera, size = viewport.camera, np.array([viewport.window_width, viewport.window_height])
    pixels = np.array([viewport.pixel_at(x, y) for x, y in seen / size])
    fine = render(model, _fine(camera), camera_from_model, pixel_center=0.0).mask
    fine = np.pad(fine, 1)
    away = np.where(fine, _to_zero(fine), _to_zero(~fine)) - 0.5
    at = np.clip(np.round((pixels + 0.5) * FINENESS - 0.5).astype(int) + 1, 0, np.array(fine.shape[::-1]) - 1)
    border = fine & (_to_zero(fine) <= 1)
    rows, columns = np.nonzero(border)
    expected = (np.stack([columns, rows], axis=1)[::FINENESS] - 0.5) / FINENESS - 0.5
    inside = np.array([_in_window(viewport, u, v) for u, v in expected])
    gaps = np.array([np.linalg.norm(pixels - point, axis=1).min() for point in expected[inside]])
    return Distances(away[at[:, 1], at[:, 0]] / FINENESS, gaps)


def _fine(camera: Camera) -> Camera:
    """The same view with finer pixels: u = (fine u + 0.5) / FINENESS - 0.5, since centres of pixels are integers."""
    scale = np.array([[FINENESS, 0, (FINENESS - 1) / 2], [0, FINENESS, (FINENESS - 1) / 2], [0, 0, 1]])
    return Camera(scale @ camera.K, camera.width * FINENESS, camera.height * FINENESS)


def _to_zero(mask: np.ndarray) -> np.ndarray:
    return cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2, 5)


def _in_window(viewport: Viewport, u: float, v: float) -> bool:
    x, y = viewport.window_at(u, v)
    edge = 3 / min(viewport.window_width, viewport.window_height)
    return edge < x < 1 - edge and edge < y < 1 - edge
