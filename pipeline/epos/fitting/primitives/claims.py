"""What accepted instances have taken of the image, and what of another pose remains beside them (compiled).

An accepted object is opaque: what its surface covers in the image it takes for itself, except for what lies well before
it; and what lies before it must not cover the pixels that speak for it. So neither the twin of an instance under a
symmetry, which explains the same pixels by their other alternatives, nor a neighbouring local optimum counts as another
instance. The surface is known by the model points of all correspondences.
"""

from typing import Any, NamedTuple, no_type_check

import numpy as np

from pipeline.epos.fitting.primitives.blocks import LANES
from pipeline.epos.fitting.primitives.compiled import compiled
from pipeline.epos.fitting.primitives.grid import cell_at
from pipeline.epos.fitting.primitives.projection import blocks_within, projection, window
from pipeline.epos.fitting.primitives.refinement import make_scratch
from pipeline.epos.fitting.primitives.scoring import nearest, row_of

_SURFACE_POINTS = 2000
"""Points that an object's surface is drawn with, at most."""


_BEFORE = 0.5
"""Radii by which something must lie before an accepted object not to be part of it."""


class Table(NamedTuple):
    """What accepted instances have taken."""

    weight: np.ndarray
    """(b, 16) weights of the pixels."""
    surface: np.ndarray
    """(cells,) depth of the nearest accepted surface in each cell of the grid, metres; infinite for none."""
    cover: np.ndarray
    """(cells,) the same of one pose that is looked at."""
    support: np.ndarray
    """(p,) quality of the accepted instances at each pixel."""
    depth: np.ndarray
    """(p,) their depth there, metres."""
    chosen: np.ndarray
    """(b,) room for blocks."""
    inlier: np.ndarray
    """(p,) room for the pixels of inliers."""
    scratch: Any
    """From `make_scratch`."""


@compiled()
@no_type_check
def make_table(problem, weight):
    """Nothing taken yet."""
    cells, pixels = problem.grid.columns * problem.grid.rows, len(problem.pixels)
    return Table(
        weight,
        np.full(cells, np.inf),
        np.full(cells, np.inf),
        np.zeros(pixels),
        np.zeros(pixels),
        np.empty(len(weight), np.int64),
        np.empty(pixels, np.int64),
        make_scratch(problem.blocks),
    )


@compiled()
@no_type_check
def quality_outside(problem, pose, tau, table):
    """Quality of a pose, and the part of it that can be another instance's than the accepted ones."""
    pixels, grid, before = problem.pixels, problem.grid, _BEFORE * problem.radius
    whole, beside, in_front = 0.0, 0.0, 0.0
    count = _find_inliers(problem, pose, tau, table)
    quality, depth, pixel = table.scratch[0], table.scratch[1], table.inlier
    for i in range(count):
        whole += quality[i]
        surface = table.surface[cell_at(grid, pixels[pixel[i], 0], pixels[pixel[i], 1])]
        if surface == np.inf:
            beside += quality[i]
        elif depth[i] < surface - before:
            in_front += quality[i]
    if in_front > 0.0 and _hidden_support(problem, pose, before, table) > in_front:
        in_front = 0.0
    return whole, beside + in_front


@compiled()
@no_type_check
def take(problem, pose, tau, table):
    """Accept an instance: note the pixels that speak for it, and its surface."""
    count = _find_inliers(problem, pose, tau, table)
    quality, depth, pixel = table.scratch[0], table.scratch[1], table.inlier
    for i in range(count):
        if quality[i] > table.support[pixel[i]]:
            table.support[pixel[i]], table.depth[pixel[i]] = quality[i], depth[i]
    _draw(problem, pose, table.surface)


@compiled()
@no_type_check
def _find_inliers(problem, pose, tau, table):
    """Write pixel, quality and depth of each inlier of a pose; return their number."""
    lens, blocks, chosen, weight = problem.lens, problem.blocks, table.chosen, table.weight
    within = blocks_within(blocks.box, window(lens, pose, problem.radius, tau), chosen)
    error, alternative = table.scratch[0], table.scratch[1]
    nearest(projection(lens, pose), blocks.uv, blocks.xyz, blocks.row, chosen[:within], error, alternative)
    count, at = 0, 0
    for b in chosen[:within]:
        for i in range(LANES):
            e = error[at + i]
            if e < tau * tau and weight[b, i] > 0.0:
                r = row_of(blocks.row, b, alternative[at + i])
                x, y, z = blocks.xyz[r, 0, i], blocks.xyz[r, 1, i], blocks.xyz[r, 2, i]
                # Inliers are written behind the place that is read, into the same arrays.
                error[count] = 1.0 - e / (tau * tau)
                alternative[count] = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
                table.inlier[count] = blocks.pixel[b, i]
                count += 1
        at += LANES
    return count


@compiled()
@no_type_check
def _hidden_support(problem, pose, before, table):
    """Quality of the accepted instances at pixels that this pose, being before them, would hide."""
    table.cover[:] = np.inf
    _draw(problem, pose, table.cover)
    hidden = 0.0
    for p in range(len(table.support)):
        if table.support[p] > 0.0:
            cell = cell_at(problem.grid, problem.pixels[p, 0], problem.pixels[p, 1])
            if table.cover[cell] < table.depth[p] - before:
                hidden += table.support[p]
    return hidden


@compiled()
@no_type_check
def _draw(problem, pose, depths):
    """Lower the depths of the cells that an object covers to that of its surface."""
    lens, points, grid = problem.lens, problem.points, problem.grid
    step = max(1, len(points) // _SURFACE_POINTS)
    for i in range(0, len(points), step):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        a = pose[0, 0] * x + pose[0, 1] * y + pose[0, 2] * z + pose[0, 3]
        b = pose[1, 0] * x + pose[1, 1] * y + pose[1, 2] * z + pose[1, 3]
        depth = pose[2, 0] * x + pose[2, 1] * y + pose[2, 2] * z + pose[2, 3]
        if depth > 0.0:
            u = (lens[0, 0] * a + lens[0, 1] * b) / depth + lens[0, 2]
            cell = cell_at(grid, u, lens[1, 1] * b / depth + lens[1, 2])
            if cell >= 0:
                depths[cell] = min(depths[cell], depth)
