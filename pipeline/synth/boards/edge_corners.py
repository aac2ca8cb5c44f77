"""Corners of markers to some hundredths of a pixel: lines fitted to the four edges of the black square, and cut.

OpenCV's own refinement looks for a corner in a small window, in an image whose gamma makes black look smaller than it
is; lines along whole edges, in linear light, use more of the image and lean to neither side.
"""

from __future__ import annotations

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8

ALONG = np.linspace(0.08, 0.92, 25)
"""Where an edge is measured, as share of its length: the corners are left out."""
REACH = (1.5, 4.0)
"""Least and most pixels on either side of an edge that are looked at ..."""
REACH_CELLS = 0.6
"""... and, between them, this share of a cell: the next edge is a cell away."""
STEPS = 17
"""Samples across an edge."""
ROUNDS = 6
"""Each begins at the edges that the last one found."""
LEAST_CONTRAST = 0.02
"""Of linear light, between the two sides of an edge that is measured."""
FARTHEST = 4.0
"""Pixels: a corner that would have to be moved farther is lost."""


def refined(
    image: UInt8[np.ndarray, "h w *rgb"], pixels: Float[np.ndarray, "n 4 2"], cells: int
) -> Float[np.ndarray, "n 4 2"]:
    """The corners of markers of `cells` cells along a side (border included), in a gray or RGB image in sRGB.

    NaN for a corner of which an edge cannot be measured: it is hidden, out of the image or without contrast.
    """
    light = linear_gray(image)
    corners = pixels.copy()
    lost = np.zeros(pixels.shape[:2], bool)
    for _ in range(ROUNDS if len(pixels) else 0):
        corners = _cut(_edges(light, corners, cells))
        lost = ~(np.linalg.norm(corners - pixels, axis=-1) < FARTHEST)
        corners[lost] = pixels[lost]
    corners[lost] = np.nan
    return corners


def linear_gray(image: UInt8[np.ndarray, "h w *rgb"]) -> Float32[np.ndarray, "h w"]:
    """Linear luminance in 0..1 of an sRGB image."""
    values = np.arange(256) / 255.0
    table = np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4).astype(np.float32)
    light = table[image]
    return light if image.ndim == 2 else light @ np.array((0.2126, 0.7152, 0.0722), np.float32)


def _edges(
    light: Float32[np.ndarray, "h w"], corners: Float[np.ndarray, "n 4 2"], cells: int
) -> Float[np.ndarray, "n 4 3"]:
    """Lines (unit normal outward, offset) of the edges from each corner to the next; NaN where there is none to see."""
    ahead = np.roll(corners, -1, axis=1) - corners
    length = np.linalg.norm(ahead, axis=-1, keepdims=True)
    outward = np.stack([ahead[..., 1], -ahead[..., 0]], axis=-1) / length
    reach = np.clip(_width(corners, outward) / cells * REACH_CELLS, *REACH)
    across = np.linspace(-1, 1, STEPS) * reach[..., None]
    start = corners[:, :, None] + ahead[:, :, None] * ALONG[:, None]
    places = start[:, :, :, None] + across[:, :, None, :, None] * outward[:, :, None, None]
    profile = _sampled(light, places)
    dark, bright = profile[..., :3].mean(axis=-1), profile[..., -3:].mean(axis=-1)  # light changes along an edge
    contrast = np.where(bright - dark > LEAST_CONTRAST, bright - dark, np.nan)
    white = np.clip((profile - dark[..., None]) / contrast[..., None], -0.2, 1.2)
    share = (white.sum(axis=-1) - white[..., [0, -1]].mean(axis=-1)) / (STEPS - 1)
    shift = reach[..., None] * (1 - 2 * share)
    return _fitted(start + shift[..., None] * outward[:, :, None], outward)


def _width(corners: Float[np.ndarray, "n 4 2"], outward: Float[np.ndarray, "n 4 2"]) -> Float[np.ndarray, "n 4"]:
    """Width of the marker across each edge, in pixels."""
    middles = (corners + np.roll(corners, -1, axis=1)) / 2
    return np.abs(((middles - np.roll(middles, 2, axis=1)) * outward).sum(axis=-1))


def _sampled(light: Float32[np.ndarray, "h w"], places: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n"]:
    """Bilinear samples; NaN outside the image."""
    rows = places.reshape(len(places), -1, 2).astype(np.float32)
    found = cv2.remap(
        light, rows[..., 0], rows[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=np.nan
    )
    return found.reshape(places.shape[:-1]).astype(np.float64)


def _fitted(points: Float[np.ndarray, "n 4 s 2"], outward: Float[np.ndarray, "n 4 2"]) -> Float[np.ndarray, "n 4 3"]:
    """Lines through points, those that lie far from the rest left out."""
    weight = np.isfinite(points).all(axis=-1).astype(float)
    places = np.nan_to_num(points)
    lines = _line(places, weight, outward)
    for _ in range(2):
        distance = np.abs((places * lines[..., None, :2]).sum(axis=-1) + lines[..., None, 2])
        spread = np.sqrt((weight * distance**2).sum(axis=-1) / np.maximum(weight.sum(axis=-1), 1e-9))
        weight = weight * (distance < np.maximum(2.5 * spread, 0.02)[..., None])
        lines = _line(places, weight, outward)
    lines[weight.sum(axis=-1) < 0.5 * points.shape[2]] = np.nan
    return lines


def _line(
    places: Float[np.ndarray, "n 4 s 2"], weight: Float[np.ndarray, "n 4 s"], outward: Float[np.ndarray, "n 4 2"]
) -> Float[np.ndarray, "n 4 3"]:
    """Lines of least squared distance from the points."""
    middle = (weight[..., None] * places).sum(axis=-2) / np.maximum(weight.sum(axis=-1), 1e-9)[..., None]
    offset = (places - middle[..., None, :]) * np.sqrt(weight)[..., None]
    _, vectors = np.linalg.eigh(np.einsum("...ki,...kj->...ij", offset, offset))
    normal = vectors[..., 0] * np.sign((vectors[..., 0] * outward).sum(axis=-1, keepdims=True))
    return np.concatenate([normal, -(normal * middle).sum(axis=-1, keepdims=True)], axis=-1)


def _cut(lines: Float[np.ndarray, "n 4 3"]) -> Float[np.ndarray, "n 4 2"]:
    """Each corner is where the edge that ends there meets the one that begins."""
    point = np.cross(np.roll(lines, 1, axis=1), lines)
    with np.errstate(divide="ignore", invalid="ignore"):  # edges that do not meet: the corner is lost
        return point[..., :2] / point[..., 2:]
