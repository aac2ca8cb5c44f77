"""By how much candidates passed the tests or failed them; matching itself counts only until it is clear that one fails."""

from typing import no_type_check

import numpy as np
from jaxtyping import Float, Integer

from pipeline.hashmatch.compiling import compiled
from pipeline.hashmatch.detector import Detector, LevelMatches
from pipeline.hashmatch.verification import verify
from pipeline.hashmatch.voting import Candidates


def fractions_of(detector: Detector, matched: LevelMatches, rows: Integer[np.ndarray, "n"]) -> Float[np.ndarray, "n 4"]:
    """Shares of matching points in T2 to T5 of some candidates of a level, float32, 0 in tests after a failed one."""
    failed = matched.verified.failed[rows]
    fractions = matched.verified.fractions[rows].copy()
    windows, templates = matched.candidates.windows[rows], matched.candidates.templates[rows]
    level, points = matched.level, detector.points
    for test, response, at, bits, counts in (
        (2, level.normal_response, points.normal_points, points.normal_bits, points.normal_counts),
        (3, level.gradient_response, points.gradient_points, points.gradient_bits, points.gradient_counts),
    ):
        its = (failed >= test) & (failed <= 3)
        corners = matched.windows[windows[its]]
        fractions[its, test - 2] = _shares(response, level.masked, corners, templates[its], at, bits, counts)
    late = np.flatnonzero(failed > 3)  # few, and slow
    if len(late):
        each = Candidates(windows[late], templates[late], matched.candidates.votes[rows[late]])
        tested = verify(points, level, matched.windows, each, matched.scale, detector.config, all_tests=True)
        fractions[late] = np.where(np.arange(2, 6) <= failed[late, None], tested.fractions, 0)
    return fractions


@compiled
@no_type_check
def _shares(response, masked, corners, templates, points, bits, counts):
    shares = np.zeros(len(templates), np.float32)
    for k in range(len(templates)):
        t, known, alike = templates[k], 0, 0
        for i in range(counts[t]):
            x, y = corners[k, 0] + points[t, i, 0], corners[k, 1] + points[t, i, 1]
            known += not masked[y, x]
            alike += (response[y, x] & bits[t, i]) != 0 and not masked[y, x]
        shares[k] = alike / max(known, 1)
    return shares
