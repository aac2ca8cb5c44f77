"""Multimodal hypothesis verification: the tests T1 to T5 (thesis sec. Multimodal Hypothesis Verification)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Integer

from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.level import Level
from pipeline.hashmatch.orientation_tests import orientation_tests
from pipeline.hashmatch.surface_tests import surface_tests
from pipeline.hashmatch.template_store import TemplateStore
from pipeline.hashmatch.templates import size_points
from pipeline.hashmatch.voting import Candidates

LEAST_KNOWN = 0.25
"""Share of the points of T2 that must not be masked."""

_PIXELS_PER_TEST = 300
"""T4 is made faster by as much as the limits of so many pixels cost."""

_NO_LIMITS = np.zeros(0, np.float32)

TESTS = ("T1 size", "T2 normals", "T3 gradients", "T4 surface distance", "T5 color")


class Verified(NamedTuple):
    """What the tests say about some candidates."""

    failed: Integer[np.ndarray, "n"]
    """Number of the first test that failed, 1 to 5; 0 where all are passed."""
    fractions: Float[np.ndarray, "n 4"]
    """c_i: share of matching points in T2 to T5; of tests that were not made, 0. Unless all tests are made, a failed
    candidate has none: its points are counted only until it is clear that it fails."""
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
    shared = (level.masked.ravel(), level.some_masked)
    failed, fractions, counts = orientation_tests(
        level.distance.ravel(), level.normal_response.ravel(), level.gradient_response.ravel(), *shared,
        level.distance.shape[1], windows, candidates.windows, candidates.templates, size_points(), scale,
        points.expected, points.normal_points, points.normal_bits, points.normal_counts, points.gradient_points,
        points.gradient_bits, points.gradient_counts, np.sqrt(config.scale_factor), config.matches_needed, LEAST_KNOWN,
        all_tests,
    )  # fmt: skip
    chosen = np.arange(len(failed)) if all_tests else np.flatnonzero(failed == 0)
    limits = level.distance_limits if len(chosen) * _PIXELS_PER_TEST > level.distance.size else (_NO_LIMITS, _NO_LIMITS)
    shifts = surface_tests(
        chosen, failed, fractions, counts, level.distance.ravel(), *(limit.ravel() for limit in limits),
        level.hue.ravel(), *shared, level.distance.shape, windows, candidates.windows, candidates.templates,
        points.objects, points.normal_points, points.normal_counts, points.point_distances, points.point_hues,
        points.distances, points.diameters, points.colored, config.matches_needed, config.distance_tolerance,
        config.hue_tolerance_deg / 2, level.neighborhood // 2, all_tests,
    )  # fmt: skip
    known = counts / np.maximum(points.normal_counts[candidates.templates], 1)
    return Verified(failed, fractions, shifts, known.astype(np.float32))
