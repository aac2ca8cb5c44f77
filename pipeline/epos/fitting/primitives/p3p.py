"""The perspective-three-point problem: camera poses that see three model points along three rays (thesis sec. epos_fitting).

The three distances d from the camera satisfy three quadratic equations. Two homogeneous combinations of them are conics
through the solutions; the pencil of both holds a pair of lines, found by a cubic, and each line meets a conic at up to
two solutions (the way of Persson & Nordberg, "Lambda Twist", ECCV 2018). Two Newton steps then polish the distances.
"""

from typing import no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.compiled import kernel
from pipeline.epos.fitting.primitives.conics import degenerate, line_pair, meet

MAX_SOLUTIONS = 4


@kernel()
@no_type_check
def solve_p3p(rays, points, poses):
    """Find the poses that see three points along three rays.

    Args:
        rays: (3, 3) unit vectors in the camera frame, one a row.
        points: (3, 3) in the model frame, one a row; not collinear.
        poses: (4, 3, 4), filled with camera_from_model; rotations are proper and the points lie before the camera.

    Returns:
        The number of poses, 0 to 4.

    """
    cosines = (_dot(rays, 0, rays, 1), _dot(rays, 0, rays, 2), _dot(rays, 1, rays, 2))
    squares = (_squared_distance(points, 0, 1), _squared_distance(points, 0, 2), _squared_distance(points, 1, 2))
    m12, m13, m23 = cosines
    s12, s13, s23 = squares
    if min(s12, s13, s23) <= 0.0:
        return 0
    # Conics d^T A d = d^T B d = 0 as (dd11, dd22, dd33, dd12, dd13, dd23), off-diagonal entries of the symmetric matrix.
    a = (s23, s23 - s12, -s12, -s23 * m12, 0.0, s12 * m23)
    b = (s23, -s13, s23 - s13, 0.0, -s23 * m13, s13 * m23)
    found, first, second = line_pair(degenerate(a, b))
    if not found:
        return 0
    count = 0
    for side in range(2):
        line = first if side == 0 else second
        pairs, one, other = meet(line, a)
        for k in range(pairs):
            valid, d = _distances(one if k == 0 else other, cosines, squares)
            if valid:
                _place(d, rays, points, poses[count])
                count += 1
    return count


@kernel()
@no_type_check
def _dot(a, i, b, j):
    return a[i, 0] * b[j, 0] + a[i, 1] * b[j, 1] + a[i, 2] * b[j, 2]


@kernel()
@no_type_check
def _squared_distance(points, i, j):
    x, y, z = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1], points[i, 2] - points[j, 2]
    return x * x + y * y + z * z


@kernel()
@no_type_check
def _distances(d, cosines, squares):
    """Scale three proportional distances to the true ones and polish them; not valid where one is not positive."""
    d1, d2, d3 = d
    if d1 < 0.0:
        d1, d2, d3 = -d1, -d2, -d3
    if not (d1 > 0.0 and d2 > 0.0 and d3 > 0.0):
        return False, d
    m12, m13, m23 = cosines
    s12, s13, s23 = squares
    whole = 2.0 * (d1 * d1 + d2 * d2 + d3 * d3 - m12 * d1 * d2 - m13 * d1 * d3 - m23 * d2 * d3)
    if not whole > 0.0:
        return False, d
    scale = np.sqrt((s12 + s13 + s23) / whole)
    d1, d2, d3 = scale * d1, scale * d2, scale * d3
    for _ in range(2):
        # Half the derivatives of the three equations, each of two distances.
        a1, a2 = d1 - m12 * d2, d2 - m12 * d1
        b1, b3 = d1 - m13 * d3, d3 - m13 * d1
        c2, c3 = d2 - m23 * d3, d3 - m23 * d2
        ra = 0.5 * (s12 - d1 * a1 - d2 * a2)
        rb = 0.5 * (s13 - d1 * b1 - d3 * b3)
        rc = 0.5 * (s23 - d2 * c2 - d3 * c3)
        det = -a1 * b3 * c2 - a2 * b1 * c3
        if det == 0.0:
            break
        d1 += (-b3 * c2 * ra - a2 * c3 * rb + a2 * b3 * rc) / det
        d2 += (-b1 * c3 * ra + a1 * c3 * rb - a1 * b3 * rc) / det
        d3 += (b1 * c2 * ra - a1 * c2 * rb - a2 * b1 * rc) / det
    off = abs(d1 * d1 + d2 * d2 - 2.0 * m12 * d1 * d2 - s12) + abs(d1 * d1 + d3 * d3 - 2.0 * m13 * d1 * d3 - s13)
    off += abs(d2 * d2 + d3 * d3 - 2.0 * m23 * d2 * d3 - s23)
    return d1 > 0.0 and d2 > 0.0 and d3 > 0.0 and off < 1e-6 * (s12 + s13 + s23), (d1, d2, d3)


@kernel()
@no_type_check
def _place(d, rays, points, pose):
    """Write the pose that takes each point to its distance along its ray: the turn between the two triangles' frames."""
    camera = (
        (d[0] * rays[0, 0], d[0] * rays[0, 1], d[0] * rays[0, 2]),
        (d[1] * rays[1, 0], d[1] * rays[1, 1], d[1] * rays[1, 2]),
        (d[2] * rays[2, 0], d[2] * rays[2, 1], d[2] * rays[2, 2]),
    )
    model = (
        (points[0, 0], points[0, 1], points[0, 2]),
        (points[1, 0], points[1, 1], points[1, 2]),
        (points[2, 0], points[2, 1], points[2, 2]),
    )
    f1, f2, f3 = _frame(camera)
    e1, e2, e3 = _frame(model)
    for r in range(3):
        for c in range(3):
            pose[r, c] = f1[r] * e1[c] + f2[r] * e2[c] + f3[r] * e3[c]
        pose[r, 3] = camera[0][r] - pose[r, 0] * points[0, 0] - pose[r, 1] * points[0, 1] - pose[r, 2] * points[0, 2]


@kernel()
@no_type_check
def _frame(triangle):
    """Right-handed orthonormal axes of a triangle: along its first edge, in its plane, along its normal."""
    p, q, r = triangle
    first = _unit((q[0] - p[0], q[1] - p[1], q[2] - p[2]))
    third = _unit(_cross(first, (r[0] - p[0], r[1] - p[1], r[2] - p[2])))
    return first, _cross(third, first), third


@kernel()
@no_type_check
def _cross(a, b):
    return (a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0])


@kernel()
@no_type_check
def _unit(a):
    scale = 1.0 / np.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])
    return (a[0] * scale, a[1] * scale, a[2] * scale)
