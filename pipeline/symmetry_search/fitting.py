"""From an axis that is about right to the one whose turns fit best (thesis sec. symmetries: smallest h)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.symmetry_search.surface import Surface

CONTINUOUS = 0
"""As a fold: turns by any angle."""
STEPS_OF_CONTINUOUS = 24
"""Angles at which a continuous symmetry is fitted."""
FINE_STEPS_OF_CONTINUOUS = 60
"""Angles at which its distance is measured."""
MOST_PAIRS = 5000
"""Turned points that a fit begins with."""
FEW = 150
"""Points that tell whether a fit can become good at all."""
MOST_CONSTRAINTS = 400
"""Farthest turned points that one step of the fit looks at."""
TOLERANCE = 1e-5
"""Share of the size; a fit ends when the next step promises less."""


class Line(NamedTuple):
    """An axis in space, in the frame of a `Surface`."""

    direction: Float[np.ndarray, "3"]
    """Unit vector."""
    through: Float[np.ndarray, "3"]
    """Its point nearest to the origin."""

    def moved(self, step: Float[np.ndarray, "4"]) -> "Line":
        """Turned by two angles (radians) and moved by two distances across itself."""
        from pipeline.symmetry_search.loops import moved

        return Line(*moved(self.direction, self.through, step))

    def turned(
        self, points: Float[np.ndarray, "n 3"], angles: Float[np.ndarray, "n"] | float
    ) -> Float[np.ndarray, "n 3"]:
        """Points turned about the axis, all by one angle or each by its own (radians)."""
        from pipeline.symmetry_search.loops import turn

        return turn(points, np.broadcast_to(angles, len(points)).astype(float), self.direction, self.through)


class Fit(NamedTuple):
    """An axis with how well its turns fit."""

    line: Line
    distance: float
    """Metres: largest distance of a turned point to the surface, over all turns."""
    fold: int


def angles_of(fold: int, steps: int = STEPS_OF_CONTINUOUS) -> Float[np.ndarray, "k"]:
    """The turns of a symmetry without the identity; each comes with its inverse, so that distances count both ways.

    Those of a continuous one lie between the turns of all small folds, where the distance is largest.
    """
    if fold == CONTINUOUS:
        return (np.arange(steps) + 0.5) * (2 * np.pi / steps)
    return np.arange(1, fold) * (2 * np.pi / fold)


def roughly_fitted(surface: Surface, fold: int, line: Line) -> Fit:
    """Fit an axis on the grid of distances: to a fraction of a cell, in about a millisecond."""
    from pipeline.symmetry_search.loops import fit_axis

    angles, largest = angles_of(fold), 0.0
    angles = angles[: (len(angles) + 1) // 2]  # the rest are their inverses
    direction, through = line
    for exponent, steps in ((2.0, 10), (8.0, 8)):
        direction, through, largest, _ = fit_axis(
            *surface.field, surface.coarse, angles, direction, through, exponent, steps
        )
    return Fit(Line(direction, through), float(largest), fold)


def sketched(surface: Surface, fit: Fit) -> Fit:
    """The axis near a given one at which the largest distance of a few points is smallest: hardly above the true one."""
    return Fit(*_minimized(surface, fit.line, *_pairs(angles_of(fit.fold), surface.coarse[:FEW])), fit.fold)


def fitted(surface: Surface, fit: Fit, rounds: int = 3) -> Fit:
    """The axis near a given one at which the distance is smallest, exactly, and that distance.

    Minimizes the largest distance of some turned points by sequential linear programming; then the farthest of all
    samples join them, until these are no farther.
    """
    angles = angles_of(fit.fold)
    points, turns = _pairs(angles, surface.middle[: max(MOST_PAIRS // len(angles), FEW)])
    line, distance = fit.line, np.inf
    for _ in range(rounds):
        line, within = _minimized(surface, line, points, turns)
        distance, far_points, far_turns = farthest(surface, line, fit.fold)
        if distance <= 1.01 * within + 10 * TOLERANCE * surface.size:
            break
        points, turns = np.concatenate([points, far_points]), np.concatenate([turns, far_turns])
    return Fit(line, distance, fit.fold)


def best_fitting(surface: Surface, fit: Fit, bound: float) -> Fit:
    """The axis near a given one about which the whole surface fits best, with the largest distance there.

    Where a model has a dent, the axis with the smallest largest distance tilts everything else for its sake: that of
    LM-O's egg box by 4 degrees. So the least squares count, as long as no distance comes above the bound (metres);
    else powers that respect the farthest points more, at last the given axis.
    """
    from pipeline.symmetry_search.loops import fit_axis

    angles = angles_of(fit.fold)
    scale = _scale(surface)
    for exponent in (2.0, 4.0, 8.0):
        direction, through, *_ = fit_axis(*surface.field, surface.middle, angles, *fit.line, exponent, 30)
        line = Line(direction, through)
        if exponent == 2.0:
            points = surface.middle[: max(4 * MOST_PAIRS // len(angles), FEW)]
            line = _least_squares(surface, line, *_pairs(angles, points), scale)
        found = measured(surface, Fit(line, fit.distance, fit.fold))
        if found.distance < bound:
            return found
    return fit


def measured(surface: Surface, fit: Fit) -> Fit:
    """The fit with the Hausdorff distance at its axis as it is: the largest over all turns."""
    return Fit(fit.line, farthest(surface, fit.line, fit.fold)[0], fit.fold)


def farthest(surface: Surface, line: Line, fold: int) -> tuple[float, Float[np.ndarray, "n 3"], Float[np.ndarray, "n"]]:
    """The largest distance of a turned sample to the surface, and samples and angles that come close to it."""
    from pipeline.symmetry_search.loops import bounds

    samples = _orbits(surface, line) if fold == CONTINUOUS else surface.samples
    cell = 1 / surface.field[2]
    largest, points, turns = 0.0, [], []
    for angle in angles_of(fold, FINE_STEPS_OF_CONTINUOUS):
        images = line.turned(samples, float(angle))
        about = bounds(*surface.field, images)
        near = np.flatnonzero(about > max(largest, about.max() - cell) - cell)
        distances = surface.distances(images[near])
        largest = max(largest, float(distances.max(initial=0.0)))
        order = np.argsort(-distances)[:50]
        points.append(samples[near[order]])
        turns.append(np.full(len(order), angle))
    return largest, np.concatenate(points), np.concatenate(turns)


def _orbits(surface: Surface, line: Line) -> Float[np.ndarray, "n 3"]:
    """One sample of all that move on about the same circle about an axis."""
    arms = surface.samples - line.through
    along = arms @ line.direction
    away = np.linalg.norm(np.cross(line.direction, arms), axis=1)
    cells = np.floor(np.stack([along, away], axis=1) / (0.006 * surface.size)).astype(np.int64)
    sectors = np.arctan2(*(arms @ np.stack(_across(line.direction)).T).T) // (np.pi / 4)
    _, first = np.unique(np.column_stack([cells, sectors.astype(np.int64)]), axis=0, return_index=True)
    return surface.samples[first]


def _across(direction: Float[np.ndarray, "3"]) -> tuple[np.ndarray, np.ndarray]:
    from pipeline.symmetry_search.loops import tangents

    return tangents(direction)


def _pairs(
    angles: Float[np.ndarray, "k"], points: Float[np.ndarray, "m 3"]
) -> tuple[Float[np.ndarray, "n 3"], Float[np.ndarray, "n"]]:
    """Every point with every angle to turn it by."""
    return np.tile(points, (len(angles), 1)), np.repeat(angles, len(points))


def _minimized(
    surface: Surface, line: Line, points: Float[np.ndarray, "n 3"], turns: Float[np.ndarray, "n"]
) -> tuple[Line, float]:
    """Minimize the largest distance of turned points within a trust region that adapts."""
    scale = _scale(surface)
    some = slice(None, None, 1 + len(points) // 2000)
    line = _least_squares(surface, line, points[some], turns[some], scale)
    reach = 0.05
    distances, gradients = _linearized(surface, line, points, turns, scale)
    for _ in range(25):
        largest = np.abs(distances).max()
        kept = _farthest_few(np.abs(distances), largest - 4 * reach * surface.size)
        step, promised = _chebyshev_step(distances[kept], gradients[kept], reach)
        if largest - promised < TOLERANCE * surface.size:
            break
        moved = line.moved(step * scale)
        trial = _linearized(surface, moved, points, turns, scale)
        gained = largest - np.abs(trial[0]).max()
        if gained > 0:
            line, (distances, gradients) = moved, trial
        reach *= 1.5 if gained > 0.6 * (largest - promised) else 0.35
        if reach < TOLERANCE:
            break
    return line, float(np.abs(distances).max())


def _scale(surface: Surface) -> Float[np.ndarray, "4"]:
    """Radians and metres that count alike."""
    return np.array([1.0, 1.0, 0.25 * surface.size, 0.25 * surface.size])


def _least_squares(surface: Surface, line: Line, points: np.ndarray, turns: np.ndarray, scale: np.ndarray) -> Line:
    """Gauss-Newton steps as long as they help: an exact symmetry is met exactly."""
    distances, gradients = _linearized(surface, line, points, turns, scale)
    for _ in range(8):
        normal = gradients.T @ gradients
        step = -np.linalg.solve(normal + (1e-6 * np.trace(normal) + 1e-12) * np.eye(4), gradients.T @ distances)
        moved = line.moved(np.clip(step, -0.1, 0.1) * scale)
        trial = _linearized(surface, moved, points, turns, scale)
        if not (trial[0] ** 2).sum() < 0.999 * (distances**2).sum():
            break
        line, (distances, gradients) = moved, trial
    return line


def _linearized(
    surface: Surface, line: Line, points: np.ndarray, turns: np.ndarray, scale: np.ndarray
) -> tuple[Float[np.ndarray, "n"], Float[np.ndarray, "n 4"]]:
    """Distances of turned points to the surface, and their derivatives by the (scaled) steps of the axis."""
    from pipeline.symmetry_search.loops import slopes

    images = line.turned(points, turns)
    nearest, normals = surface.nearest(images)
    away = images - nearest
    lengths = np.linalg.norm(away, axis=1, keepdims=True)
    outward = np.where(lengths > 1e-6 * surface.size, away / np.maximum(lengths, 1e-30), normals)
    return (away * outward).sum(axis=1), slopes(points, turns, *line, outward) * scale


def _farthest_few(distances: Float[np.ndarray, "n"], at_least: float) -> Bool[np.ndarray, "n"]:
    """The points that can become the farthest within a step, at most as many as one step looks at."""
    if len(distances) > MOST_CONSTRAINTS:
        at_least = max(at_least, float(np.partition(distances, -MOST_CONSTRAINTS)[-MOST_CONSTRAINTS]))
    return distances >= at_least


def _chebyshev_step(
    distances: Float[np.ndarray, "n"], slopes: Float[np.ndarray, "n 4"], reach: float
) -> tuple[Float[np.ndarray, "4"], float]:
    """The step within reach that makes the largest absolute linearized distance smallest, and that distance."""
    from scipy.optimize import linprog

    ones = np.ones((len(distances), 1))
    A = np.vstack([np.hstack([slopes, -ones]), np.hstack([-slopes, -ones])])
    b = np.concatenate([-distances, distances])
    found = linprog([0, 0, 0, 0, 1], A_ub=A, b_ub=b, bounds=[(-reach, reach)] * 4 + [(0, None)], method="highs")
    if found.x is None:
        return np.zeros(4), float(np.abs(distances).max())
    return found.x[:4], float(found.x[4])
