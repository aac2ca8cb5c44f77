"""The symmetries that a model may have, and those that it is suggested to have (thesis sec. symmetries)."""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.geometry import inverse
from pipeline.scene import Model
from pipeline.symmetry_search.candidates import SAMPLING, any_rotation, candidates_of, completed, known, listed
from pipeline.symmetry_search.closure import NoGroupError, group_of
from pipeline.symmetry_search.fitting import CONTINUOUS, Fit, Line, angles_of, best_fitting, measured
from pipeline.symmetry_search.groups import (
    NO_SYMMETRY,
    SAME_TURN,
    Axis,
    Candidate,
    SymmetryGroup,
    axis_of,
    pointing_up,
    turns_apart,
)
from pipeline.symmetry_search.screening import seeds
from pipeline.symmetry_search.surface import Surface

CANDIDATE_METRES, CANDIDATE_SHARE = 0.015, 0.1
"""The thesis's bound for candidates: the larger of this length and this share of the diameter."""
EPSILON_SHARE, EPSILON_EXACT, EPSILON_NOISE = 0.0375, 0.01, 4.0
"""What is suggested where no epsilon is given: candidates up to the first share of the diameter, and up to the larger
of the second share and so many times the distance of the best candidate.

Scans have dents and noise: LM-O's egg box and glue, which are symmetric, need 3.5 % and 3.2 %, a banana reaches 4.1 %.
Where one symmetry fits exactly the model has no noise, and 1 % allows for the facets of round parts only: a prism
with 16 sides counts as a cylinder, one with 11 does not, nor is a square box with a lid the same upside down (4 %).
"""
EXACT = 2 * SAMPLING
"""Share of the size: nothing fits noticeably better than a sphere that fits so well."""
TIDY_COST = 2e-4
"""Share of the size by which plain numbers may make the distance larger."""
TIDY_ANGLE, TIDY_SHARE = np.radians(0.3), 0.003
"""Axes this near to a plain direction, and to the origin (share of the size), are tried there."""


@dataclass(frozen=True, eq=False)
class SymmetrySearch:
    """What was found for one model."""

    candidates: tuple[Candidate, ...]
    """All below the bound, the best first."""
    suggested: tuple[int, ...]
    """Positions of the candidates that generate the suggested set."""
    group: SymmetryGroup
    """The suggested set: closed, and all its turns are within epsilon."""
    epsilon: float
    """Metres; up to this distance candidates are suggested."""
    bound: float
    """Metres; up to this distance there are candidates."""
    surface: Surface
    seconds: float

    def distance(self, turn: Float[np.ndarray, "4 4"]) -> float:
        """Hausdorff distance in metres of the model to itself moved by a transform of the model frame."""
        return _distance(self.surface, turn)


def candidate_bound(diameter: float) -> float:
    """The thesis's epsilon for candidates: max(15 mm, 0.1 d), metres."""
    return max(CANDIDATE_METRES, CANDIDATE_SHARE * diameter)


def default_epsilon(diameter: float, distances: Sequence[float]) -> float:
    """Up to which distance candidates with the given distances are suggested (metres)."""
    if not distances:
        return EPSILON_SHARE * diameter
    return min(EPSILON_SHARE * diameter, max(EPSILON_EXACT * diameter, EPSILON_NOISE * min(distances)))


def find_symmetries(
    model: Model,
    epsilon: float | None = None,
    bound: float | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> SymmetrySearch:
    """Find the candidates S'_M of global symmetries of a model, and the closed set that is suggested as S_M.

    The distance is the Hausdorff distance h between the surfaces of the model and of its turned self, both ways:
    turned samples (all vertices and points between, no farther apart than 1.25 % of the size) are measured to the
    faces. It is at most 0.8 % of the size below that of the surfaces, which as a rule is attained at vertices.
    The thesis takes vertices to vertices. That is never smaller, and larger by up to the distance between vertices:
    of a cylinder with its vertices on two rims it would leave the turns by multiples of its facets only.

    S'_M is a continuum: near every symmetry all small motions are within epsilon as well. It is represented by one
    candidate per basin of the distance, with the smallest distance there. A rotation with a shift along its axis,
    or by an angle that no number of repetitions closes, is never a symmetry of an object of finite size; so a
    candidate is an axis (anywhere in space: SE(3)) with a fold, or continuous, and its distance is the largest of
    all its turns.

    Args:
        model: Metres; its faces may be few or many, and need not be closed.
        epsilon: Metres; up to this distance candidates are suggested. Default: see EPSILON_SHARE.
        bound: Metres; candidates lie below. Default: max(15 mm, 0.1 diameters).
        progress: Called with the done share 0..1.

    Raises:
        FormatError: The model's faces have no area.

    """
    begun = time.perf_counter()
    bound = max(candidate_bound(model.diameter) if bound is None else bound, epsilon or 0.0)
    surface = Surface.of(model)
    level = SAMPLING * surface.size
    progress(0.1)
    sphere = any_rotation(surface, bound)
    candidates = [] if sphere is None else [_sphere(surface, sphere)]
    if sphere is None or sphere > EXACT * surface.size:
        limit = bound if sphere is None else 0.5 * sphere - level
        found = [_candidate(surface, fit, bound) for fit in _fits(surface, limit, progress)]
        candidates = sorted([*candidates, *_distinct(found, surface)], key=lambda c: max(c.distance, level))  # stable
    progress(0.95)
    epsilon = default_epsilon(model.diameter, [c.distance for c in candidates]) if epsilon is None else epsilon
    suggested, group = _suggested(surface, candidates, epsilon)
    seconds = time.perf_counter() - begun
    return SymmetrySearch(tuple(candidates), suggested, group, epsilon, bound, surface, seconds)


def _fits(surface: Surface, bound: float, progress: Callable[[float], None]) -> list[Fit]:
    """All axes that are listed, where their distance is smallest."""
    rough = seeds(surface)
    progress(0.4)
    found = candidates_of(surface, rough, bound)
    progress(0.7)
    found = completed(surface, found, bound, EPSILON_SHARE * surface.size)
    found = [tidied(surface, fit) for fit in found]
    return listed(surface, [*found, *_missed(surface, found)], bound)


def _missed(surface: Surface, found: list[Fit]) -> list[Fit]:
    """Axes of more than two turns that are in the closed set of the exact ones, but have not been found themselves."""
    level = SAMPLING * surface.size
    exact = [_candidate(surface, fit, level) for fit in found if fit.fold and fit.distance < level]
    folds: dict[tuple[float, ...], int] = {}
    axes: dict[tuple[float, ...], Axis] = {}
    for turn in _suggested(surface, exact, level)[1].discrete:
        axis = axis_of(turn)
        key = tuple(np.round(axis.direction, 3).tolist())
        folds[key], axes[key] = folds.get(key, 1) + 1, axis
    fits = [Fit(_line(surface, axes[key]), 0.0, fold) for key, fold in folds.items() if fold > 2]
    return [measured(surface, fit) for fit in fits if not known(fit, found, surface)]


def tidied(surface: Surface, fit: Fit) -> Fit:
    """The fit with plain numbers (an axis along x, y, z or between, through the origin) if it is as good with them."""
    origin = -surface.center
    direction = _plain_direction(fit.line.direction)
    through = fit.line.through - origin
    through = through - direction * (direction @ through)
    through = np.where(np.abs(through) < TIDY_SHARE * surface.size, 0.0, through) + origin
    plain = Line(direction, through - direction * (direction @ through))
    if all(np.allclose(a, b, atol=1e-12) for a, b in zip(plain, fit.line, strict=True)):
        return fit
    tried = measured(surface, Fit(plain, fit.distance, fit.fold))
    return tried if tried.distance < fit.distance + TIDY_COST * surface.size else fit


def _plain_direction(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    steps = (-1.0, 0.0, 1.0)
    plain = np.array([(x, y, z) for x in steps for y in steps for z in steps if x or y or z])
    plain /= np.linalg.norm(plain, axis=1, keepdims=True)
    best = plain[(plain @ direction).argmax()]
    return best if np.linalg.norm(np.cross(best, direction)) < np.sin(TIDY_ANGLE) else direction


def _candidate(surface: Surface, fit: Fit, bound: float) -> Candidate:
    """A fit in the model frame, about the axis that suits the whole surface best."""
    shown = fit if fit.distance < SAMPLING * surface.size else best_fitting(surface, fit, bound)
    direction = shown.line.direction
    direction = pointing_up(direction)
    through = shown.line.through + surface.center
    through = through - direction * (direction @ through)
    axis = Axis(direction, np.where(np.abs(through) < 1e-12, 0.0, through))
    means = [surface.distances(shown.line.turned(surface.middle, float(a))).mean() for a in angles_of(fit.fold)]
    kind = "continuous" if fit.fold == CONTINUOUS else "discrete"
    least = min(fit.distance, shown.distance)
    return Candidate(kind, fit.fold, axis, least, shown.distance, float(np.mean(means)))


def _distinct(candidates: list[Candidate], surface: Surface) -> list[Candidate]:
    """The candidates without those whose best fitting axis is that of a better one."""
    kept: list[Candidate] = []
    for candidate in candidates:
        turn = candidate.turns()[0]
        same = [other for other in kept if other.fold == candidate.fold]
        if not any(
            turns_apart(turn, t, surface.extent) < SAME_TURN for c in same for t in (c.turns()[0], c.turns()[-1])
        ):
            kept.append(candidate)
    return kept


def _sphere(surface: Surface, distance: float) -> Candidate:
    center = np.where(np.abs(surface.center) < 1e-5 * surface.size, 0.0, surface.center)
    return Candidate("sphere", 0, Axis(np.array([0.0, 0.0, 1.0]), center), distance, distance, distance / 2)


def _suggested(
    surface: Surface, candidates: Sequence[Candidate], epsilon: float
) -> tuple[tuple[int, ...], SymmetryGroup]:
    """Candidates within epsilon, the best first, as long as all turns of the closed set are within epsilon too."""
    chosen: list[int] = []
    group = NO_SYMMETRY
    good = [candidate for candidate in candidates if candidate.distance <= epsilon]
    for index, candidate in enumerate(candidates):
        if candidate.distance > epsilon or contains(group, candidate, surface):
            continue
        try:
            larger = group_of([*(candidates[i] for i in chosen), candidate], surface.extent)
        except NoGroupError:
            continue
        limit = max(epsilon, 1.2 * max(c.distance_at_axis for c in good))
        if all(_distance(surface, turn) <= limit for turn in _unknown(larger, good, surface)):
            chosen.append(index)
            group = larger
    return tuple(chosen), group


def contains(group: SymmetryGroup, candidate: Candidate, surface: Surface) -> bool:
    """Whether all turns of a candidate are in a set."""
    if candidate.kind == "sphere":
        return len(group.continuous) == 3
    return all(group.contains(turn, surface.extent) for turn in candidate.turns(7))


def _unknown(group: SymmetryGroup, candidates: Sequence[Candidate], surface: Surface) -> list[np.ndarray]:
    """The turns of a set that belong to no candidate, even nearly."""
    turns = [turn for candidate in candidates if candidate.fold for turn in candidate.turns()]
    return [t for t in group.discrete if not any(turns_apart(t, k, surface.extent) < SAME_TURN for k in turns)]


def _line(surface: Surface, axis: Axis) -> Line:
    through = axis.through - surface.center
    return Line(axis.direction, through - axis.direction * (axis.direction @ through))


def _distance(surface: Surface, turn: Float[np.ndarray, "4 4"]) -> float:
    moved = (surface.samples + surface.center, np.stack([turn, inverse(turn)]))
    images = (moved[0] @ T[:3, :3].T + T[:3, 3] - surface.center for T in moved[1])
    return surface.largest_distance(images)
