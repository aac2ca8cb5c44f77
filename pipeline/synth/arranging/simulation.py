"""Bodies that fall, collide and come to rest: MuJoCo, in the frame of a stage (metres, z up, the stage at z = 0).

Bodies collide by their convex pieces, which contain them: pieces that do not overlap mean bodies that do not.
Contacts push from a small distance on (`MARGIN`), so that bodies do not overlap although contacts are soft; and they
foresee what would happen within a step, so that fast bodies do not pass through thin ones. Needs `mujoco` (extra
`synth`).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.geometry import transform
from pipeline.synth.arranging.convex_pieces import Pieces

log = logging.getLogger(__name__)

STEP = 0.002
"""Seconds of one step of the simulation."""
STIFFNESS = 0.004
"""Seconds in which a contact undoes an overlap; the least that is stable is two steps."""
MARGIN = 0.0001
"""Metres."""
DENSITY = 900.0
"""kg / m^3 of all bodies."""
FRICTION = (0.6, 0.006, 0.002)
"""Sliding; about the normal and rolling, metres."""
DRAG = 1.5
"""Seconds in which the air takes most of the speed of a body: what would roll for ever comes to rest."""
FAR = 100.0
"""Metres: where bodies are parked."""

Wall = tuple[Float[np.ndarray, " 2"], Float[np.ndarray, " 2"]]
"""A point on an endless upright wall and its normal, which points to the free side."""


class Simulation:
    """Bodies above a stage: each is placed, or parked where it touches nothing (as all are at first)."""

    def __init__(
        self,
        bodies: Sequence[Pieces],
        statics: Sequence[Float[np.ndarray, "_ 3"]] = (),
        walls: Sequence[Wall] = (),
        margin: float = MARGIN,
    ) -> None:
        """`statics` are corners of convex bodies that do not move."""
        import mujoco as _mujoco

        self._mujoco: Any = _mujoco  # its names come from a compiled module that type checkers cannot read
        self._mujoco.set_mju_user_warning(log.warning)  # else they go to a file in the current folder
        self._bodies = list(bodies)
        self._model = _spec(self._mujoco, bodies, statics, walls, margin).compile()
        self._data = self._mujoco.MjData(self._model)
        self._corners = [_box_corners(body) for body in bodies]
        self._walls = slice(len(statics), len(statics) + len(walls))
        self.placed = np.zeros(len(bodies), bool)
        for index in range(len(bodies)):
            self.park(index)
        for index, body in enumerate(bodies):
            self._model.dof_damping[6 * index : 6 * index + 3] = body.volume * DENSITY / DRAG
            self._model.dof_damping[6 * index + 3 : 6 * index + 6] = np.trace(body.inertia) / 3 * DENSITY / DRAG

    def place(self, index: int, stage_from_model: Float[np.ndarray, "4 4"]) -> None:
        """Put a body somewhere, at rest."""
        self._put(index, stage_from_model[:3, 3], Rotation.from_matrix(stage_from_model[:3, :3]))
        self._collides(index, True)

    def park(self, index: int) -> None:
        """Take a body away."""
        self._put(index, np.array([FAR, 5.0 * index, FAR]), Rotation.identity())
        self._collides(index, False)

    def touched(self, index: int, distance: float = 0.0) -> bool:
        """Whether a placed body comes nearer than `distance` (at most the margin) to anything else."""
        mujoco, model, data = self._mujoco, self._model, self._data
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        near = data.contact.dist < distance
        return bool((model.geom_bodyid[data.contact.geom[near]] == index + 1).any())

    def drop_walls(self) -> None:
        """Take all walls away."""
        self._model.geom_contype[self._walls] = 0
        self._model.geom_conaffinity[self._walls] = 0

    def run(self, seconds: float) -> None:
        """Let time pass."""
        for index in np.flatnonzero(~self.placed):
            self.park(int(index))  # else it falls ever faster
        self._mujoco.mj_step(self._model, self._data, round(seconds / STEP))

    def poses(self) -> Float[np.ndarray, "n 4 4"]:
        """Stage from model, of all bodies."""
        states = self._data.qpos.reshape(-1, 7)
        rotations = Rotation.from_quat(np.roll(states[:, 3:], -1, axis=1)).as_matrix()
        return np.array([transform(R, t) for R, t in zip(rotations, states[:, :3], strict=True)]).reshape(-1, 4, 4)

    def displacements(
        self, before: Float[np.ndarray, "n 4 4"], after: Float[np.ndarray, "n 4 4"]
    ) -> Float[np.ndarray, " n"]:
        """How far the corner of each body's box that moved most has gone; 0 for bodies that are not placed."""
        corners = np.array(self._corners).reshape(-1, 8, 3)
        moved = np.einsum("nij,nkj->nki", after[:, :3, :3] - before[:, :3, :3], corners)
        moved += (after - before)[:, None, :3, 3]
        return np.where(self.placed, np.linalg.norm(moved, axis=2).max(axis=1, initial=0.0), 0.0)

    def _put(self, index: int, position: Float[np.ndarray, " 3"], rotation: Rotation) -> None:
        state = self._data.qpos[7 * index : 7 * index + 7]
        state[:3], state[3:] = position, np.roll(rotation.as_quat(), 1)
        self._data.qvel[6 * index : 6 * index + 6] = 0.0
        self._data.qacc_warmstart[6 * index : 6 * index + 6] = 0.0

    def _collides(self, index: int, does: bool) -> None:
        geoms = self._model.geom_bodyid == index + 1
        self._model.geom_contype[geoms] = self._model.geom_conaffinity[geoms] = int(does)
        self.placed[index] = does


def _spec(
    mujoco: Any, bodies: Sequence[Pieces], statics: Sequence[np.ndarray], walls: Sequence[Wall], margin: float
) -> Any:
    """What MuJoCo is to simulate; equal bodies share their meshes."""
    spec = mujoco.MjSpec()
    option = spec.option
    option.timestep, option.integrator = STEP, mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    # Elliptic cones and much stiffer friction than usual: else leaning bodies creep, and piles come down in the end.
    option.cone, option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 100.0
    spec.memory = 64 * 1024 * 1024 + 8 * 1024 * 1024 * len(bodies)  # bytes, for contacts: virtual until used
    option.enableflags |= mujoco.mjtEnableBit.mjENBL_SPECULATIVE
    geom = spec.default.geom
    geom.condim, geom.friction, geom.solref, geom.margin = 6, FRICTION, (STIFFNESS, 1.0), margin
    for hull in statics:
        _add_hull(mujoco, spec, spec.worldbody, f"static {len(spec.meshes)}", hull)
    for point, normal in walls:
        turn = Rotation.from_matrix(np.column_stack([[-normal[1], normal[0], 0], [0, 0, 1], [*normal, 0]]))
        pose = {"pos": [*point, 0.0], "quat": np.roll(turn.as_quat(), 1)}
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 0.1], **pose)
    for pieces in bodies:
        _add_body(mujoco, spec, pieces)
    return spec


def _add_body(mujoco: Any, spec: Any, pieces: Pieces) -> None:
    body = spec.worldbody.add_body()
    body.add_freejoint()
    inertia = DENSITY * pieces.inertia
    body.explicitinertial, body.mass, body.ipos = True, DENSITY * pieces.volume, pieces.centre
    body.fullinertia = inertia[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    for number, hull in enumerate(pieces.hulls):
        _add_hull(mujoco, spec, body, f"{id(pieces)} {number}", hull)


def _add_hull(mujoco: Any, spec: Any, body: Any, name: str, hull: Float[np.ndarray, "_ 3"]) -> None:
    if spec.mesh(name) is None:
        spec.add_mesh(name=name, uservert=hull.ravel(), inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX)
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=name)


def _box_corners(pieces: Pieces) -> Float[np.ndarray, "8 3"]:
    points = np.concatenate(pieces.hulls)
    low, high = points.min(axis=0), points.max(axis=0)
    return np.where(np.array(list(np.ndindex(2, 2, 2))) == 1, high, low)
