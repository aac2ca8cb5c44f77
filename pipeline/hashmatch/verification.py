"""Multimodal hypothesis verification: the tests T1 to T5 (thesis sec. Multimodal Hypothesis Verification)."""

from typing import NamedTuple, no_type_check

import numpy as np
from jaxtyping import Bool, Float, Integer

from pipeline.hashmatch.channels import NONE
from pipeline.hashmatch.compiling import compiled
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.pyramid import Level
from pipeline.hashmatch.template_store import TemplateStore
from pipeline.hashmatch.templates import DISTANCE_UNIT, size_points
from pipeline.hashmatch.voting import Candidates

LEAST_KNOWN = 0.25
"""Share of the points of T2 that must not be masked."""

TESTS = ("T1 size", "T2 normals", "T3 gradients", "T4 surface distance", "T5 color")


class Verified(NamedTuple):
    """What the tests say about some candidates."""

    failed: Integer[np.ndarray, "n"]
    """Number of the first test that failed, 1 to 5; 0 where all are passed."""
    fractions: Float[np.ndarray, "n 4"]
    """c_i: share of matching points in T2 to T5; of the tests that were not made, 0."""
    shifts: Float[np.ndarray, "n"]
    """med_delta: median of measured minus template distance, metres; NaN before T4."""
    known: Float[np.ndarray, "n"]
    """Share of the points of T2 that are not masked; the fractions are of these."""

    @property
    def scores(self) -> Float[np.ndarray, "n"]:
        """c: the sum of the fractions."""
        return self.fractions.sum(axis=1)


def objects_of_size(
    level: Level, windows: Integer[np.ndarray, "n 2"], ranges: Float[np.ndarray, "o 2"]
) -> Bool[np.ndarray, "n o"]:
    """Which objects could pass T1 in each window: those seen at a fitting distance at one of the five points."""
    found = np.zeros((len(windows), len(ranges)), bool)
    for x, y in size_points():
        measured = level.distance[windows[:, 1] + y, windows[:, 0] + x][:, None]
        found |= (measured > 0) & (measured >= ranges[:, 0]) & (measured <= ranges[:, 1])
    return found


def verify(
    points: TemplateStore,
    level: Level,
    windows: Integer[np.ndarray, "n 2"],
    candidates: Candidates,
    scale: float,
    config: HashMatchConfig,
    all_tests: bool = False,
) -> Verified:
    """Test candidates one after the other; a test is made if those before it are passed.

    Args:
        points: Of the templates.
        level: Where the windows are.
        windows: First pixel (x, y) of each window.
        candidates: Which template to test in which window.
        scale: s_w, times the focal length of the templates by that of the image.
        config: Tolerances.
        all_tests: Make the tests after a failed one, too (for tracing).

    """
    tolerances = np.array([
        np.sqrt(config.scale_factor), config.matches_needed, config.distance_tolerance, config.hue_tolerance_deg / 2,
        LEAST_KNOWN,
    ])  # fmt: skip
    found = _verify(
        level.distance, level.normal_response, level.gradient_response, level.hue, level.masked,
        windows, candidates.windows, candidates.templates, size_points(), scale,
        points.expected, points.objects, points.normal_points, points.normal_bits, points.point_distances,
        points.point_hues, points.normal_counts, points.gradient_points, points.gradient_bits, points.gradient_counts,
        points.distances, points.diameters, points.colored, tolerances, config.neighborhood_px // 2, all_tests,
    )  # fmt: skip
    return Verified(*found)


@compiled
@no_type_check
def _verify(
    distance, normal_response, gradient_response, hue, masked, windows, rows, templates, size_points, scale,
    expected, objects, normal_points, normal_bits, point_distances, point_hues, normal_counts,
    gradient_points, gradient_bits, gradient_counts, distances, diameters, colored, tolerances, reach, all_tests,
):  # fmt: skip
    failed = np.zeros(len(rows), np.uint8)
    fractions = np.zeros((len(rows), 4), np.float32)
    shifts = np.full(len(rows), np.nan, np.float32)
    known = np.ones(len(rows), np.float32)
    size_tolerance, share, distance_share, hue_tolerance, least_known = tolerances
    deltas = np.empty(256, np.float32)
    for k in range(len(rows)):
        x0, y0, t = windows[rows[k], 0], windows[rows[k], 1], templates[k]
        o = objects[t]
        # T1: object size
        e = scale * expected[t, 0] + expected[t, 1]
        passed = False
        for i in range(5):
            d = distance[y0 + size_points[i, 1], x0 + size_points[i, 0]]
            passed |= d > 0 and e / size_tolerance <= d and d <= e * size_tolerance
        if not passed:
            failed[k] = 1
            if not all_tests:
                continue
        # T2: surface normals
        total = np.int64(normal_counts[t])
        count, matched = 0, 0
        for i in range(total):
            x, y = x0 + normal_points[t, i, 0], y0 + normal_points[t, i, 1]
            count += not masked[y, x]
            matched += (normal_response[y, x] & normal_bits[t, i]) != 0 and not masked[y, x]
        known[k] = count / max(total, 1)
        fractions[k, 0] = matched / max(count, 1)
        if matched < share * count or count == 0 or count < least_known * total:
            failed[k] = failed[k] if failed[k] else 2
            if not all_tests:
                continue
        # T3: image gradients
        number, matched = 0, 0
        for i in range(np.int64(gradient_counts[t])):
            x, y = x0 + gradient_points[t, i, 0], y0 + gradient_points[t, i, 1]
            number += not masked[y, x]
            matched += (gradient_response[y, x] & gradient_bits[t, i]) != 0 and not masked[y, x]
        fractions[k, 1] = matched / max(number, 1)
        if matched < share * number:
            failed[k] = failed[k] if failed[k] else 3
            if not all_tests:
                continue
        # T4: surface distance, relative to the median difference
        n = 0
        for i in range(total):
            d = distance[y0 + normal_points[t, i, 1], x0 + normal_points[t, i, 0]]
            if d > 0:
                deltas[n] = d - (distances[o] + point_distances[t, i] * 1e-4)
                n += 1
        if n > 0:
            ordered = np.sort(deltas[:n])
            median = ordered[n // 2] if n % 2 else (ordered[n // 2 - 1] + ordered[n // 2]) / 2
            shifts[k] = median
            tolerance = distance_share * diameters[o]
            matched = 0
            for i in range(total):
                x, y = x0 + normal_points[t, i, 0], y0 + normal_points[t, i, 1]
                if masked[y, x]:
                    continue
                goal = median + distances[o] + point_distances[t, i] * 1e-4
                found = False
                for v in range(max(0, y - reach), min(distance.shape[0], y + reach + 1)):
                    for u in range(max(0, x - reach), min(distance.shape[1], x + reach + 1)):
                        d = distance[v, u]
                        found |= d > 0 and abs(d - goal) < tolerance
                    if found:
                        break
                matched += found
            fractions[k, 2] = matched / max(count, 1)
        if n == 0 or matched < share * count:
            failed[k] = failed[k] if failed[k] else 4
            if not all_tests:
                continue
        # T5: surface colour
        if not colored[o]:
            continue
        matched = 0
        for i in range(total):
            x, y = x0 + normal_points[t, i, 0], y0 + normal_points[t, i, 1]
            if masked[y, x]:
                continue
            found = False
            for v in range(max(0, y - reach), min(distance.shape[0], y + reach + 1)):
                for u in range(max(0, x - reach), min(distance.shape[1], x + reach + 1)):
                    h = hue[v, u]
                    if h != 255:
                        apart = abs(np.int64(h) - np.int64(point_hues[t, i]))
                        found |= min(apart, 180 - apart) <= hue_tolerance
                if found:
                    break
            matched += found
        fractions[k, 3] = matched / max(count, 1)
        if matched < share * count:
            failed[k] = failed[k] if failed[k] else 5
    return failed, fractions, shifts, known


assert DISTANCE_UNIT == 1e-4  # the compiled loops have these as numbers
assert NONE == 255
