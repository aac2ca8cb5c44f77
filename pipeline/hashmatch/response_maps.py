"""Response maps, which tell at a pixel what is in the square around it (Hinterstoisser et al., CVPR 2011)."""

from typing import no_type_check

import numpy as np
from jaxtyping import UInt8

from pipeline.hashmatch.compiling import compiled


def spread(bits: UInt8[np.ndarray, "h w"], side: int) -> UInt8[np.ndarray, "h w"]:
    """The response map: each pixel has the bits of all pixels in the square around it."""
    return _spread(np.ascontiguousarray(bits), side // 2)


@compiled
@no_type_check
def _spread(bits, reach):
    height, width = bits.shape
    rows = np.zeros_like(bits)
    for v in range(height):
        for shift in range(-reach, reach + 1):
            first, last = max(0, -shift), min(width, width - shift)
            for u in range(first, last):
                rows[v, u] |= bits[v, u + shift]
    result = np.zeros_like(bits)
    for v in range(height):
        for w in range(max(0, v - reach), min(height, v + reach + 1)):
            for u in range(width):
                result[v, u] |= rows[w, u]
    return result
