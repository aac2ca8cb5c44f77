"""What is compared between a template and a window, computed alike for both: distances, normals, gradients, hues.

Directions are taken relative to the viewing ray of each pixel, so that an object looks the same wherever it is in the
image: off the centre, a template stands for the object turned by R_a (thesis sec. Refinement).
"""

from typing import no_type_check

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from pipeline.hashmatch.compiling import compiled
from pipeline.hashmatch.config import GRADIENT_BINS, NORMAL_BINS

NONE = 255
"""Bin or hue of a pixel that has none."""

FRONTAL = np.cos(np.deg2rad(20.7))
"""Cosine of the inclination up to which a surface faces the camera: an eighth of the visible half of a sphere."""

NORMAL_RADIUS_PX = 4
"""Half the side of the square to which a plane is fitted."""

HUE_BINS = 180
"""Hues are stored in steps of two degrees."""


def distances(depth: Float[np.ndarray, "h w"], K: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "h w"]:
    """Distance of each pixel's point from the camera centre, float32 metres, 0 where depth is 0 (thesis, T1)."""
    x = (np.arange(depth.shape[1]) - K[0, 2]) / K[0, 0]
    y = (np.arange(depth.shape[0]) - K[1, 2]) / K[1, 1]
    return (depth * np.sqrt(x**2 + (y**2)[:, None] + 1)).astype(np.float32)


def normals(
    depth: Float[np.ndarray, "h w"], K: Float[np.ndarray, "3 3"], radius: int = NORMAL_RADIUS_PX
) -> Float[np.ndarray, "h w 3"]:
    """Unit normals relative to the viewing rays, float32: (0, 0, -1) faces the camera; zero where there is none.

    A plane is fitted to the pixels around, leaving out those beyond a depth step (Hinterstoisser et al., PAMI 2012).
    """
    return _normals(np.ascontiguousarray(depth, np.float32), np.ascontiguousarray(K, np.float64), radius)


@compiled
@no_type_check
def _normals(depth, K, radius):
    height, width = depth.shape
    result = np.zeros((height, width, 3), np.float32)
    fx, fy, cx, cy = K[0, 0], K[1, 1], K[0, 2], K[1, 2]
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            if z <= 0:
                continue
            reach = 3.0 * radius * z / fx  # a surface inclined by some 70 degrees
            n = su = sv = sz = suu = suv = svv = suz = svz = 0.0
            for j in range(max(0, v - radius), min(height, v + radius + 1)):
                for i in range(max(0, u - radius), min(width, u + radius + 1)):
                    d = np.float64(depth[j, i]) - z
                    if depth[j, i] > 0 and abs(d) < reach:
                        a, b = i - u, j - v
                        n += 1
                        su += a
                        sv += b
                        sz += d
                        suu += a * a
                        suv += a * b
                        svv += b * b
                        suz += a * d
                        svz += b * d
            if n < 6:
                continue
            uu, uv, vv = suu - su * su / n, suv - su * sv / n, svv - sv * sv / n
            uz, vz = suz - su * sz / n, svz - sv * sz / n
            det = uu * vv - uv * uv
            if det < 1e-6:
                continue
            du, dv = (uz * vv - vz * uv) / det, (vz * uu - uz * uv) / det
            x, y = (u - cx) / fx, (v - cy) / fy
            # the cross product of the point's derivatives by u and by v, turned towards the camera
            nx = -du * z / fy
            ny = -dv * z / fx
            nz = z * z / (fx * fy) + dv * y * z / fx + du * x * z / fy
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            nx, ny, nz = -nx / length, -ny / length, -nz / length
            ray = np.sqrt(x * x + y * y + 1)
            rx, ry, rz = x / ray, y / ray, 1 / ray
            # the smallest rotation that brings the ray to the optical axis
            along = (nx * rx + ny * ry + nz * (rz + 1)) / (1 + rz)
            toward = nx * rx + ny * ry + nz * rz
            result[v, u, 0] = nx - along * rx
            result[v, u, 1] = ny - along * ry
            result[v, u, 2] = nz - along * (rz + 1) + 2 * toward
    return result


def normal_bins(normals: Float[np.ndarray, "*n 3"]) -> UInt8[np.ndarray, "*n"]:
    """Quantize normals: 0 faces the camera, 1.. by azimuth, NONE where the normal is zero."""
    sectors = NORMAL_BINS - 1
    azimuth = np.arctan2(normals[..., 1], normals[..., 0]) % (2 * np.pi)
    bins = 1 + np.minimum((azimuth * (sectors / (2 * np.pi))).astype(np.uint8), sectors - 1)
    bins[normals[..., 2] < -FRONTAL] = 0
    bins[~normals.any(axis=-1)] = NONE
    return bins.astype(np.uint8)


def normal_bits(normals: Float[np.ndarray, "*n 3"], margin: float) -> UInt8[np.ndarray, "*n"]:
    """The bins that a template's normals match, as bits: their own and those nearer than a margin in radians."""
    bits = np.zeros(normals.shape[:-1], np.uint8)
    inclination = np.arccos(np.clip(-normals[..., 2], -1, 1))
    azimuth = np.arctan2(normals[..., 1], normals[..., 0])
    # turning the normal towards and away from the camera, and around it
    for tilt in (-margin, 0.0, margin):
        tilted = np.abs(inclination + tilt)
        spin = np.minimum(margin / np.maximum(np.sin(tilted), 1e-3), np.pi)
        for around in (-1, 0, 1):
            angle = azimuth + around * spin
            sine = np.sin(tilted)
            moved = np.stack([sine * np.cos(angle), sine * np.sin(angle), -np.cos(tilted)], axis=-1)
            bits |= (1 << normal_bins(moved)).astype(np.uint8)
    bits[~normals.any(axis=-1)] = 0
    return bits


def gradient_orientations(
    rgb: UInt8[np.ndarray, "h w 3"], threshold: float
) -> tuple[Float[np.ndarray, "h w"], Float[np.ndarray, "h w"]]:
    """Magnitude (0 below the threshold) and orientation (radians, 0..pi) of the colour channel that changes most."""
    blurred = cv2.GaussianBlur(rgb, (5, 5), 0)
    return _gradients(blurred, threshold)


@compiled
@no_type_check
def _gradients(rgb, threshold):
    height, width = rgb.shape[:2]
    magnitude = np.zeros((height, width), np.float32)
    orientation = np.zeros((height, width), np.float32)
    for v in range(1, height - 1):
        for u in range(1, width - 1):
            best, best_x, best_y = 0, 0, 0
            for c in range(3):
                a, b, d = np.int32(rgb[v - 1, u - 1, c]), np.int32(rgb[v - 1, u, c]), np.int32(rgb[v - 1, u + 1, c])
                e, f = np.int32(rgb[v, u - 1, c]), np.int32(rgb[v, u + 1, c])
                g, h, i = np.int32(rgb[v + 1, u - 1, c]), np.int32(rgb[v + 1, u, c]), np.int32(rgb[v + 1, u + 1, c])
                x = d + 2 * f + i - a - 2 * e - g
                y = g + 2 * h + i - a - 2 * b - d
                squared = x * x + y * y
                if squared > best:
                    best, best_x, best_y = squared, x, y
            if best > threshold * threshold:
                magnitude[v, u] = np.sqrt(np.float32(best))
                angle = np.arctan2(np.float32(best_y), np.float32(best_x))
                orientation[v, u] = angle if angle >= 0 else angle + np.float32(np.pi)
    return magnitude, orientation


def gradient_bits(
    magnitude: Float[np.ndarray, "*n"], orientation: Float[np.ndarray, "*n"], margin: float = 0.0
) -> UInt8[np.ndarray, "*n"]:
    """Bins of gradients as bits: their own and those nearer than a margin in radians; 0 without gradient."""
    bits = np.zeros(magnitude.shape, np.uint8)
    for turn in {-margin, 0.0, margin}:
        angle = (orientation + turn) % np.pi
        bits |= (1 << np.minimum((angle * (GRADIENT_BINS / np.pi)).astype(np.uint8), GRADIENT_BINS - 1)).astype(
            np.uint8
        )
    bits[magnitude == 0] = 0
    return bits


def hues(rgb: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w"]:
    """Hue in steps of two degrees; black counts as blue and white and gray as yellow (Hinterstoisser et al., ACCV 2012)."""
    hue, saturation, value = cv2.split(cv2.cvtColor(rgb, cv2.COLOR_RGB2HSV))
    hue = hue.copy()
    hue[saturation < 0.12 * 255] = HUE_BINS // 6
    hue[value < 0.12 * 255] = HUE_BINS * 2 // 3
    return hue
