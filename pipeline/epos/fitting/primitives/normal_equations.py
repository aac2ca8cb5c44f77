"""The least-squares problem of a Gauss-Newton step, summed and solved (compiled)."""

from typing import no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.compiled import FAST, kernel

UNKNOWNS = 6

_SINGULAR = 1e-7
"""Pivot of the scaled normal equations (sums of float32) from which they count as singular."""

_ONE, _ZERO = np.float32(1.0), np.float32(0.0)


@kernel(fastmath=FAST)
@no_type_check
def sum_equations(lens, pose, x, y, z, u, v, weight, count, inverse, equations):
    """Sum J^T w J (lower triangle of the first six rows) and J^T w r (last row) over correspondences; pixels."""
    r00, r01, r02, t0 = np.float32(pose[0, 0]), np.float32(pose[0, 1]), np.float32(pose[0, 2]), np.float32(pose[0, 3])
    r10, r11, r12, t1 = np.float32(pose[1, 0]), np.float32(pose[1, 1]), np.float32(pose[1, 2]), np.float32(pose[1, 3])
    r20, r21, r22, t2 = np.float32(pose[2, 0]), np.float32(pose[2, 1]), np.float32(pose[2, 2]), np.float32(pose[2, 3])
    k00, k01, k02 = np.float32(lens[0, 0]), np.float32(lens[0, 1]), np.float32(lens[0, 2])
    k11, k12 = np.float32(lens[1, 1]), np.float32(lens[1, 2])
    a00 = a01 = a02 = a03 = a04 = a05 = a11 = a12 = a13 = a14 = a15 = _ZERO
    a22 = a23 = a24 = a25 = a33 = a34 = a35 = a44 = a45 = a55 = _ZERO
    b0 = b1 = b2 = b3 = b4 = b5 = _ZERO
    for i in range(count):
        qx = r00 * x[i] + r01 * y[i] + r02 * z[i]
        qy = r10 * x[i] + r11 * y[i] + r12 * z[i]
        qz = r20 * x[i] + r21 * y[i] + r22 * z[i]
        near = _ONE / (qz + t2)
        xn, yn = (qx + t0) * near, (qy + t1) * near
        eu = u[i] - (k00 * xn + k01 * yn + k02)
        ev = v[i] - (k11 * yn + k12)
        w = _ONE - (eu * eu + ev * ev) * inverse
        w = w if w > _ZERO else _ZERO
        w = w * w * weight[i]
        # d(u, v) / d(point in camera) is (f, g, h) and (0, m, n); a turn moves the point by turn x (qx, qy, qz).
        f, g = k00 * near, k01 * near
        h = -(k00 * xn + k01 * yn) * near
        m = k11 * near
        n = -m * yn
        u0, u1, u2 = qy * h - qz * g, qz * f - qx * h, qx * g - qy * f
        v0, v1, v2 = qy * n - qz * m, -qx * n, qx * m
        a00 += w * (u0 * u0 + v0 * v0)
        a01 += w * (u0 * u1 + v0 * v1)
        a02 += w * (u0 * u2 + v0 * v2)
        a03 += w * (u0 * f)
        a04 += w * (u0 * g + v0 * m)
        a05 += w * (u0 * h + v0 * n)
        a11 += w * (u1 * u1 + v1 * v1)
        a12 += w * (u1 * u2 + v1 * v2)
        a13 += w * (u1 * f)
        a14 += w * (u1 * g + v1 * m)
        a15 += w * (u1 * h + v1 * n)
        a22 += w * (u2 * u2 + v2 * v2)
        a23 += w * (u2 * f)
        a24 += w * (u2 * g + v2 * m)
        a25 += w * (u2 * h + v2 * n)
        a33 += w * (f * f)
        a34 += w * (f * g)
        a35 += w * (f * h)
        a44 += w * (g * g + m * m)
        a45 += w * (g * h + m * n)
        a55 += w * (h * h + n * n)
        b0 += w * (u0 * eu + v0 * ev)
        b1 += w * (u1 * eu + v1 * ev)
        b2 += w * (u2 * eu + v2 * ev)
        b3 += w * (f * eu)
        b4 += w * (g * eu + m * ev)
        b5 += w * (h * eu + n * ev)
    m = equations
    m[0, 0], m[1, 0], m[2, 0], m[3, 0], m[4, 0], m[5, 0] = a00, a01, a02, a03, a04, a05
    m[1, 1], m[2, 1], m[3, 1], m[4, 1], m[5, 1] = a11, a12, a13, a14, a15
    m[2, 2], m[3, 2], m[4, 2], m[5, 2] = a22, a23, a24, a25
    m[3, 3], m[4, 3], m[5, 3], m[4, 4], m[5, 4], m[5, 5] = a33, a34, a35, a44, a45, a55
    m[6, 0], m[6, 1], m[6, 2], m[6, 3], m[6, 4], m[6, 5] = b0, b1, b2, b3, b4, b5


@kernel()
@no_type_check
def solve(m):
    """Solve the normal equations by Cholesky's method, the solution in the last row; False where they are singular."""
    scale = _scales(m)
    for i in range(UNKNOWNS):
        if not scale[i] > 0.0:
            return False
    for i in range(UNKNOWNS):
        for j in range(i + 1):
            value = m[i, j] * scale[i] * scale[j]
            for k in range(j):
                value -= m[i, k] * m[j, k]
            if i > j:
                m[i, j] = value / m[j, j]
            elif value > _SINGULAR:
                m[i, i] = np.sqrt(value)
            else:
                return False
    step = m[UNKNOWNS]
    for i in range(UNKNOWNS):
        step[i] *= scale[i]
        for k in range(i):
            step[i] -= m[i, k] * step[k]
        step[i] /= m[i, i]
    for i in range(UNKNOWNS - 1, -1, -1):
        for k in range(i + 1, UNKNOWNS):
            step[i] -= m[k, i] * step[k]
        step[i] /= m[i, i]
    for i in range(UNKNOWNS):
        step[i] *= scale[i]
    return True


@kernel()
@no_type_check
def _scales(m):
    """Factors that give the matrix a unit diagonal, since turns and shifts have different units; 0 for a bad entry."""
    return (_scale(m[0, 0]), _scale(m[1, 1]), _scale(m[2, 2]), _scale(m[3, 3]), _scale(m[4, 4]), _scale(m[5, 5]))


@kernel()
@no_type_check
def _scale(value):
    return 1.0 / np.sqrt(value) if value > 0.0 else 0.0
