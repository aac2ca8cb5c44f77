"""The tests T1 to T3 (thesis sec. Multimodal Hypothesis Verification): size, surface normals, image gradients.

Most candidates end here. Maps are flat, with pixels numbered row by row, as unsigned numbers need no check of their sign.
"""

from typing import no_type_check

import numpy as np

from pipeline.hashmatch.compiling import compiled


@compiled
@no_type_check
def orientation_tests(
    distance, normal_response, gradient_response, masked, some_masked, width, corners, rows, templates, size_points,
    scale, expected, normal_points, normal_bits, normal_counts, gradient_points, gradient_bits, gradient_counts,
    size_tolerance, share, least_known, all_tests,
):  # fmt: skip
    """Of each candidate: first of T1 to T3 that fails or 0, fractions of T2 to T5 so far, unmasked points of T2."""
    failed, fractions = np.zeros(len(rows), np.uint8), np.zeros((len(rows), 4), np.float32)
    counts = normal_counts[templates].astype(np.int32)
    measured = np.empty(len(size_points), np.float32)
    stride, corner, last = np.uint64(width), np.uint64(0), -1
    for k in range(len(rows)):
        t = templates[k]
        if rows[k] != last:
            last = rows[k]
            corner = np.uint64(corners[last, 1]) * stride + np.uint64(corners[last, 0])
            for i in range(len(size_points)):
                measured[i] = distance[corner + np.uint64(size_points[i, 1]) * stride + np.uint64(size_points[i, 0])]
        if not _has_size(measured, scale * expected[t, 0] + expected[t, 1], size_tolerance):
            failed[k] = 1
            if not all_tests:
                continue
        total = np.int64(normal_counts[t])
        if some_masked:
            counts[k] = _unmasked(masked, corner, stride, normal_points[t], total)
        least = share * counts[k]
        missable = 255 if all_tests else total - least
        matched = _matching(normal_response, corner, stride, normal_points[t], normal_bits[t], total, missable)
        if matched < least or counts[k] == 0 or counts[k] < least_known * total:
            failed[k] = failed[k] if failed[k] else 2
            if not all_tests:
                continue
        fractions[k, 0] = matched / max(counts[k], 1)
        total = np.int64(gradient_counts[t])
        count = _unmasked(masked, corner, stride, gradient_points[t], total) if some_masked else total
        least = share * count
        missable = 255 if all_tests else total - least
        matched = _matching(gradient_response, corner, stride, gradient_points[t], gradient_bits[t], total, missable)
        if matched < least:
            failed[k] = failed[k] if failed[k] else 3
            if not all_tests:
                fractions[k, 0] = 0
                continue
        fractions[k, 1] = matched / max(count, 1)
    return failed, fractions, counts


@compiled
@no_type_check
def _has_size(measured, expected, tolerance):
    """T1: whether the distance at one of the five points is as expected."""
    passed = False
    for d in measured:
        passed |= d > 0 and expected / tolerance <= d and d <= expected * tolerance
    return passed


@compiled
@no_type_check
def _unmasked(masked, corner, stride, points, total):
    count = 0
    for i in range(total):
        count += not masked[corner + np.uint64(points[i, 1]) * stride + np.uint64(points[i, 0])]
    return count


@compiled
@no_type_check
def _matching(response, corner, stride, points, bits, total, missable):
    """Points at which a template's bits are in the response map, which has none at masked pixels.

    It counts no further, and so too few, once more are missed than may be.
    """
    missed, i = 0, 0
    while i + 4 <= total and missed <= missable:
        for j in range(i, i + 4):  # of constant length: compiled without a loop
            at = corner + np.uint64(points[j, 1]) * stride + np.uint64(points[j, 0])
            missed += (response[at] & bits[j]) == 0
        i += 4
    while i < total and missed <= missable:
        at = corner + np.uint64(points[i, 1]) * stride + np.uint64(points[i, 0])
        missed += (response[at] & bits[i]) == 0
        i += 1
    return i - missed
