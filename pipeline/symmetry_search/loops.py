"""Compiled loops over points and rotations, for the search of symmetries.

Importing this imports numba: do so inside the function that needs it. A field is an array (n, n, n, 4), float32: at
every node of a cubic grid the vector to the nearest point of the surface, and its length. Between nodes it is
interpolated; vectors, unlike lengths, have no kink at the surface, so that fits converge well below a cell.
"""

from typing import no_type_check

import numpy as np

from pipeline.bop.point_distances import _compiled


@_compiled()
@no_type_check
def farthest_points(points, count):
    """Indices of `count` points of (n, 3) of which each is the farthest from those before it, beginning with the first."""
    nearest = np.full(len(points), np.inf)
    chosen = np.empty(count, np.int64)
    current = 0
    for i in range(count):
        chosen[i] = current
        farthest, following = -1.0, 0
        for j in range(len(points)):
            squared = 0.0
            for k in range(3):
                squared += (points[j, k] - points[current, k]) ** 2
            if squared < nearest[j]:
                nearest[j] = squared
            if nearest[j] > farthest:
                farthest, following = nearest[j], j
        current = following
    return chosen


@_compiled(fastmath=True, nogil=True)
@no_type_check
def screen(field, low, per_metre, points, rotations):
    """Largest and mean distance to the surface of points (m, 3) turned about the origin by each rotation (r, 3, 3)."""
    found = np.empty((len(rotations), 2))
    vector, slopes = np.empty(3), np.empty((3, 3))
    turned = np.empty(3)
    for r in range(len(rotations)):
        largest, total = 0.0, 0.0
        for i in range(len(points)):
            for k in range(3):
                turned[k] = 0.0
                for j in range(3):
                    turned[k] += rotations[r, k, j] * points[i, j]
            _look_up(field, low, per_metre, turned, vector, slopes, False)
            squared = vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2
            largest = max(largest, squared)
            total += np.sqrt(squared)
        found[r, 0], found[r, 1] = np.sqrt(largest), total / len(points)
    return found


@_compiled(fastmath=True)
@no_type_check
def bounds(field, low, per_metre, points):
    """Interpolated lengths at points (m, 3); the true distance differs by less than a cell, for it is 1-Lipschitz."""
    found = np.empty(len(points))
    for i in range(len(points)):
        total = 0.0
        cell, share, beyond = _cell(field, low, per_metre, points[i])
        for a in range(2):
            for b in range(2):
                for c in range(2):
                    weight = _weight(share, a, b, c)
                    total += weight * field[cell[0] + a, cell[1] + b, cell[2] + c, 3]
        found[i] = total + np.sqrt(beyond[0] ** 2 + beyond[1] ** 2 + beyond[2] ** 2)
    return found


@_compiled(fastmath=True)
@no_type_check
def turn(points, angles, axis, through):
    """Points (n, 3) turned about an axis, each by its own angle (n)."""
    found = np.empty((len(points), 3))
    for i in range(len(points)):
        arm = points[i] - through
        R = _rotation(axis, angles[i])
        for k in range(3):
            found[i, k] = R[k, 0] * arm[0] + R[k, 1] * arm[1] + R[k, 2] * arm[2] + through[k]
    return found


@_compiled(fastmath=True)
@no_type_check
def slopes(points, angles, axis, through, along):
    """Derivatives (n, 4) of turned points along a direction each (n, 3) by the parameters of `moved`."""
    e1, e2 = tangents(axis)
    basis = (e1, e2)
    found = np.empty((len(points), 4))
    arm, turned, move = np.empty(3), np.empty(3), np.empty(3)
    for i in range(len(points)):
        R = _rotation(axis, angles[i])
        for k in range(3):
            arm[k] = points[i, k] - through[k]
        for k in range(3):
            turned[k] = R[k, 0] * arm[0] + R[k, 1] * arm[1] + R[k, 2] * arm[2]
        for parameter in range(4):
            _derivative(R, basis[parameter % 2], parameter < 2, arm, turned, move)
            found[i, parameter] = along[i, 0] * move[0] + along[i, 1] * move[1] + along[i, 2] * move[2]
    return found


@_compiled(fastmath=True, nogil=True)
@no_type_check
def fit_axis(field, low, per_metre, points, angles, axis, through, exponent, steps):
    """Turn and move an axis so that points (m, 3) turned about it by all angles come to lie near the surface.

    Levenberg-Marquardt on the sum of distances to the power of `exponent`, in units of a cell.

    Returns:
        Axis, point that it goes through, largest and mean distance of the turned points.

    """
    A, b = np.empty((4, 4)), np.empty(4)
    cost, largest, mean = _normal_equations(field, low, per_metre, points, angles, axis, through, exponent, A, b)
    A2, b2 = np.empty((4, 4)), np.empty(4)
    reach = 0.25 * (field.shape[0] - 1) / per_metre  # metres that count like a radian
    scale = np.array([1.0, 1.0, reach, reach])
    damping = 1e-3
    for _ in range(steps):
        damped = A.copy()
        trace = 0.0
        for k in range(4):
            trace += A[k, k] * scale[k] ** 2
        for k in range(4):
            damped[k, k] += damping * trace / scale[k] ** 2 + 1e-12
        step = np.linalg.solve(damped, -b)
        longest = np.max(np.abs(step / scale))
        if longest > 0.15:
            step *= 0.15 / longest
        axis2, through2 = moved(axis, through, step)
        cost2, largest2, mean2 = _normal_equations(
            field, low, per_metre, points, angles, axis2, through2, exponent, A2, b2
        )
        if cost2 < cost:
            axis, through, cost, largest, mean = axis2, through2, cost2, largest2, mean2
            A, A2, b, b2 = A2, A, b2, b
            damping = max(damping * 0.3, 1e-6)
            if longest < 1e-4:
                break
        else:
            damping *= 8.0
            if damping > 1e6:
                break
    return axis, through, largest, mean


@_compiled(fastmath=True)
@no_type_check
def _normal_equations(field, low, per_metre, points, angles, axis, through, exponent, A, b):
    """Fill A (4, 4) and b (4) of a Gauss-Newton step over `moved`; return cost, largest and mean distance."""
    A[:], b[:] = 0.0, 0.0
    e1, e2 = tangents(axis)
    basis = (e1, e2)
    vector, slopes = np.empty(3), np.empty((3, 3))
    arm, turned, place, move = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    derivatives = np.empty((4, 3))
    cost, largest, total = 0.0, 0.0, 0.0
    for angle in angles:
        R = _rotation(axis, angle)
        for i in range(len(points)):
            for k in range(3):
                arm[k] = points[i, k] - through[k]
            for k in range(3):
                turned[k] = R[k, 0] * arm[0] + R[k, 1] * arm[1] + R[k, 2] * arm[2]
                place[k] = turned[k] + through[k]
            _look_up(field, low, per_metre, place, vector, slopes, True)
            distance = np.sqrt(vector[0] ** 2 + vector[1] ** 2 + vector[2] ** 2)
            largest = max(largest, distance)
            total += distance
            in_cells = distance * per_metre
            weight = max(in_cells, 1e-6) ** (exponent - 2.0)
            cost += weight * in_cells**2
            for parameter in range(4):
                _derivative(R, basis[parameter % 2], parameter < 2, arm, turned, move)
                for k in range(3):
                    derivatives[parameter, k] = slopes[k, 0] * move[0] + slopes[k, 1] * move[1] + slopes[k, 2] * move[2]
            for p in range(4):
                for q in range(p, 4):
                    for k in range(3):
                        A[p, q] += weight * derivatives[p, k] * derivatives[q, k]
                for k in range(3):
                    b[p] += weight * derivatives[p, k] * vector[k]
    for p in range(4):
        for q in range(p):
            A[p, q] = A[q, p]
    return cost, largest, total / (len(points) * len(angles))


@_compiled(fastmath=True)
@no_type_check
def _derivative(R, e, of_direction, arm, turned, move):
    """How a point turned by R moves when the axis turns about a tangent e, or moves along it; written to `move`."""
    if of_direction:  # d/dw of exp(w) R exp(-w)
        x = e[1] * arm[2] - e[2] * arm[1]
        y = e[2] * arm[0] - e[0] * arm[2]
        z = e[0] * arm[1] - e[1] * arm[0]
        move[0] = e[1] * turned[2] - e[2] * turned[1] - (R[0, 0] * x + R[0, 1] * y + R[0, 2] * z)
        move[1] = e[2] * turned[0] - e[0] * turned[2] - (R[1, 0] * x + R[1, 1] * y + R[1, 2] * z)
        move[2] = e[0] * turned[1] - e[1] * turned[0] - (R[2, 0] * x + R[2, 1] * y + R[2, 2] * z)
    else:
        for k in range(3):
            move[k] = e[k] - (R[k, 0] * e[0] + R[k, 1] * e[1] + R[k, 2] * e[2])


@_compiled(fastmath=True)
@no_type_check
def _look_up(field, low, per_metre, place, vector, slopes, with_slopes):
    """Interpolate the vector to the surface at a place, and if wanted its derivatives (3, 3) by the place."""
    cell, share, beyond = _cell(field, low, per_metre, place)
    vector[:] = 0.0
    if with_slopes:
        slopes[:] = 0.0
    for a in range(2):
        u = share[0] if a else 1.0 - share[0]
        for b in range(2):
            v = share[1] if b else 1.0 - share[1]
            for c in range(2):
                w = share[2] if c else 1.0 - share[2]
                node = field[cell[0] + a, cell[1] + b, cell[2] + c]
                weight = u * v * w
                for k in range(3):
                    vector[k] += weight * node[k]
                if with_slopes:
                    du = v * w * per_metre * (1.0 if a else -1.0)
                    dv = u * w * per_metre * (1.0 if b else -1.0)
                    dw = u * v * per_metre * (1.0 if c else -1.0)
                    for k in range(3):
                        slopes[k, 0] += du * node[k]
                        slopes[k, 1] += dv * node[k]
                        slopes[k, 2] += dw * node[k]
    for k in range(3):
        vector[k] -= beyond[k]


@_compiled(fastmath=True)
@no_type_check
def _cell(field, low, per_metre, place):
    """Cell of a place, its shares 0..1 within the cell, and how far it lies beyond the grid (metres, 0 inside)."""
    last = field.shape[0] - 1
    x, y, z = (
        (place[0] - low[0]) * per_metre,
        (place[1] - low[1]) * per_metre,
        (place[2] - low[2]) * per_metre,
    )
    xin, yin, zin = min(max(x, 0.0), last - 1e-6), min(max(y, 0.0), last - 1e-6), min(max(z, 0.0), last - 1e-6)
    i, j, k = int(xin), int(yin), int(zin)
    return (
        (i, j, k),
        (xin - i, yin - j, zin - k),
        ((x - xin) / per_metre, (y - yin) / per_metre, (z - zin) / per_metre),
    )


@_compiled(fastmath=True)
@no_type_check
def _weight(share, a, b, c):
    """Weight of a corner of a cell in trilinear interpolation."""
    u = share[0] if a else 1.0 - share[0]
    v = share[1] if b else 1.0 - share[1]
    w = share[2] if c else 1.0 - share[2]
    return u * v * w


@_compiled()
@no_type_check
def moved(axis, through, step):
    """An axis turned by step[:2] (radians) and moved by step[2:] (metres) across itself."""
    e1, e2 = tangents(axis)
    w = step[0] * e1 + step[1] * e2
    angle = np.sqrt((w * w).sum())
    turned = axis if angle < 1e-15 else _rotation(w / angle, angle) @ axis
    turned = turned / np.sqrt((turned * turned).sum())
    place = through + step[2] * e1 + step[3] * e2
    return turned, place - turned * (turned * place).sum()


@_compiled()
@no_type_check
def tangents(axis):
    """Two unit vectors at right angles to a unit vector and to each other."""
    least = np.argmin(np.abs(axis))
    e1 = np.zeros(3)
    e1[least] = 1.0
    e1 -= axis * axis[least]
    e1 /= np.sqrt((e1 * e1).sum())
    e2 = np.empty(3)
    for k in range(3):
        e2[k] = axis[(k + 1) % 3] * e1[(k + 2) % 3] - axis[(k + 2) % 3] * e1[(k + 1) % 3]
    return e1, e2


@_compiled()
@no_type_check
def _rotation(axis, angle):
    """Rodrigues' formula."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = axis[0], axis[1], axis[2]
    d = 1.0 - c
    return np.array(
        [
            [c + d * x * x, d * x * y - s * z, d * x * z + s * y],
            [d * x * y + s * z, c + d * y * y, d * y * z - s * x],
            [d * x * z - s * y, d * y * z + s * x, c + d * z * z],
        ]
    )
