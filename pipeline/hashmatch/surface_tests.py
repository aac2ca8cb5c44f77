"""The tests T4 and T5 (thesis sec. Multimodal Hypothesis Verification): surface distance and colour.

A matching value is sought in the square of g x g pixels around each point. Maps are flat, with pixels numbered row by
row.
"""

from typing import no_type_check

import numpy as np

from pipeline.hashmatch.channels import HUE_BINS, NONE
from pipeline.hashmatch.compiling import compiled
from pipeline.hashmatch.templates import DISTANCE_UNIT


@compiled
@no_type_check
def surface_tests(
    chosen, failed, fractions, counts, distance, nearest, farthest, hue, masked, some_masked, shape, corners, rows,
    templates, objects, points, normal_counts, point_distances, point_hues, distances, diameters, colored, share,
    distance_share, hue_tolerance, reach, all_tests,
):  # fmt: skip
    """Test the chosen candidates and note the result in `failed` and `fractions`; the shifts (med_delta) of all."""
    shifts = np.full(len(rows), np.nan, np.float32)
    measured, differences = np.empty(256, np.float32), np.empty(256, np.float32)
    for k in chosen:
        t, x0, y0 = templates[k], np.int64(corners[rows[k], 0]), np.int64(corners[rows[k], 1])
        o, total, count = objects[t], np.int64(normal_counts[t]), np.int64(counts[k])
        least = share * count
        missable = 255 if all_tests else count - least
        n = _differences(
            distance, y0 * shape[1] + x0, shape[1], points[t], point_distances[t], total, distances[o],
            measured, differences,
        )  # fmt: skip
        matched = 0
        if n > 0:
            median = _median(differences, n)
            shifts[k] = median
            matched = _near(
                distance, nearest, farthest, masked, some_masked, shape, x0, y0, points[t], point_distances[t], total,
                measured, median + distances[o], distance_share * diameters[o], reach, missable,
            )  # fmt: skip
        if n == 0 or matched < least:
            failed[k] = failed[k] if failed[k] else 4
            if not all_tests:
                fractions[k] = 0
                continue
        fractions[k, 2] = matched / max(count, 1)
        if not colored[o]:
            continue
        matched = _colored_alike(
            hue, masked, some_masked, shape, x0, y0, points[t], point_hues[t], total, hue_tolerance, reach, missable
        )
        if matched < least:
            failed[k] = failed[k] if failed[k] else 5
            if not all_tests:
                fractions[k] = 0
                continue
        fractions[k, 3] = matched / max(count, 1)
    return shifts


@compiled
@no_type_check
def _differences(distance, corner, width, points, stored, total, centroid, measured, differences):
    """Note what is measured at each point, and where something is, how much farther than in the template: how many."""
    n = 0
    stride, start = np.uint64(width), np.uint64(corner)
    for i in range(total):
        d = distance[start + np.uint64(points[i, 1]) * stride + np.uint64(points[i, 0])]
        measured[i] = d
        differences[n] = d - (centroid + stored[i] * DISTANCE_UNIT)
        n += d > 0
    return n


@compiled
@no_type_check
def _median(values, n):
    """The median of the first n values, which are put in another order; several times as fast as sorting them."""
    middle, left, right = n // 2, 0, n
    while True:
        a, b, c = values[left], values[(left + right) // 2], values[right - 1]
        pivot = max(min(a, b), min(max(a, b), c))
        first = _to_front(values, left, right, pivot)
        after = _to_front(values, first, right, np.nextafter(pivot, np.float32(np.inf)))
        if middle < first:
            right = first
        elif middle >= after:
            left = after
        else:
            break
    if n % 2 or first < middle:
        return np.float64(pivot)
    return (values[:middle].max() + pivot) / 2


@compiled
@no_type_check
def _to_front(values, left, right, limit):
    """Put the values below a limit first; where the others begin. Without branches, which would be guessed wrongly."""
    for i in range(left, right):
        value = values[i]
        values[i] = values[left]
        values[left] = value
        left += value < limit
    return left


@compiled
@no_type_check
def _near(
    distance, nearest, farthest, masked, some_masked, shape, x0, y0, points, stored, total, measured, centroid,
    tolerance, reach, missable,
):  # fmt: skip
    """Points around which something is measured where the template, moved by the median, has its surface."""
    matched, missed = 0, 0
    for i in range(total):
        goal = centroid + stored[i] * DISTANCE_UNIT
        if measured[i] > 0 and abs(measured[i] - goal) < tolerance:
            matched += 1
            continue
        x, y = x0 + np.int64(points[i, 0]), y0 + np.int64(points[i, 1])
        at = y * shape[1] + x
        if some_masked and masked[at]:
            continue
        if len(nearest) and (nearest[at] - goal >= tolerance or goal - farthest[at] >= tolerance):
            found = False
        else:
            found = _is_near(distance, shape, x, y, goal, tolerance, reach)
        matched += found
        missed += not found
        if missed > missable:
            break
    return matched


@compiled
@no_type_check
def _is_near(distance, shape, x, y, goal, tolerance, reach):
    left, right = max(0, x - reach), min(shape[1], x + reach + 1)
    found = False
    for v in range(max(0, y - reach), min(shape[0], y + reach + 1)):
        for at in range(v * shape[1] + left, v * shape[1] + right):
            found |= distance[at] > 0 and abs(distance[at] - goal) < tolerance
        if found:
            break
    return found


@compiled
@no_type_check
def _colored_alike(hue, masked, some_masked, shape, x0, y0, points, hues, total, tolerance, reach, missable):
    """Points around which there is a hue like that of the template."""
    matched, missed = 0, 0
    for i in range(total):
        x, y = x0 + np.int64(points[i, 0]), y0 + np.int64(points[i, 1])
        if some_masked and masked[y * shape[1] + x]:
            continue
        found = False
        left, right = max(0, x - reach), min(shape[1], x + reach + 1)
        for v in range(max(0, y - reach), min(shape[0], y + reach + 1)):
            for at in range(v * shape[1] + left, v * shape[1] + right):
                apart = abs(np.int64(hue[at]) - np.int64(hues[i]))
                found |= hue[at] != NONE and min(apart, HUE_BINS - apart) <= tolerance
            if found:
                break
        matched += found
        missed += not found
        if missed > missable:
            break
    return matched
