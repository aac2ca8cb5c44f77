"""The closed set of turns that accepted symmetries generate, made exact (thesis sec. symmetries, S_M)."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from pipeline.exceptions import InputError
from pipeline.geometry import transform, transform_points
from pipeline.symmetry_search.groups import NO_SYMMETRY, Axis, Candidate, Extent, SymmetryGroup

SAME_ANGLE = np.radians(12)
"""Turns that differ by less are the same; less than that for high folds."""
SAME_PLACE = 0.2
"""Share of the radius: axes that miss each other by more do not belong to one object."""


class NoGroupError(InputError):
    """Turns that cannot all be symmetries of one object."""


def group_of(candidates: Sequence[Candidate], extent: Extent) -> SymmetryGroup:
    """The smallest closed set with all turns of the given candidates.

    Axes that fit a model best only nearly meet, at nearly the right angles; turns that are nearly the same are
    taken for the same, and all are moved as little as possible such that the set is closed exactly.
    Raises NoGroupError if their products never come back, or if there is no common centre.
    """
    spheres = [candidate for candidate in candidates if candidate.kind == "sphere"]
    if spheres:
        return SymmetryGroup(np.empty((0, 4, 4)), spheres[0].axes)
    discrete = [candidate for candidate in candidates if candidate.kind == "discrete"]
    axes = [candidate.axis for candidate in candidates if candidate.kind == "continuous"]
    if axes:
        return _about_axis(_one_axis(axes, extent), discrete, extent)
    if not discrete:
        return NO_SYMMETRY
    return SymmetryGroup(_closed(discrete, extent)[1:])


def _one_axis(axes: Sequence[Axis], extent: Extent) -> Axis:
    first = axes[0]
    for other in axes[1:]:
        if np.linalg.norm(np.cross(first.direction, other.direction)) > SAME_ANGLE or _missed(first, other, extent):
            raise NoGroupError("with two continuous axes every rotation would be a symmetry; refuse one of them")
    return first


def _about_axis(axis: Axis, discrete: Sequence[Candidate], extent: Extent) -> SymmetryGroup:
    """A continuous axis with a flip, if one of the discrete symmetries turns the axis over."""
    flips = []
    for candidate in discrete:
        along = abs(float(candidate.axis.direction @ axis.direction))
        if _missed(axis, candidate.axis, extent):
            raise NoGroupError(f"the {candidate} axis misses the continuous one; refuse one of them")
        if along > np.cos(SAME_ANGLE):
            continue  # one of the turns about the axis
        if along > np.sin(SAME_ANGLE) or candidate.fold != 2:
            raise NoGroupError(
                f"with the continuous axis and a {candidate} axis across it every rotation would be a symmetry; "
                "refuse one of them"
            )
        flips.append(candidate.axis)
    if not flips:
        return SymmetryGroup(np.empty((0, 4, 4)), (axis,))
    flip = flips[0]
    across = flip.direction - axis.direction * (axis.direction @ flip.direction)
    exact = Axis(across / np.linalg.norm(across), _nearest_point(axis, flip))
    return SymmetryGroup(exact.turn(np.pi)[None], (axis,))


def _closed(discrete: Sequence[Candidate], extent: Extent) -> Float[np.ndarray, "g 4 4"]:
    """All products, the identity first."""
    highest = max(candidate.fold for candidate in discrete)
    tolerance = min(SAME_ANGLE, 0.4 * 2 * np.pi / highest)
    endless = NoGroupError(f"the turns of {', '.join(map(str, discrete))} do not close; refuse one of them")
    generators = [candidate.axis.turn(2 * np.pi / candidate.fold) for candidate in discrete]
    elements = [np.eye(4)]
    for element in elements:  # grows while it is gone through
        for generator in generators:
            product = generator @ element
            if _index(product, elements, tolerance, extent) is None:
                elements.append(product)
            if len(elements) > max(120, 4 * highest):
                raise endless
    products = [[_index(a @ b, elements, 2 * tolerance, extent) for b in elements] for a in elements]
    if any(index is None for row in products for index in row):
        raise endless
    return _exact(np.stack(elements), np.array(products), extent)


def _exact(
    elements: Float[np.ndarray, "g 4 4"], table: Int[np.ndarray, "g g"], extent: Extent
) -> Float[np.ndarray, "g 4 4"]:
    """The exact group next to an approximate one with a table of products, about the best common centre.

    Averaging phi(g h) phi(h)^-1 over h makes phi a homomorphism; each round squares the error (Grove, Karcher, Ruh 1974).
    """
    rotations = elements[:, :3, :3]
    for _ in range(6):
        means = np.einsum("ghij,hkj->gik", rotations[table], rotations) / len(rotations)
        u, _, v = np.linalg.svd(means)
        rotations = u @ v
    left = np.concatenate([np.eye(3) - R for R in rotations])
    about = [t - (np.eye(3) - R) @ extent.center for R, t in zip(rotations, elements[:, :3, 3], strict=True)]
    fixed = extent.center + np.linalg.lstsq(left, np.concatenate(about), rcond=1e-6)[0]
    return np.stack([transform(R, fixed - R @ fixed) for R in rotations])


def _index(turn: np.ndarray, elements: list[np.ndarray], tolerance: float, extent: Extent) -> int | None:
    """Which element a turn is, None if it is a new one. Raises NoGroupError if it differs by a shift only."""
    stack = np.stack(elements)
    cosines = (np.einsum("nij,ij->n", stack[:, :3, :3], turn[:3, :3]) - 1) / 2
    best = int(cosines.argmax())
    if cosines[best] < np.cos(tolerance):
        return None
    shift = transform_points(turn, extent.center) - transform_points(stack[best], extent.center)
    if np.linalg.norm(shift) > 2 * SAME_PLACE * extent.radius:
        raise NoGroupError("the axes miss each other by too much to belong to one object; refuse one of them")
    return best


def _missed(axis: Axis, other: Axis, extent: Extent) -> bool:
    """Whether an axis passes another one too far away."""
    arm = _nearest_point(other, axis) - axis.through
    return bool(np.linalg.norm(arm - axis.direction * (arm @ axis.direction)) > SAME_PLACE * extent.radius)


def _nearest_point(axis: Axis, other: Axis) -> Float[np.ndarray, "3"]:
    """The point of an axis that is nearest to another axis."""
    across = np.cross(axis.direction, other.direction)
    if np.linalg.norm(across) < 1e-9:
        return axis.through
    normal = np.cross(across, other.direction)
    along = ((other.through - axis.through) @ normal) / (axis.direction @ normal)
    return axis.through + along * axis.direction
