"""Small things about (3, 4) poses (compiled)."""

from typing import no_type_check

from pipeline.epos.fitting.primitives.compiled import kernel


@kernel()
@no_type_check
def copy_pose(source, target):
    """Copy (3, 4) numbers; an assignment of slices would take seconds to compile."""
    for r in range(3):
        for c in range(4):
            target[r, c] = source[r, c]


@kernel()
@no_type_check
def determinant(pose):
    """Determinant of the rotation: negative for an improper one."""
    return (
        pose[0, 0] * (pose[1, 1] * pose[2, 2] - pose[1, 2] * pose[2, 1])
        - pose[0, 1] * (pose[1, 0] * pose[2, 2] - pose[1, 2] * pose[2, 0])
        + pose[0, 2] * (pose[1, 0] * pose[2, 1] - pose[1, 1] * pose[2, 0])
    )


@kernel()
@no_type_check
def place_of(lens, pose, radius):
    """Projected centre (u, v) and radius of an object, pixels."""
    scale = 1.0 / pose[2, 3]
    u = (lens[0, 0] * pose[0, 3] + lens[0, 1] * pose[1, 3]) * scale + lens[0, 2]
    return u, lens[1, 1] * pose[1, 3] * scale + lens[1, 2], lens[0, 0] * radius * scale
