"""Conics through the solutions of P3P: the pair of lines in their pencil, and where a line meets one (compiled).

A conic is its symmetric matrix as (a11, a22, a33, a12, a13, a23).
"""

from typing import no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.compiled import kernel


@kernel()
@no_type_check
def degenerate(a, b):
    """The conic a + x b of determinant zero (b itself where its determinant is zero, x being infinite)."""
    c0, c3 = _determinant(a), _determinant(b)
    c1, c2 = _trace_of_product(_adjugate(a), b), _trace_of_product(_adjugate(b), a)
    if abs(c3) <= 1e-14 * (abs(c0) + abs(c1) + abs(c2)):
        return b
    x = _far_root(c2 / c3, c1 / c3, c0 / c3)
    return (a[0] + x * b[0], a[1] + x * b[1], a[2] + x * b[2], a[3] + x * b[3], a[4] + x * b[4], a[5] + x * b[5])


@kernel()
@no_type_check
def line_pair(c):
    """Split a conic of determinant zero into its two lines; none where they are not real.

    The adjugate is -p p^T for the point p where the lines meet, and c + [p]x has rank one: a line a row, one a column.
    """
    adjugate = _adjugate(c)
    if adjugate[0] <= adjugate[1] and adjugate[0] <= adjugate[2]:
        square, p = -adjugate[0], (-adjugate[0], -adjugate[3], -adjugate[4])
    elif adjugate[1] <= adjugate[2]:
        square, p = -adjugate[1], (-adjugate[3], -adjugate[1], -adjugate[5])
    else:
        square, p = -adjugate[2], (-adjugate[4], -adjugate[5], -adjugate[2])
    if not square > 0.0:
        return False, p, p
    scale = 1.0 / np.sqrt(square)
    x, y, z = p[0] * scale, p[1] * scale, p[2] * scale
    rows = ((c[0], c[3] - z, c[4] + y), (c[3] + z, c[1], c[5] - x), (c[4] - y, c[5] + x, c[2]))
    columns = ((c[0], c[3] + z, c[4] - y), (c[3] - z, c[1], c[5] + x), (c[4] + y, c[5] - x, c[2]))
    return True, _longest(rows), _longest(columns)


@kernel()
@no_type_check
def meet(line, c):
    """Points (homogeneous) where a line meets a conic: their number and two of them."""
    x, y, z = line
    # The line's points are r (0, z, -y) + (-z, 0, x) and the like: take the two whose common entry is the longest.
    if abs(x) >= abs(y) and abs(x) >= abs(z):
        e, f = (-y, x, 0.0), (-z, 0.0, x)
    elif abs(y) >= abs(z):
        e, f = (y, -x, 0.0), (0.0, -z, y)
    else:
        e, f = (z, 0.0, -x), (0.0, z, -y)
    ee, ef, ff = _bilinear(e, c, e), _bilinear(e, c, f), _bilinear(f, c, f)
    discriminant = ef * ef - ee * ff
    if not discriminant >= 0.0:
        return 0, e, f
    root = -ef - (np.sqrt(discriminant) if ef >= 0.0 else -np.sqrt(discriminant))
    # The solutions are e r + f with r = root / ee and r = ff / root.
    one = (e[0] * root + f[0] * ee, e[1] * root + f[1] * ee, e[2] * root + f[2] * ee)
    other = (e[0] * ff + f[0] * root, e[1] * ff + f[1] * root, e[2] * ff + f[2] * root)
    return 2, one, other


@kernel()
@no_type_check
def _determinant(a):
    return a[0] * (a[1] * a[2] - a[5] * a[5]) - a[3] * (a[3] * a[2] - a[5] * a[4]) + a[4] * (a[3] * a[5] - a[1] * a[4])


@kernel()
@no_type_check
def _adjugate(a):
    """Adjugate of a symmetric matrix, in the same order of entries."""
    return (
        a[1] * a[2] - a[5] * a[5],
        a[0] * a[2] - a[4] * a[4],
        a[0] * a[1] - a[3] * a[3],
        a[4] * a[5] - a[3] * a[2],
        a[3] * a[5] - a[4] * a[1],
        a[3] * a[4] - a[0] * a[5],
    )


@kernel()
@no_type_check
def _trace_of_product(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + 2.0 * (a[3] * b[3] + a[4] * b[4] + a[5] * b[5])


@kernel()
@no_type_check
def _far_root(c2, c1, c0):
    """Real root of x^3 + c2 x^2 + c1 x + c0 that is farthest from the inflection: the best separated one."""
    shift = c2 / 3.0
    p = c1 / 3.0 - shift * shift
    q = shift * (shift * shift - c1 / 2.0) + c0 / 2.0  # t^3 + 3 p t + 2 q = 0 with x = t - shift
    discriminant = q * q + p * p * p
    sign = -1.0 if q > 0.0 else 1.0
    if discriminant > 0.0:
        u = sign * np.cbrt(abs(q) + np.sqrt(discriminant))
        t = u - p / u
    else:
        r = np.sqrt(-p)
        ratio = min(1.0, abs(q) / (r * r * r)) if r > 0.0 else 1.0
        t = sign * 2.0 * r * np.cos(np.arccos(ratio) / 3.0)
    x = t - shift
    for _ in range(2):
        slope = (3.0 * x + 2.0 * c2) * x + c1
        if slope != 0.0:
            x -= (((x + c2) * x + c1) * x + c0) / slope
    return x


@kernel()
@no_type_check
def _longest(rows):
    best = rows[0]
    length = best[0] * best[0] + best[1] * best[1] + best[2] * best[2]
    for row in rows[1:]:
        other = row[0] * row[0] + row[1] * row[1] + row[2] * row[2]
        if other > length:
            best, length = row, other
    return best


@kernel()
@no_type_check
def _bilinear(e, c, f):
    x = c[0] * f[0] + c[3] * f[1] + c[4] * f[2]
    y = c[3] * f[0] + c[1] * f[1] + c[5] * f[2]
    z = c[4] * f[0] + c[5] * f[1] + c[2] * f[2]
    return e[0] * x + e[1] * y + e[2] * z
