"""Candidates of symmetries: one per basin of the distance, without those that another one makes superfluous."""

from collections.abc import Iterable, Iterator

import numpy as np

from pipeline.symmetry_search.fitting import (
    CONTINUOUS,
    TOLERANCE,
    Fit,
    Line,
    angles_of,
    fitted,
    measured,
    roughly_fitted,
    sketched,
)
from pipeline.symmetry_search.surface import Surface

ROUGH = 0.03
"""Share of the size by which a rough distance may be too large."""
BASIN = 0.06
"""Share of the size: axes of the same fold whose turns carry no point farther apart than this are one candidate."""
SAMPLING = 0.002
"""Share of the size; smaller differences between distances do not count."""
HIGHEST_FOLD = 72
"""Of the folds that are looked for about axes of rough continuous symmetries."""
MOST_CONTINUOUS, MOST_FITS = 4, 20
"""Axes that are fitted exactly, of continuous symmetries and of others; axes that others carry them to come on top."""
MANY = 8
"""Folds above this carry axes round as a continuous symmetry does: of a gear's flips one is listed."""


def candidates_of(surface: Surface, rough: Iterable[Fit], bound: float) -> list[Fit]:
    """The exactly fitted candidates with a distance below a bound (metres), the best first.

    There is one per basin of the distance. A symmetry is left out where a larger one (about the same axis a multiple
    of its fold, or any angle) contains it, and likewise one whose axis a continuous symmetry carries to that of
    another of the same fold, unless it fits at least twice as well as that larger or continuous one.
    """
    near = [fit for fit in rough if fit.distance < bound + ROUGH * surface.size]
    found: list[Fit] = []
    _fit_all(surface, [fit for fit in near if fit.fold == CONTINUOUS], bound, found, MOST_CONTINUOUS)
    _fit_all(surface, _high_folds(surface, found), bound, found, MOST_CONTINUOUS)
    _fit_all(surface, [fit for fit in near if fit.fold != CONTINUOUS], bound, found, MOST_FITS)
    return listed(surface, found, bound)


def _fit_all(surface: Surface, rough: list[Fit], bound: float, found: list[Fit], most: int) -> None:
    """Add exact fits to those found, unless they are among them, superfluous or above the bound."""
    tried: list[Fit] = []
    for fit in rough:
        if len(tried) >= 4 * most or most <= 0:
            return
        if known(fit, tried, surface) or _superfluous(fit, found, surface, 0.65):
            continue
        sketch = sketched(surface, fit)
        if not known(sketch, tried, surface) and sketch.distance < bound:
            found.append(fitted(surface, sketch))
            tried.append(found[-1])
            most -= 1
        tried += [fit, sketch]


def completed(surface: Surface, found: list[Fit], bound: float, good: float) -> list[Fit]:
    """The candidates and those that follow from two good ones: the axis of one turned about that of the other.

    Also where a candidate is turned into another one of the same kind, the better axis of the two counts.
    """
    discrete = [fit for fit in found if fit.distance <= good and 0 < fit.fold <= MANY]
    fits = list(found)
    for first in discrete:
        for second in found:
            if second is not first:
                for fit in _carried(first, second):
                    _improve(surface, fit, fits, any(second is other for other in discrete))
    return listed(surface, fits, bound)


def _improve(surface: Surface, fit: Fit, fits: list[Fit], new_too: bool) -> None:
    """Put a carried fit in the place of a worse one of the same basin, or, if it is new and wanted, add it."""
    same = [i for i, other in enumerate(fits) if known(fit, [other], surface)]
    for i in same:
        if fit.distance < 0.98 * fits[i].distance - TOLERANCE * surface.size:
            fits[i] = min(fits[i], measured(surface, fit), key=lambda fit: fit.distance)
    if not same and new_too and len(fits) < 3 * MOST_FITS:
        here = measured(surface, fit)
        exact = here.distance < 1.02 * fit.distance + SAMPLING * surface.size
        fits.append(here if exact else fitted(surface, fit))


def listed(surface: Surface, found: list[Fit], bound: float) -> list[Fit]:
    """The best fit of every basin that is below the bound and not superfluous, in order of distance."""
    chosen: list[Fit] = []
    for fit in sorted(found, key=lambda fit: fit.distance):
        if fit.distance < bound and not known(fit, chosen, surface):
            chosen.append(fit)
    kept: list[Fit] = []
    for fit in chosen:
        better = [other for other in chosen if other.fold == CONTINUOUS or other.fold != fit.fold] + kept
        if not _superfluous(fit, better, surface):
            kept.append(fit)
    level = SAMPLING * surface.size  # among those that fit equally well, higher folds come first
    return sorted(kept, key=lambda fit: (max(fit.distance, level), fit.fold != CONTINUOUS, -fit.fold))


def any_rotation(surface: Surface, bound: float) -> float | None:
    """The distance of a sphere-like model to itself under all rotations about its centre, None if above the bound."""
    from scipy.spatial.transform import Rotation

    from pipeline.symmetry_search.loops import screen

    rotations = Rotation.from_quat(np.random.default_rng(0).normal(size=(300, 4))).as_matrix()
    about = screen(*surface.field, surface.coarse, rotations)[:, 0]
    if about.max() > bound + ROUGH * surface.size:
        return None
    worst = rotations[np.argsort(-about)[:30]]
    distance = surface.largest_distance(surface.samples @ R.T for R in worst)
    return distance if distance < bound else None


def _high_folds(surface: Surface, turning: list[Fit]) -> list[Fit]:
    """High folds about the axes of continuous symmetries that fit much better than those, as of gears."""
    from scipy.spatial.transform import Rotation

    from pipeline.symmetry_search.loops import screen

    field, low, per_metre = surface.field
    found: list[Fit] = []
    for fit in turning:
        points = surface.coarse - fit.line.through
        distances = {}
        for fold in (CONTINUOUS, *range(9, HIGHEST_FOLD + 1)):
            turns = Rotation.from_rotvec(np.outer(angles_of(fold), fit.line.direction)).as_matrix()
            distances[fold] = float(screen(field, low - fit.line.through, per_metre, points, turns)[:, 0].max())
        best = min(distances, key=lambda fold: distances[fold])
        if distances[best] < 0.6 * distances[CONTINUOUS]:
            found.append(roughly_fitted(surface, best, fit.line))
    return found


def known(fit: Fit, others: Iterable[Fit], surface: Surface) -> bool:
    """Whether a fit lies in the basin of another one."""
    return any(fit.fold == other.fold and _apart(fit.line, other.line, surface) < BASIN for other in others)


def _superfluous(fit: Fit, others: list[Fit], surface: Surface, share: float = 0.5) -> bool:
    """Whether larger symmetries among others imply this one, whose distance is not below a share of theirs."""
    larger = [other for other in others if fit.distance >= share * other.distance - SAMPLING * surface.size]
    for other in larger:
        multiple = fit.fold != CONTINUOUS and other.fold > fit.fold and other.fold % fit.fold == 0
        of_any_angle = other.fold == CONTINUOUS and fit.fold != CONTINUOUS
        carrying = fit.fold not in (CONTINUOUS, other.fold) and (other.fold == CONTINUOUS or other.fold > MANY)
        if (multiple or of_any_angle) and _apart(fit.line, other.line, surface) < BASIN:
            return True
        same = [third for third in others if carrying and third.fold == fit.fold]
        if any(_carries(other.line, third.line, fit.line, surface) for third in same):
            return True
    return False


def _carries(about: Line, line: Line, other: Line, surface: Surface) -> bool:
    """Whether turning about an axis carries a line to another one."""
    tilts = [abs(float(some.direction @ about.direction)) for some in (line, other)]
    if abs(np.arcsin(min(tilts[0], 1)) - np.arcsin(min(tilts[1], 1))) > BASIN:
        return False
    angles = np.arange(0, 2 * np.pi, 0.02)
    ends = np.stack([line.through, line.through + line.direction])
    starts, tips = (about.turned(np.tile(end, (len(angles), 1)), angles) for end in ends)
    return any(
        _apart(Line(tip - start, start), other, surface) < BASIN for start, tip in zip(starts, tips, strict=True)
    )


def _carried(first: Fit, second: Fit) -> Iterator[Fit]:
    """The second symmetry with its axis turned by the first."""
    ends = np.stack([second.line.through, second.line.through + second.line.direction])
    for angle in angles_of(first.fold):
        start, tip = first.line.turned(ends, float(angle))
        direction = tip - start
        yield Fit(Line(direction, start - direction * (direction @ start)), second.distance, second.fold)


def _apart(line: Line, other: Line, surface: Surface) -> float:
    """About how far turns by the same angle about two axes carry a point apart at most, as a share of the size."""
    sine = float(np.linalg.norm(np.cross(line.direction, other.direction)))
    nearest = [some.through - some.direction * (some.direction @ some.through) for some in (line, other)]
    return sine + 2 * float(np.linalg.norm(nearest[0] - nearest[1])) / surface.size
