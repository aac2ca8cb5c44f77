"""Compile the inner loops before they are needed: `python -m pipeline.warm_up`.

numba compiles a function when it is first called, which takes seconds, and keeps the machine code on disk beside
the source. Calling the pose errors once, on a tetrahedron, saves the first user that wait. The loops of EPOS's fitting
take a minute; who first runs EPOS is told so, and tests, of which many need them, have them compiled by
`python -m pipeline.warm_up --fitting`.
"""

import sys

import numpy as np

from pipeline.bop import errors
from pipeline.scene import Model


def main() -> None:
    """Call each compiled function with arguments of the types that it gets in use."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) / 10
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], dtype=np.int32)
    model = Model(obj_id=1, vertices=corners, faces=faces, diameter=float(np.sqrt(2)) / 10)
    pose = np.eye(4)
    pose[2, 3] = 1.0
    errors.mssd(model, pose, pose)
    errors.mspd(model, np.eye(3), pose, pose)
    errors.add(model, pose, pose)
    if "--fitting" in sys.argv[1:]:
        from pipeline.epos.fitting.warm_up import warm_up

        warm_up()


if __name__ == "__main__":
    main()
