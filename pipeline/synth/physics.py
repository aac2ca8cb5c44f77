"""Things that fall, collide and come to rest: plausible arrangements of solids by MuJoCo (metres, z up).

Bodies collide as unions of convex hulls of slices of themselves, which contain them: hulls that do not overlap
mean bodies that do not. Needs `mujoco` (extra `synth`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from pipeline.geometry import transform

if TYPE_CHECKING:
    from manifold3d import Manifold

CONTACT_MARGIN = 0.00012
"""Contacts push from this distance on (metres), so that soft contacts do not let bodies overlap."""


@dataclass(frozen=True, eq=False)
class Body:
    """A thing to be dropped."""

    hulls: Sequence[Float[np.ndarray, "_ 3"]]
    """Vertices of convex pieces that together contain the body; metres, body frame."""
    start: Float[np.ndarray, "4 4"]
    """World from body, before the fall."""


@dataclass(frozen=True)
class Wall:
    """A fixed axis-aligned box: centre and half sizes, metres."""

    centre: tuple[float, float, float]
    half_sizes: tuple[float, float, float]


def convex_pieces(solid_mm: Manifold, slices: int = 6) -> list[Float[np.ndarray, "_ 3"]]:
    """Convex hulls (metres) of slices of a solid across its longest side."""
    low, high = np.reshape(solid_mm.bounding_box(), (2, 3))
    axis = int(np.argmax(high - low))
    normal = tuple(np.eye(3)[axis])
    cuts = np.linspace(low[axis], high[axis], slices + 1)
    pieces = []
    for below, above in pairwise(cuts):
        slab = solid_mm.trim_by_plane(normal, below).trim_by_plane(tuple(-x for x in normal), -above)
        pieces += [part.hull() for part in slab.decompose() if part.volume() > 5.0]
    return [np.asarray(piece.to_mesh().vert_properties)[:, :3].astype(float) / 1000.0 for piece in pieces]


def drop(bodies: Sequence[Body], walls: Sequence[Wall] = (), seconds: float = 6.0) -> list[Float[np.ndarray, "4 4"]]:
    """Let bodies fall onto the plane z = 0 and between walls; their world poses when all are at rest."""
    import mujoco as _mujoco

    mujoco: Any = _mujoco  # its names come from a compiled module that type checkers cannot read
    model = mujoco.MjModel.from_xml_string(_world_xml(bodies, walls))
    data = mujoco.MjData(model)
    for step in range(int(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
        if step % 100 == 99 and step * model.opt.timestep > 0.5 and np.abs(data.qvel).max() < 2e-3:
            break
    poses = data.qpos.reshape(-1, 7)
    return [transform(_rotation(pose[3:]), pose[:3]) for pose in poses]


def _world_xml(bodies: Sequence[Body], walls: Sequence[Wall]) -> str:
    meshes, nodes = [], []
    for i, body in enumerate(bodies):
        geoms = []
        for j, hull in enumerate(body.hulls):
            # MuJoCo moves a mesh to its centre of mass and back: poses stay those of the body frame.
            meshes.append(f'<mesh name="m{i}_{j}" vertex="{_text(hull.ravel())}"/>')
            geoms.append(f'<geom type="mesh" mesh="m{i}_{j}" class="body"/>')
        pose = f'pos="{_text(body.start[:3, 3])}" quat="{_text(_quaternion_wxyz(body.start[:3, :3]))}"'
        nodes.append(f"<body {pose}><freejoint/>{''.join(geoms)}</body>")
    for wall in walls:
        nodes.append(f'<geom type="box" class="body" pos="{_text(wall.centre)}" size="{_text(wall.half_sizes)}"/>')
    return f"""<mujoco>
      <option timestep="0.001" integrator="implicitfast" density="30" viscosity="0.05"/>
      <default><default class="body">
        <geom density="900" condim="6" friction="0.6 0.01 0.003" solref="0.004 1" margin="{CONTACT_MARGIN}"/>
      </default></default>
      <asset>{"".join(meshes)}</asset>
      <worldbody><geom type="plane" size="2 2 0.1" class="body"/>{"".join(nodes)}</worldbody>
    </mujoco>"""


def _text(values: Sequence[float] | np.ndarray) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _quaternion_wxyz(rotation: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, " 4"]:
    from scipy.spatial.transform import Rotation

    return np.roll(Rotation.from_matrix(rotation).as_quat(), 1)


def _rotation(quaternion_wxyz: Float[np.ndarray, " 4"]) -> Float[np.ndarray, "3 3"]:
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(np.roll(quaternion_wxyz, -1)).as_matrix()
