"""Convex hulls of points: corners, few corners, volume, moments, samples of the surface."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

THINNEST = 0.0004
"""Metres: what is thinner is thickened to this, as the simulation collides bodies, not sheets."""
CHIPPED = 0.0001
"""Metres that a hull with few corners may fall short of the full one."""


def corners_of(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "_ 3"]:
    """Corners of the convex hull of points, thickened where it is a sheet or less."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        corners = points[ConvexHull(points).vertices]
    except (QhullError, ValueError):
        corners = np.unique(points, axis=0)
    return corners if _is_thick(corners) else _thickened(corners)


def _is_thick(points: Float[np.ndarray, "n 3"]) -> bool:
    """Whether the points reach further than `THINNEST` across their flattest direction."""
    if len(points) < 4:
        return False
    axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[2]
    return bool(np.ptp(points @ axes[-1]) >= THINNEST)


def _thickened(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "_ 3"]:
    """Corners of the points with a small cube about each: a body even where they are one plane, line or point."""
    from scipy.spatial import ConvexHull

    cube = THINNEST / 2.0 * (2.0 * np.array(list(np.ndindex(2, 2, 2))) - 1.0)
    grown = (points[:, None] + cube).reshape(-1, 3)
    return grown[ConvexHull(grown).vertices]


def few_corners(corners: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "_ 3"]:
    """Some of the corners, such that no other lies further than `CHIPPED` outside their hull."""
    from scipy.spatial import ConvexHull, QhullError

    kept = np.zeros(len(corners), bool)
    kept[(corners @ _directions(32).T).argmax(axis=0)] = True
    while not kept.all():
        try:
            equations = ConvexHull(corners[kept]).equations
        except QhullError:  # too few corners yet, or all but flat
            return corners
        outside = corners @ equations[:, :3].T + equations[:, 3]
        beyond = outside.max(axis=0)
        if beyond.max() <= CHIPPED:
            break
        kept[outside.argmax(axis=0)[beyond > max(CHIPPED, beyond.max() / 2)]] = True
    return corners[kept]


def _directions(count: int) -> Float[np.ndarray, "n 3"]:
    """Directions spread evenly over the sphere, in a spiral."""
    z = (2 * np.arange(count) + 1) / count - 1
    angle = np.pi * (1 + 5**0.5) * np.arange(count)
    radius = np.sqrt(1 - z**2)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def volume_of(points: Float[np.ndarray, "n 3"]) -> float:
    """Volume of the convex hull of points."""
    from scipy.spatial import ConvexHull

    return float(ConvexHull(points).volume)


def samples_of(corners: Float[np.ndarray, "n 3"], count: int = 300) -> tuple[Float[np.ndarray, "m 3"], float]:
    """Points spread over the surface of the convex hull, the same each time, and its area."""
    from scipy.spatial import ConvexHull

    hull = ConvexHull(corners)
    a, b, c = (corners[hull.simplices[:, k]] for k in range(3))
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    rng = np.random.default_rng(0)
    face = np.searchsorted(np.cumsum(areas), (np.arange(count) + 0.5) / count * areas.sum())
    s, t = rng.random((2, count, 1))
    s, t = np.where(s + t > 1, 1 - s, s), np.where(s + t > 1, 1 - t, t)
    return a[face] + s * (b - a)[face] + t * (c - a)[face], float(hull.area)


def moments(
    hulls: Sequence[Float[np.ndarray, "_ 3"]],
) -> tuple[float, Float[np.ndarray, " 3"], Float[np.ndarray, "3 3"]]:
    """Volume, centre of mass and inertia about it of convex bodies together, for a density of 1."""
    import trimesh

    bodies = [trimesh.convex.convex_hull(hull) for hull in hulls]
    volumes = np.array([body.volume for body in bodies])
    centres = np.array([body.center_mass for body in bodies])
    centre = volumes @ centres / volumes.sum()
    inertia = np.zeros((3, 3))
    for body, volume, at in zip(bodies, volumes, centres, strict=True):
        arm = at - centre
        inertia += body.moment_inertia + volume * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return float(volumes.sum()), centre, inertia
