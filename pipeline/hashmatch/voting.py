"""Which templates the windows of a level vote for (thesis sec. Hypothesis Generation by Hashing-Based Voting)."""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Integer

from pipeline.hashmatch.channels import NONE
from pipeline.hashmatch.compiling import compiled
from pipeline.hashmatch.config import NORMAL_BINS, HashMatchConfig
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
    found = _vote(
        np.ascontiguousarray(distance).ravel(), np.ascontiguousarray(normal_bins).ravel(), distance.shape[1],
        windows, allowed, grid, tables.triplets, tables.boundaries, tables.starts, tables.ids, len(tables.objects),
        config.votes_kept, config.votes_needed,
    )  # fmt: skip
    return Candidates(*found)


@compiled
@no_type_check
def _vote(
    distance, normal_bins, stride, windows, allowed, grid, triplets, boundaries, starts, ids, templates, kept, needed
):
    room = 1024
    out_windows, out_templates, out_votes = np.empty(room, np.int32), np.empty(room, np.int32), np.empty(room, np.int16)
    filled = 0
    objects = allowed.shape[1]
    votes, touched = np.zeros(templates, np.uint8), np.empty(templates + 1, ids.dtype)
    depth, normal = np.empty(len(grid), np.float32), np.empty(len(grid), np.uint8)
    offsets = grid[:, 1] * stride + grid[:, 0]
    keys = np.empty(len(triplets), np.int64)
    runs = np.empty((objects + 1, 2), np.int64)
    begins, ends = np.empty((2, len(triplets) * (objects // 2 + 1) + 1), np.int64)
    per_count, places = np.zeros(256, np.int64), np.zeros(256, np.int64)
    chosen = np.empty(kept, np.int32)
    for w in range(len(windows)):
        corner = windows[w, 1] * stride + windows[w, 0]
        for g in range(len(grid)):
            depth[g] = distance[corner + offsets[g]]
            normal[g] = normal_bins[corner + offsets[g]] if depth[g] > 0 else NONE
        valid = _keys(depth, normal, triplets, boundaries, keys)
        number = _runs(allowed[w], runs)
        # all ends of lists are looked up before the lists are walked, so that waiting for memory overlaps
        lists = 0
        for h in range(valid):
            for r in range(number):
                begins[lists] = starts[keys[h] * objects + runs[r, 0]]
                ends[lists] = starts[keys[h] * objects + runs[r, 1]]
                lists += begins[lists] < ends[lists]
        count = 0
        for j in range(lists):
            for i in range(begins[j], ends[j]):
                t = ids[i]
                touched[count] = t
                count += votes[t] == 0
                votes[t] += 1
        n = _best(votes, touched, count, kept, needed, per_count, places, chosen)
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
            out_templates[filled] = chosen[i]
            out_votes[filled] = votes[chosen[i]]
            filled += 1
        for i in range(count):
            votes[touched[i]] = 0
    return out_windows[:filled], out_templates[:filled], out_votes[:filled]


@compiled
@no_type_check
def _keys(depth, normal, triplets, boundaries, keys):
    """Number of valid feature vectors, and the key of each, counted through all tables."""
    bins = len(boundaries) + 1
    size = bins**2 * NORMAL_BINS**3
    count = 0
    for h in range(len(triplets)):
        a, b, c = triplets[h, 0], triplets[h, 1], triplets[h, 2]
        first, second = 0, 0
        for boundary in boundaries:
            first += depth[b] - depth[a] >= boundary
            second += depth[c] - depth[a] >= boundary
        i, j, k = np.int64(normal[a]), np.int64(normal[b]), np.int64(normal[c])
        key = (((first * bins + second) * NORMAL_BINS + i) * NORMAL_BINS + j) * NORMAL_BINS + k
        keys[count] = h * size + key
        count += (i | j | k) < NONE
    return count


@compiled
@no_type_check
def _runs(allowed, runs):
    """Number of ranges of objects one after the other that are looked for, and the ends of each."""
    number, inside = 0, False
    for o in range(len(allowed)):
        if allowed[o] and not inside:
            runs[number, 0] = o
        if inside and not allowed[o]:
            runs[number, 1] = o
            number += 1
        inside = allowed[o]
    if inside:
        runs[number, 1] = len(allowed)
        number += 1
    return number


@compiled
@no_type_check
def _best(votes, touched, count, kept, needed, per_count, places, chosen):
    """Choose up to `kept` of the touched templates, most votes first, equal ones by number; how many."""
    per_count[:] = 0
    most = 0
    for i in range(count):
        v = votes[touched[i]]
        per_count[v] += 1
        most = max(most, v)
    # the least number of votes with which no more than n templates are kept whole; ties go to those touched first
    total, limit = 0, most
    while limit >= needed and total + per_count[limit] <= kept:
        places[limit] = total
        total += per_count[limit]
        limit -= 1
    places[limit] = total
    n = total if limit < needed else kept
    ties = n - total
    for i in range(count):
        t = touched[i]
        v = votes[t]
        if v > limit or (v == limit and ties > 0):
            ties -= v == limit
            chosen[places[v]] = t
            places[v] += 1
    first = 0
    for v in range(most, max(limit, needed) - 1, -1):
        _sort(chosen[first : places[v]])
        first = places[v]
    return n


@compiled
@no_type_check
def _sort(values):
    if len(values) > 50:
        values.sort()
        return
    for i in range(1, len(values)):
        value, place = values[i], i
        while place > 0 and values[place - 1] > value:
            values[place] = values[place - 1]
            place -= 1
        values[place] = value
