"""How far predicted edges are from those of an image: contours of poses, and outlines of depth over colour.

Positions are pixels (x, y); the centre of pixel (0, 0) is at (0, 0).
"""

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8

SMOOTHING_PX = 1.0
"""Standard deviation of the Gaussian window before images are differentiated."""
OUTLINE_SMOOTHING_PX = 1.5
"""The same for masks, whose outlines are stairs."""
STEP_PX = 0.5
"""Distance of samples along a normal."""
LEAST_STRENGTH = 4.0
"""Gray levels per pixel (of 255) that make an edge."""
STRONG = 20.0
"""Gray levels per pixel beyond which an edge counts no more than others: else a few of them decide alone."""
NEAR_PX = 1.5
"""An edge is that of an outline if it lies so close to where the common shift puts it."""
ROUNDS = 10
MOST_CONDITION = 1e4
"""Of the equations of a shift: outlines that all run one way tell only what is across them."""
FEWEST = 12
"""Points that a shift is estimated from."""


@dataclass(frozen=True, eq=False)
class Outline:
    """Points along the outline of a mask."""

    points: Float[np.ndarray, "n 2"]
    normals: Float[np.ndarray, "n 2"]
    """Unit vectors, out of the mask."""


@dataclass(frozen=True)
class Shift:
    """A common displacement of edges against an outline, in pixels, with its standard deviations."""

    x: float
    y: float
    std_x: float
    std_y: float
    points: int
    """Points of the outline that have an edge near where the shift puts them."""

    @property
    def length(self) -> float:
        """Pixels."""
        return float(np.hypot(self.x, self.y))


def outline(mask: Bool[np.ndarray, "h w"], kept: Bool[np.ndarray, "h w"] | None = None) -> Outline:
    """Outline of a mask to a fraction of a pixel; at the image's border there is none.

    Only the points at pixels of `kept`, if it is given. Corners are rounded by about a pixel.
    """
    bytes_ = mask.astype(np.uint8)
    inner = cv2.erode(bytes_, np.ones((3, 3), np.uint8), borderType=cv2.BORDER_CONSTANT, borderValue=1)
    rim = (bytes_ > inner) if kept is None else (bytes_ > inner) & kept
    v, u = np.nonzero(rim)
    soft = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), OUTLINE_SMOOTHING_PX)
    outward = -np.stack([_slope(soft, 1, 0)[v, u], _slope(soft, 0, 1)[v, u]], axis=-1).astype(float)
    steepness = np.linalg.norm(outward, axis=-1)
    clear = steepness > 0.05  # elsewhere the mask is thinner than the window and has no side
    normals = outward[clear] / steepness[clear, None]
    to_edge = (soft[v, u][clear] - 0.5) / steepness[clear]
    points = np.stack([u, v], axis=-1)[clear] + np.clip(to_edge, -1.5, 1.5)[:, None] * normals
    return Outline(points, normals)


def _slope(image: np.ndarray, x: int, y: int) -> np.ndarray:
    return cv2.Scharr(image, cv2.CV_32F, x, y, scale=1 / 32)


def edge_profiles(
    image: UInt8[np.ndarray, "h w *rgb"], found: Outline, reach_px: int
) -> tuple[Float[np.ndarray, "s"], Float32[np.ndarray, "n s"]]:
    """Offsets along the normals, and how strong the image's edges are there (gray levels per pixel, across the normal).

    The strongest of the colours counts. Outside the image there is nothing.
    """
    steps = np.arange(-reach_px / STEP_PX - 1, reach_px / STEP_PX + 2) * STEP_PX
    smooth = cv2.GaussianBlur(image, (0, 0), SMOOTHING_PX).astype(np.float32)
    places = (found.points[:, None] + steps[:, None] * found.normals[:, None]).astype(np.float32)
    rows = max(1, 30_000 // max(len(steps), 1))  # OpenCV's remap takes at most 32767 rows
    parts = [
        cv2.remap(smooth, part[..., 0], part[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        for part in np.split(places, range(rows, len(places), rows))
        if len(part)
    ]
    colours = np.concatenate(parts) if parts else np.empty((0, len(steps)), np.float32)
    if colours.ndim == 2:
        colours = colours[..., None]
    strength = np.abs(colours[:, 2:] - colours[:, :-2]).max(axis=-1, initial=0.0) / (2 * STEP_PX)
    return steps[1:-1], strength


def nearest_edges(
    steps: Float[np.ndarray, "s"], strength: Float32[np.ndarray, "n s"], expected: Float[np.ndarray, "n"]
) -> Float[np.ndarray, "n"]:
    """Offset of the edge that is nearest to the expected offset, for each point; NaN where there is none in reach."""
    middle = strength[:, 1:-1]
    before, after = strength[:, :-2], strength[:, 2:]
    peaks = (middle >= before) & (middle > after) & (middle > LEAST_STRENGTH)
    curvature = before - 2 * middle + after
    bend = np.where(curvature < 0, 0.5 * (before - after) / np.where(curvature < 0, curvature, 1.0), 0.0)
    offsets = steps[1:-1] + STEP_PX * np.clip(bend, -0.5, 0.5)
    distance = np.where(peaks, np.abs(offsets - expected[:, None]), np.inf)
    best = distance.argmin(axis=1) if distance.shape[1] else np.zeros(len(distance), int)
    rows = np.arange(len(offsets))
    return np.where(np.isfinite(distance[rows, best]), offsets[rows, best], np.nan)


def common_shift(
    found: Outline, steps: Float[np.ndarray, "s"], strength: Float32[np.ndarray, "n s"], with_margin: bool = False
) -> Shift | None:
    """The displacement that brings an outline onto the edges of the image; None where too few edges tell it.

    `with_margin` allows for an outline that is too small or too large by the same all around, as that of depth is. Of
    all whole shifts in reach the one along whose normals the edges are strongest, then least squares of the distances
    from the edges near by. The standard deviations take neighbouring points to be alike, so they are not too small.
    """
    if len(found.points) < FEWEST:
        return None
    factors = np.column_stack([found.normals, np.ones(len(found.normals))])[:, : 3 if with_margin else 2]
    shift = np.array([*_strongest(found.normals, steps, strength), 0.0])[: factors.shape[1]]
    fitted: _Fitted | None = None
    for _ in range(ROUNDS):
        fitted = _fit_near(factors, nearest_edges(steps, strength, factors @ shift), shift)
        if fitted is None:
            return None
        shift = fitted.shift
    assert fitted is not None  # there is a round
    std_x, std_y = fitted.std[:2].tolist()
    return Shift(float(shift[0]), float(shift[1]), std_x, std_y, fitted.points)


class _Fitted(NamedTuple):
    shift: Float[np.ndarray, "k"]
    std: Float[np.ndarray, "k"]
    points: int


def _fit_near(
    factors: Float[np.ndarray, "n k"], offsets: Float[np.ndarray, "n"], shift: Float[np.ndarray, "k"]
) -> _Fitted | None:
    """Least squares of the offsets that lie near where a shift puts them; None where they do not tell one."""
    near = np.abs(offsets - factors @ shift) < NEAR_PX  # False for NaN
    normal_matrix = factors[near].T @ factors[near]
    if near.sum() < FEWEST or np.linalg.cond(normal_matrix) > MOST_CONDITION:
        return None
    solved = np.linalg.solve(normal_matrix, factors[near].T @ offsets[near])
    residuals = offsets[near] - factors[near] @ solved
    independent = max(near.sum() / (2 * NEAR_PX + 1) - len(solved), 1.0)
    covariance = np.linalg.inv(normal_matrix / near.sum()) * residuals.var() / independent
    return _Fitted(solved, np.sqrt(np.diag(covariance)), int(near.sum()))


def _strongest(
    normals: Float[np.ndarray, "n 2"], steps: Float[np.ndarray, "s"], strength: Float32[np.ndarray, "n s"]
) -> tuple[float, float]:
    """The whole shift, within the reach of the profiles, at which the edges are strongest, near ones preferred."""
    reach = int(steps[-1])
    grid = np.arange(-reach, reach + 1)
    x, y = (axis.ravel() for axis in np.meshgrid(grid, grid))
    inside = np.hypot(x, y) <= reach
    x, y = x[inside], y[inside]
    along = np.outer(normals[:, 0], x) + np.outer(normals[:, 1], y)
    places = np.rint((along - steps[0]) / STEP_PX).astype(int)
    votes = np.minimum(np.take_along_axis(strength, places, axis=1), STRONG).mean(axis=0)
    votes *= np.exp(-(x**2 + y**2) / (3 * reach**2))  # of a pattern that repeats, the nearest edge is meant
    best = int(votes.argmax())
    return float(x[best]), float(y[best])
