"""Compiled loops over model vertices, for the pose errors.

Importing this imports numba: do so inside the function that needs it. Vertices come as (3, v), one row per coordinate,
which lets the compiler use vector instructions; all arrays are C-contiguous float64 and writable, so that each loop
is compiled once. The machine code is kept on disk beside this file, else in the user's cache, if either can be
written to. `no_type_check` keeps jaxtyping's import hook from wrapping what numba is to compile.
"""

from collections.abc import Callable
from typing import Any, no_type_check

import numpy as np
from numba import njit

BLOCK = 64
"""Vertices measured between two looks at whether the symmetry can still win."""

_SIGN_OFF = 0x7FFFFFFFFFFFFFFF


def _compiled(**options: Any) -> Callable[[Callable], Any]:
    """Decorate a function to be compiled; where its machine code cannot be kept, it is compiled in each process."""

    def decorate(function: Callable) -> Any:
        try:
            return njit(cache=True, error_model="numpy", **options)(function)
        except RuntimeError:  # numba found no folder that it may write to
            return njit(error_model="numpy", **options)(function)

    return decorate


@_compiled()
@no_type_check
def max_distance(vertices, poses, symmetries, lens, projected):
    """Smallest over symmetries of the largest distance between a vertex at the estimate and at the ground truth.

    Args:
        vertices: (3, v) in the model frame.
        poses: (2, 4, 4), estimate and ground truth, camera from model.
        symmetries: (s, 4, 4), model from model.
        lens: (3, 4), applied after the poses: K with a column of zeros for projections, else identity.
        projected: distance between projections in pixels, else between points in space.

    Returns:
        Distance, vertex and symmetry where it is reached; infinity, -1 and -1 where no distance is finite.

    """
    x, y, z = vertices[0], vertices[1], vertices[2]  # slices of rows are contiguous, which slices of the whole are not
    estimate, ground_truth = _chain(lens, poses[0]), _chain(lens, poses[1])
    squared = np.empty(BLOCK)
    # Non-negative doubles are ordered like their bit patterns. Unlike a maximum of doubles, one of integers
    # is compiled to vector instructions, and NaN is above infinity, so it never wins.
    bits = squared.view(np.int64)
    squared[0] = np.inf
    best, best_vertex, best_symmetry = bits[0], -1, -1
    first_block, blocks = 0, (vertices.shape[1] + BLOCK - 1) // BLOCK
    for s in range(len(symmetries)):
        symmetric = _chain(ground_truth, symmetries[s])
        largest, vertex = np.int64(-1), -1
        for k in range(blocks):
            block = (first_block + k) % blocks
            start = block * BLOCK
            stop = min(start + BLOCK, vertices.shape[1])
            if projected:
                _projection_distances(x[start:stop], y[start:stop], z[start:stop], estimate, symmetric, squared)
            else:
                _point_distances(x[start:stop], y[start:stop], z[start:stop], estimate - symmetric, squared)
            peak = np.int64(-1)
            for i in range(stop - start):
                peak = max(peak, bits[i] & _SIGN_OFF)
            if peak > largest:
                largest = peak
                for i in range(stop - start):
                    if bits[i] & _SIGN_OFF == peak:
                        vertex = start + i
            if largest >= best:
                # The vertices that rule out one symmetry mostly rule out the next one too: look there first.
                first_block = block
                break
        if largest < best:
            best, best_vertex, best_symmetry = largest, vertex, s
    bits[0] = best
    return np.sqrt(squared[0]), best_vertex, best_symmetry


@_compiled()
@no_type_check
def _chain(a, b):
    """Product of a (3, 4), taken as affine, and b (4, 4), affine; by hand, since BLAS is slow on such small ones."""
    product = np.empty((3, 4))
    for r in range(3):
        for c in range(4):
            product[r, c] = a[r, 0] * b[0, c] + a[r, 1] * b[1, c] + a[r, 2] * b[2, c]
        product[r, 3] += a[r, 3]
    return product


@_compiled()
@no_type_check
def _point_distances(x, y, z, d, squared):
    """Write |d (x, y, z, 1)|^2 of each vertex, d the difference of two poses (3, 4)."""
    for i in range(len(x)):
        dx = d[0, 0] * x[i] + d[0, 1] * y[i] + d[0, 2] * z[i] + d[0, 3]
        dy = d[1, 0] * x[i] + d[1, 1] * y[i] + d[1, 2] * z[i] + d[1, 3]
        dz = d[2, 0] * x[i] + d[2, 1] * y[i] + d[2, 2] * z[i] + d[2, 3]
        squared[i] = dx * dx + dy * dy + dz * dz


@_compiled()
@no_type_check
def _projection_distances(x, y, z, a, b, squared):
    """Write the squared distance in pixels between the projections of each vertex by a and by b (3, 4)."""
    for i in range(len(x)):
        scale_a = 1.0 / (a[2, 0] * x[i] + a[2, 1] * y[i] + a[2, 2] * z[i] + a[2, 3])
        scale_b = 1.0 / (b[2, 0] * x[i] + b[2, 1] * y[i] + b[2, 2] * z[i] + b[2, 3])
        u_a = (a[0, 0] * x[i] + a[0, 1] * y[i] + a[0, 2] * z[i] + a[0, 3]) * scale_a
        v_a = (a[1, 0] * x[i] + a[1, 1] * y[i] + a[1, 2] * z[i] + a[1, 3]) * scale_a
        u_b = (b[0, 0] * x[i] + b[0, 1] * y[i] + b[0, 2] * z[i] + b[0, 3]) * scale_b
        v_b = (b[1, 0] * x[i] + b[1, 1] * y[i] + b[1, 2] * z[i] + b[1, 3]) * scale_b
        squared[i] = (u_a - u_b) ** 2 + (v_a - v_b) ** 2


@_compiled(fastmath={"reassoc", "contract"})
@no_type_check
def mean_distance(vertices, poses):
    """Mean distance between a vertex at the estimate and at the ground truth; arguments as for `max_distance`."""
    d = poses[0] - poses[1]
    total = 0.0
    for i in range(vertices.shape[1]):
        a, b, c = vertices[0, i], vertices[1, i], vertices[2, i]
        x = d[0, 0] * a + d[0, 1] * b + d[0, 2] * c + d[0, 3]
        y = d[1, 0] * a + d[1, 1] * b + d[1, 2] * c + d[1, 3]
        z = d[2, 0] * a + d[2, 1] * b + d[2, 2] * c + d[2, 3]
        total += np.sqrt(x * x + y * y + z * z)
    return total / vertices.shape[1]
