"""What templates and windows look like in colour, distance, normals and gradients, side by side at the same size."""

from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float, Integer, UInt8

from pipeline.hashmatch import channels
from pipeline.hashmatch.config import TEMPLATE_SIZE, HashMatchConfig
from pipeline.hashmatch.pyramid import Base
from pipeline.hashmatch.views import fitting_distance, render_views
from pipeline.scene import Model


class Pictures(NamedTuple):
    """A template or a window in the modalities of the tests, TEMPLATE_SIZE pixels square."""

    rgb: UInt8[np.ndarray, "w w 3"]
    """Black where there is nothing."""
    distance: Float[np.ndarray, "w w"]
    """float32 metres from the camera centre, 0 where not measured; T4 compares them up to their median difference."""
    normals: Float[np.ndarray, "w w 3"]
    """float32, relative to the viewing rays: (0, 0, -1) faces the camera; 0 where there is none."""
    gradients: Float[np.ndarray, "w w"]
    """float32 response of the Sobel operator over 8-bit colour, 0 below the threshold."""
    orientations: Float[np.ndarray, "w w"]
    """float32 radians of the gradients, 0 to pi."""


def template_pictures(
    model: Model, rotation: Float[np.ndarray, "3 3"], focal_px: float, gradient_threshold: float
) -> Pictures:
    """Render a template: the model, with its colours, turned by R_t and as far away as templates are."""
    (view,) = render_views(model, rotation[None], fitting_distance(model, focal_px), focal_px)
    gradients, orientations = channels.gradient_orientations(view.rgb, gradient_threshold)
    return Pictures(view.rgb, view.distance, view.normals, gradients, orientations)


def window_pictures(
    base: Base, scale: float, size: tuple[int, int], corner: Integer[np.ndarray, "2"], config: HashMatchConfig
) -> Pictures:
    """Cut a window out of an image as matching sees it.

    Args:
        base: The image with its distances and normals.
        scale: s_w.
        size: Width and height of the level with its border of `config.overhang_px`.
        corner: First pixel (x, y) of the window in it.
        config: Overhang and threshold of the gradients.

    """
    border = config.overhang_px
    inner = (size[0] - 2 * border, size[1] - 2 * border)
    x, y = corner

    def cut(values: np.ndarray, interpolation: int = cv2.INTER_NEAREST_EXACT) -> np.ndarray:
        resized = cv2.resize(values, inner, interpolation=interpolation)
        padded = np.pad(resized, [(border, border)] * 2 + [(0, 0)] * (values.ndim - 2))
        return padded[y : y + TEMPLATE_SIZE, x : x + TEMPLATE_SIZE]

    rgb = base.image.rgb
    if rgb is None:
        rgb = np.zeros((*base.depth.shape, 3), np.uint8)
    interpolation = cv2.INTER_AREA if inner[0] < base.depth.shape[1] else cv2.INTER_LINEAR
    resized = cv2.resize(rgb, inner, interpolation=interpolation)
    around = np.pad(resized, [(border, border)] * 2 + [(0, 0)])
    gradients, orientations = channels.gradient_orientations(resized, config.gradient_threshold)
    area = (slice(y, y + TEMPLATE_SIZE), slice(x, x + TEMPLATE_SIZE))
    return Pictures(
        rgb=around[area],
        distance=cut(base.distance),
        normals=np.stack([cut(np.ascontiguousarray(base.normals[..., i])) for i in range(3)], axis=-1),
        gradients=np.pad(gradients, border)[area],
        orientations=np.pad(orientations, border)[area],
    )


def normals_rgb(normals: Float[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 3"]:
    """Normals as colours: red to the right, green up, blue towards the camera; black where there is none."""
    colors = (0.5 + 0.5 * normals * np.array([1, -1, -1])) * 255
    return np.where(normals.any(axis=-1, keepdims=True), colors, 0).astype(np.uint8)


def gradients_rgb(
    gradients: Float[np.ndarray, "h w"], orientations: Float[np.ndarray, "h w"]
) -> UInt8[np.ndarray, "h w 3"]:
    """Gradients as colours: hue by orientation, bright where strong; black where there is none."""
    strongest = max(float(np.quantile(gradients[gradients > 0], 0.9)), 1.0) if (gradients > 0).any() else 1.0
    hue = (orientations * (180 / np.pi)) % 180
    value = np.where(gradients > 0, 70 + 185 * np.clip(gradients / strongest, 0, 1), 0)
    hsv = np.stack([hue, np.full_like(hue, 220), value], axis=-1).astype(np.uint8)
    return cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)
