"""Objectness of windows: how many depth edgels they hold (thesis sec. Objectness Filter)."""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Integer


def edgels(depth: Float[np.ndarray, "h w"], threshold: float) -> Bool[np.ndarray, "h w"]:
    """Pixels where the Sobel operator over depth responds with more than tau (metres); holes are filled before."""
    whole = filled(depth)
    dx = cv2.Sobel(whole, cv2.CV_32F, 1, 0, ksize=3, borderType=cv2.BORDER_REPLICATE)
    dy = cv2.Sobel(whole, cv2.CV_32F, 0, 1, ksize=3, borderType=cv2.BORDER_REPLICATE)
    unknown = cv2.dilate((whole <= 0).astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    return (np.hypot(dx, dy) > threshold) & ~unknown


def edgel_counts(
    edgel: Bool[np.ndarray, "h w"], x: Integer[np.ndarray, "n"], y: Integer[np.ndarray, "n"], size: int
) -> Integer[np.ndarray, "n"]:
    """Number of edgels in each window, given by its first pixel, through an integral image."""
    integral = cv2.integral(edgel.astype(np.uint8))
    return integral[y + size, x + size] - integral[y, x + size] - integral[y + size, x] + integral[y, x]


def filled(depth: Float[np.ndarray, "h w"], steps: int = 6) -> Float[np.ndarray, "h w"]:
    """Depth with holes filled from their rims with the farthest value, as depth is missing beside nearer objects."""
    result = np.ascontiguousarray(depth, np.float32).copy()
    kernel = np.ones((3, 3), np.uint8)
    for _ in range(steps):
        holes = result <= 0
        if not holes.any():
            break
        result[holes] = cv2.dilate(result, kernel)[holes]
    return result
