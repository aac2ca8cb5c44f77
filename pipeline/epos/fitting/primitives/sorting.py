"""Small compiled sorts: numba's own take seconds to compile."""

from typing import no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.compiled import compiled

_DIGIT_BITS = 11


@compiled()
@no_type_check
def order_of(keys, bits):
    """Order that sorts non-negative int64 keys of so many bits; equal keys keep their order (radix sort)."""
    n = len(keys)
    order, spare = np.arange(n), np.empty(n, np.int64)
    starts = np.empty(1 << _DIGIT_BITS, np.int64)
    mask = (1 << _DIGIT_BITS) - 1
    for shift in range(0, bits, _DIGIT_BITS):
        for d in range(len(starts)):
            starts[d] = 0
        for i in range(n):
            starts[(keys[i] >> shift) & mask] += 1
        total = 0
        for d in range(len(starts)):
            count = starts[d]
            starts[d] = total
            total += count
        for i in range(n):
            d = (keys[order[i]] >> shift) & mask
            spare[starts[d]] = order[i]
            starts[d] += 1
        order, spare = spare, order
    return order


@compiled()
@no_type_check
def median(values):
    """Middle one of a few numbers, which are put in order (insertion sort)."""
    for i in range(1, len(values)):
        value = values[i]
        k = i
        while k > 0 and values[k - 1] > value:
            values[k] = values[k - 1]
            k -= 1
        values[k] = value
    return values[len(values) // 2]
