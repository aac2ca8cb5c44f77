"""What a symmetry is: an axis with turns, and sets of turns that are closed."""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.geometry import inverse, transform, transform_points

Kind = Literal["discrete", "continuous", "sphere"]

STEPS = 72
"""Turns that stand for a continuous symmetry where it is compared."""
SOME_FOLDS = (12, 10, 8, 6, 5, 4, 3, 2)
"""Folds that are offered as parts of a continuous symmetry."""
SAME_TURN = 0.1
"""Share of the radius: turns that carry no point farther apart than this are the same one."""


class Extent(NamedTuple):
    """Where an object is in its model frame."""

    center: Float[np.ndarray, "3"]
    """Metres."""
    radius: float
    """Metres; about half the diameter."""


class Axis(NamedTuple):
    """An axis in the model frame."""

    direction: Float[np.ndarray, "3"]
    """Unit vector."""
    through: Float[np.ndarray, "3"]
    """Metres; its point nearest to the model's origin, for a sphere its centre."""

    def turn(self, angle: float) -> Float[np.ndarray, "4 4"]:
        """The transform that turns by an angle (radians), model frame to model frame."""
        from scipy.spatial.transform import Rotation

        rotation = Rotation.from_rotvec(angle * self.direction).as_matrix()
        return transform(rotation, self.through - rotation @ self.through)


@dataclass(frozen=True, eq=False)
class Candidate:
    """A symmetry that an object may have: an axis with all turns that belong to it, or a sphere's centre."""

    kind: Kind
    fold: int
    """Turning by 360 / fold degrees leaves the object as it is; 0 where any angle does."""
    axis: Axis
    """About which the whole surface fits best (least squares), such that the distance stays below the bound."""
    distance: float
    """Metres: the smallest Hausdorff distance of the object to its turned self about any axis nearby, of each axis
    the largest over all turns. Where it is below the thesis's epsilon, there are turns of S'_M."""
    distance_at_axis: float
    """Metres: the same about `axis` itself."""
    mean_distance: float
    """Metres: about `axis`, with the mean over the surface and the turns in the place of the largest."""

    def turns(self, steps: int = STEPS) -> Float[np.ndarray, "n 4 4"]:
        """All turns but the identity; of a continuous symmetry so many, of a sphere so many about each of three axes."""
        angles = 2 * np.pi * np.arange(1, self.fold or steps) / (self.fold or steps)
        return np.stack([axis.turn(angle) for axis in self.axes for angle in angles])

    @property
    def axes(self) -> tuple[Axis, ...]:
        """Its axis, or three axes of a sphere at right angles."""
        if self.kind != "sphere":
            return (self.axis,)
        return tuple(Axis(direction, self.axis.through) for direction in np.eye(3))

    @property
    def smaller_folds(self) -> tuple[int, ...]:
        """Folds of symmetries that are part of this one, as where colours leave only some turns."""
        if self.kind == "sphere":
            return ()
        if self.kind == "continuous":
            return SOME_FOLDS
        return tuple(fold for fold in range(self.fold // 2, 1, -1) if self.fold % fold == 0)

    def with_fold(self, fold: int) -> "Candidate":
        """The part of this symmetry that has a smaller fold."""
        return replace(self, kind="discrete", fold=fold)

    def __str__(self) -> str:
        return {"discrete": f"{self.fold}-fold", "continuous": "continuous", "sphere": "any rotation"}[self.kind]


@dataclass(frozen=True, eq=False)
class SymmetryGroup:
    """A set of symmetries, model frame to model frame, metres; closed if `closure.group_of` made it."""

    discrete: Float[np.ndarray, "k 4 4"]
    """Without the identity, and without products with a continuous symmetry."""
    continuous: tuple[Axis, ...] = ()
    """None, one, or the three of a sphere (BOP's format knows no sphere: three axes say it as well as can be)."""

    @property
    def name(self) -> str:
        """The point group's name (Schoenflies), with what it means."""
        if len(self.continuous) > 1:
            return "sphere: any rotation"
        if self.continuous:
            return "D∞: continuous and flip" if len(self.discrete) else "C∞: continuous"
        return _name(self.discrete[:, :3, :3])

    def contains(self, turn: Float[np.ndarray, "4 4"], extent: Extent) -> bool:
        """Whether a turn, or nearly the same one, is in the set."""
        return any(turns_apart(turn, near, extent) < SAME_TURN for near in self._nearest(turn))

    def equals(self, other: "SymmetryGroup", extent: Extent) -> bool:
        """Whether two sets hold nearly the same turns."""
        return all(other.contains(turn, extent) for turn in self.turns()) and all(
            self.contains(turn, extent) for turn in other.turns()
        )

    def turns(self, steps: int = 7) -> Float[np.ndarray, "n 4 4"]:
        """All discrete turns, and so many of each continuous one, with each discrete one too."""
        angles = 2 * np.pi * np.arange(1, steps) / steps
        about = [axis.turn(angle) for axis in self.continuous for angle in angles]
        products = [turn @ flip for turn in about for flip in self.discrete]
        return np.array([*self.discrete, *about, *products]).reshape(-1, 4, 4)

    def _nearest(self, turn: Float[np.ndarray, "4 4"]) -> list[np.ndarray]:
        """Of every connected part of the set the turn that is nearest to a given one."""
        if len(self.continuous) == 3:
            center = self.continuous[0].through
            return [transform(turn[:3, :3], center - turn[:3, :3] @ center)]
        elements = [np.eye(4), *self.discrete]
        about = [a.turn(_angle_about(a, turn @ inverse(e))) @ e for a in self.continuous for e in elements]
        return [*elements, *about]


NO_SYMMETRY = SymmetryGroup(np.empty((0, 4, 4)))


def axis_of(turn: Float[np.ndarray, "4 4"]) -> Axis:
    """The axis of a turn that is not the identity."""
    from scipy.spatial.transform import Rotation

    vector = Rotation.from_matrix(turn[:3, :3]).as_rotvec()
    through = np.linalg.lstsq(np.eye(3) - turn[:3, :3], turn[:3, 3], rcond=1e-6)[0]
    return Axis(pointing_up(vector / np.linalg.norm(vector)), through)


def pointing_up(direction: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Of the two directions of an axis the usual one: its main coordinate is positive, of several the last one."""
    main = np.flatnonzero(np.abs(direction) > 0.9 * np.abs(direction).max())[-1]
    return direction * np.sign(direction[main]) + 0.0


def turns_apart(turn: Float[np.ndarray, "4 4"], other: Float[np.ndarray, "4 4"], extent: Extent) -> float:
    """How far two turns carry a point of the object apart at most, as a share of its radius."""
    chord = np.linalg.norm(turn[:3, :3] - other[:3, :3], ord=2)
    shift = transform_points(turn, extent.center) - transform_points(other, extent.center)
    return float(chord + np.linalg.norm(shift) / extent.radius)


def _angle_about(axis: Axis, turn: Float[np.ndarray, "4 4"]) -> float:
    """The angle of the turn about an axis that is nearest to a rotation."""
    from scipy.spatial.transform import Rotation

    x, y, z, w = Rotation.from_matrix(turn[:3, :3]).as_quat()
    return 2 * float(np.arctan2(np.array([x, y, z]) @ axis.direction, w))


def _name(rotations: Float[np.ndarray, "k 3 3"]) -> str:
    """Schoenflies name of a finite group by its number of turns and their angles."""
    from scipy.spatial.transform import Rotation

    count = len(rotations) + 1
    if count == 1:
        return "no symmetry"
    angles = Rotation.from_matrix(rotations).magnitude()
    highest = int(np.rint(2 * np.pi / angles).max())
    if highest == count:
        return f"C{highest}: {highest}-fold"
    if highest * 2 == count:
        return f"D{highest}: {highest}-fold and flips" if highest > 2 else "D2: three 2-fold axes"
    return {12: "T: tetrahedron", 24: "O: cube", 60: "I: icosahedron"}.get(count, f"{count - 1} turns")
