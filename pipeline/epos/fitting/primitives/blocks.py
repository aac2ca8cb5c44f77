"""Correspondences laid out for scoring: blocks of 16 pixels near each other, the alternatives of a block in rows of 16.

A pose is scored for 16 pixels at once, and blocks that the projected object cannot reach are skipped. Points are
float32 relative to the object's centre, which keeps projections exact to 1e-4 px.
"""

from typing import NamedTuple, no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.compiled import compiled
from pipeline.epos.fitting.primitives.sorting import order_of

LANES = 16
"""Pixels in a block: as many float32 as the widest vector registers hold."""


_TILE_PX = 64.0
"""Pixels are sorted by square tiles of this side, so that blocks are compact: at stride 4 a tile has four."""


_FAR = 1e9
"""Where lanes without a pixel are put, so that nothing projects near them."""


class Blocks(NamedTuple):
    """b blocks of 16 pixels with r rows of alternatives."""

    uv: np.ndarray
    """(b, 2, 16) float32 pixel coordinates."""
    pixel: np.ndarray
    """(b, 16) int64 pixel of each lane, -1 for none."""
    row: np.ndarray
    """(b + 1,) first row of each block."""
    xyz: np.ndarray
    """(r, 3, 16) float32 model points less the centre; a pixel with fewer alternatives than its block repeats one."""
    source: np.ndarray
    """(r, 16) int64 correspondence of each lane, -1 for none."""
    box: np.ndarray
    """(b, 4) float32 smallest and largest u, smallest and largest v."""
    place: np.ndarray
    """(pixels,) block * 16 + lane of each pixel."""


@compiled()
@no_type_check
def make_blocks(pixels, points, first):
    """Lay out correspondences that are sorted by pixel.

    Args:
        pixels: (p, 2) u, v of each pixel.
        points: (n, 3) model points less the object's centre.
        first: (p + 1,) first correspondence of each pixel.

    """
    order = _pixel_order(pixels, first)
    count = len(pixels)
    blocks = (count + LANES - 1) // LANES
    row = np.zeros(blocks + 1, np.int64)
    for i in range(count):
        block = i // LANES
        row[block + 1] = max(row[block + 1], first[order[i] + 1] - first[order[i]])
    for b in range(blocks):
        row[b + 1] += row[b]
    made = _empty(blocks, row, count)
    for i in range(count):
        _put(made, i // LANES, i % LANES, order[i], pixels, points, first)
    return made


@compiled()
@no_type_check
def _pixel_order(pixels, first):
    """Pixels along a Z-shaped curve of tiles, in a tile by their number of alternatives (rising and falling by turns)."""
    count = len(pixels)
    key = np.empty(count, np.int64)
    left, top = np.inf, np.inf
    for i in range(count):
        left, top = min(left, pixels[i, 0]), min(top, pixels[i, 1])
    for i in range(count):
        column = min(np.int64((pixels[i, 0] - left) / _TILE_PX), 0x7FFF)
        line = min(np.int64((pixels[i, 1] - top) / _TILE_PX), 0x7FFF)
        alternatives = min(first[i + 1] - first[i], 0xFF)
        if (column + line) % 2:
            alternatives = 0xFF - alternatives
        key[i] = (_spread(column) | _spread(line) << 1) << 8 | alternatives
    return order_of(key, 40)


@compiled()
@no_type_check
def _spread(bits):
    """Put a zero between the 16 bits of a number."""
    bits = (bits | bits << 8) & 0x00FF00FF
    bits = (bits | bits << 4) & 0x0F0F0F0F
    bits = (bits | bits << 2) & 0x33333333
    return (bits | bits << 1) & 0x55555555


@compiled()
@no_type_check
def _empty(blocks, row, count):
    box = np.empty((blocks, 4), np.float32)
    for b in range(blocks):
        box[b, 0] = box[b, 2] = np.inf
        box[b, 1] = box[b, 3] = -np.inf
    return Blocks(
        np.full((blocks, 2, LANES), np.float32(_FAR)),
        np.full((blocks, LANES), -1),
        row,
        np.zeros((row[-1], 3, LANES), np.float32),
        np.full((row[-1], LANES), -1),
        box,
        np.empty(count, np.int64),
    )


@compiled()
@no_type_check
def _put(blocks, b, lane, pixel, pixels, points, first):
    u, v = np.float32(pixels[pixel, 0]), np.float32(pixels[pixel, 1])
    blocks.uv[b, 0, lane], blocks.uv[b, 1, lane], blocks.pixel[b, lane] = u, v, pixel
    blocks.place[pixel] = b * LANES + lane
    blocks.box[b, 0], blocks.box[b, 1] = min(blocks.box[b, 0], u), max(blocks.box[b, 1], u)
    blocks.box[b, 2], blocks.box[b, 3] = min(blocks.box[b, 2], v), max(blocks.box[b, 3], v)
    last = first[pixel + 1] - 1
    for r in range(blocks.row[b], blocks.row[b + 1]):
        source = min(first[pixel] + r - blocks.row[b], last)
        for c in range(3):
            blocks.xyz[r, c, lane] = points[source, c]
        blocks.source[r, lane] = source


@compiled()
@no_type_check
def pixel_weights(blocks):
    """(b, 16) float32, 1 for lanes with a pixel and 0 for those without."""
    weight = np.empty(blocks.pixel.shape, np.float32)
    for b in range(len(weight)):
        for i in range(LANES):
            weight[b, i] = np.float32(blocks.pixel[b, i] >= 0)
    return weight
