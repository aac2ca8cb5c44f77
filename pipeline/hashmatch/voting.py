"""Which templates the windows of a level vote for (thesis sec. Hypothesis Generation by Hashing-Based Voting)."""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Integer

from pipeline.hashmatch.compiling import compiled
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.hashing import HashTables
from pipeline.hashmatch.templates import reference_points


class Candidates(NamedTuple):
    """Templates that some windows vote for, window after window."""

    windows: Integer[np.ndarray, "n"]
    """Row of the window."""
    templates: Integer[np.ndarray, "n"]
    """Numbered through all objects."""
    votes: Integer[np.ndarray, "n"]


def vote(
    tables: HashTables,
    distance: Float[np.ndarray, "h w"],
    normal_bins: Integer[np.ndarray, "h w"],
    windows: Integer[np.ndarray, "n 2"],
    allowed: Bool[np.ndarray, "n o"],
    config: HashMatchConfig,
) -> Candidates:
    """Up to n templates per window with the most votes, at least m, best first.

    Args:
        tables: Where the templates are.
        distance: Map of a level, metres, 0 where not measured.
        normal_bins: Of the same level.
        windows: First pixel (x, y) of each window.
        allowed: Which objects are looked for in each window.
        config: n and m.

    """
    grid = reference_points(config.grid).astype(np.int64)
    arguments = (tables.triplets, tables.boundaries, tables.starts, tables.ids, tables.objects)
    found = _vote(distance, normal_bins, windows, allowed, grid, *arguments, config.votes_kept, config.votes_needed)
    return Candidates(*found)


@compiled
@no_type_check
def _vote(distance, normal_bins, windows, allowed, grid, triplets, boundaries, starts, ids, objects, kept, needed):
    room = 1024
    out_windows, out_templates, out_votes = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.int16)
    filled = 0
    tables, bins = len(triplets), len(boundaries) + 1
    votes = np.zeros(len(objects), np.uint8)
    touched = np.empty(len(objects), np.int32)
    depth, normal = np.empty(len(grid), np.float32), np.empty(len(grid), np.int64)
    per_count = np.zeros(256, np.int64)
    for w in range(len(windows)):
        for g in range(len(grid)):
            x, y = windows[w, 0] + grid[g, 0], windows[w, 1] + grid[g, 1]
            depth[g] = distance[y, x]
            normal[g] = normal_bins[y, x] if depth[g] > 0 else 255
        count = 0
        for h in range(tables):
            a, b, c = triplets[h, 0], triplets[h, 1], triplets[h, 2]
            if normal[a] == 255 or normal[b] == 255 or normal[c] == 255:
                continue
            first, second = 0, 0
            for boundary in boundaries:
                first += depth[b] - depth[a] >= boundary
                second += depth[c] - depth[a] >= boundary
            key = (((first * bins + second) * 8 + normal[a]) * 8 + normal[b]) * 8 + normal[c]
            for i in range(starts[h, key], starts[h, key + 1]):
                t = ids[i]
                if votes[t] == 0:
                    touched[count] = t
                    count += 1
                votes[t] += 1
        # the least number of votes with which no more than n templates are kept whole; ties go to those touched first
        per_count[:] = 0
        for i in range(count):
            t = touched[i]
            if not allowed[w, objects[t]]:
                votes[t] = 0
            per_count[votes[t]] += 1
        total, limit = 0, 255
        while limit >= needed and total + per_count[limit] <= kept:
            total += per_count[limit]
            limit -= 1
        chosen = np.empty(kept, np.int64)
        n, ties = 0, 0
        for i in range(count):
            t = touched[i]
            v = votes[t]
            tie = v == limit and v >= needed and total + ties < kept
            if v > limit or tie:
                ties += tie
                chosen[n] = (255 - v) * np.int64(2**32) + t
                n += 1
            votes[t] = 0
        ranked = np.sort(chosen[:n])
        if filled + n > room:
            room = 2 * room + n
            out_windows, old = np.empty(room, np.int32), out_windows
            out_windows[:filled] = old[:filled]
            out_templates, old = np.empty(room, np.int32), out_templates
            out_templates[:filled] = old[:filled]
            out_votes, older = np.empty(room, np.int16), out_votes
            out_votes[:filled] = older[:filled]
        for i in range(n):
            out_windows[filled] = w
            out_templates[filled] = ranked[i] & 0xFFFFFFFF
            out_votes[filled] = 255 - (ranked[i] >> 32)
            filled += 1
    return out_windows[:filled], out_templates[:filled], out_votes[:filled]
