"""Voting and verification for several objects at once, with masked pixels, against slow references."""

from dataclasses import replace

import numpy as np
import pytest
from hashmatch_parts import CAMERA, COARSE, image_of, looking_at, other_part, part

from pipeline.hashmatch import hashing, templates
from pipeline.hashmatch.channels import NONE
from pipeline.hashmatch.detector import Detector, Matching
from pipeline.hashmatch.level import Level
from pipeline.hashmatch.pyramid import make_level, prepare
from pipeline.hashmatch.rendered_templates import learn
from pipeline.hashmatch.surface_tests import _median
from pipeline.hashmatch.verification import verify
from pipeline.hashmatch.voting import Candidates, vote

IMAGE = image_of(
    (part(), looking_at(0.42, (2.6, 0.3, 0.2), x=-0.06)), (other_part(), looking_at(0.5, (2.0, 0.4, 0.1), x=0.07))
)


@pytest.fixture(scope="module")
def detector() -> Detector:
    return Detector([learn(part(), COARSE, 300.0), learn(other_part(), COARSE, 300.0), learn(part(), COARSE, 300.0)],
                    COARSE)  # fmt: skip


@pytest.fixture(scope="module")
def level(detector: Detector) -> Level:
    return make_level(prepare(IMAGE, detector.edgel_threshold), 0, COARSE)


def slow_votes(
    detector: Detector, level: Level, window: np.ndarray, allowed: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Votes of all templates by comparing keys, and in which order the templates got their first one."""
    x, y = (window + templates.reference_points(12)).T
    depth, bins = level.distance[y, x], level.normal_bins[y, x]
    tables = detector.tables
    distances = np.concatenate([own.grid_distances for own in detector.objects])
    normals = np.concatenate([own.grid_normals for own in detector.objects])
    votes, first = np.zeros(len(distances), int), np.full(len(distances), 10**9)
    for h, (a, b, c) in enumerate(tables.triplets):
        if not (depth[[a, b, c]] > 0).all() or (bins[[a, b, c]] == NONE).any():
            continue
        one, two = (np.searchsorted(tables.boundaries, depth[i] - depth[a], side="right") for i in (b, c))
        key = (((one * 5 + two) * 8 + int(bins[a])) * 8 + int(bins[b])) * 8 + int(bins[c])
        same = hashing.keys_of(distances, normals, tables.triplets[h], tables.boundaries) == key
        same &= allowed[tables.objects]
        votes += same
        first = np.where(same & (first == 10**9), h * len(votes) + np.arange(len(votes)), first)
    return votes, first


@pytest.mark.parametrize("wanted", [(True, True, True), (True, False, True), (False, True, False)])
@pytest.mark.parametrize("kept", [7, 1000])
def test_votes_equal_those_from_comparing_keys(detector: Detector, level: Level, wanted: tuple[bool, ...], kept: int):
    windows = level.windows(5)[::37]
    allowed = np.tile(np.array(wanted), (len(windows), 1))
    found = vote(detector.tables, level.distance, level.normal_bins, windows, allowed,
                 replace(COARSE, votes_kept=kept, votes_needed=2))  # fmt: skip
    assert len(np.unique(found.windows)) > 5
    for w, window in enumerate(windows):
        votes, first = slow_votes(detector, level, window, allowed[w])
        enough = np.flatnonzero(votes >= 2)
        expected = enough[np.lexsort((first[enough], -votes[enough]))][:kept]  # of equal ones those touched first
        expected = expected[np.lexsort((expected, -votes[expected]))]
        own = found.windows == w
        np.testing.assert_array_equal(found.templates[own], expected)
        np.testing.assert_array_equal(found.votes[own], votes[expected])


def test_two_objects_that_are_alike_get_the_same_votes(detector: Detector, level: Level):
    windows = level.windows(5)[::37]
    allowed = np.ones((len(windows), 3), bool)
    found = vote(detector.tables, level.distance, level.normal_bins, windows, allowed,
                 replace(COARSE, votes_kept=1000))  # fmt: skip
    objects = detector.tables.objects[found.templates]
    per_object = [
        set(zip(found.windows[its], found.templates[its] - detector.tables.firsts[o], found.votes[its], strict=True))
        for o, its in ((o, objects == o) for o in (0, 2))
    ]
    assert per_object[0] == per_object[1] != set()


def all_pairs(level: Level, detector: Detector, every: int) -> tuple[np.ndarray, Candidates]:
    """Windows, and some templates of all objects at each."""
    windows = level.windows(5)
    rows = np.repeat(np.arange(len(windows)), 12)
    chosen = np.arange(len(rows)) * every % len(detector.tables.objects)
    return windows, Candidates(rows, chosen.astype(np.int32), np.zeros(len(rows), np.int16))


@pytest.mark.parametrize("hidden", [False, True])
def test_giving_up_early_changes_nothing_for_candidates_that_pass(detector: Detector, hidden: bool):
    masked = np.zeros((CAMERA.height, CAMERA.width), bool)
    masked[60:100, 80:110] = hidden
    level = make_level(prepare(IMAGE, detector.edgel_threshold, masked), 0, COARSE)
    assert level.some_masked == hidden
    lenient = replace(COARSE, matches_needed=0.4, scale_factor=4.0)
    windows, candidates = all_pairs(level, detector, 7)
    whole = verify(detector.points, level, windows, candidates, 1.0, lenient, all_tests=True)
    stopped = verify(detector.points, level, windows, candidates, 1.0, lenient)
    np.testing.assert_array_equal(whole.failed, stopped.failed)
    assert np.bincount(whole.failed, minlength=6).min() > 0
    passed = whole.failed == 0
    for name in ("fractions", "shifts", "known"):
        np.testing.assert_array_equal(getattr(whole, name)[passed], getattr(stopped, name)[passed])
    assert not stopped.fractions[~passed].any()
    assert (whole.fractions[passed] >= 0.4 - 1e-6).all()
    assert (whole.known[passed] < 1).any() == hidden


def test_fractions_with_masked_pixels_are_of_the_others(detector: Detector):
    masked = np.zeros((CAMERA.height, CAMERA.width), bool)
    masked[60:100, 80:110] = True
    level = make_level(prepare(IMAGE, detector.edgel_threshold, masked), 0, COARSE)
    windows, candidates = all_pairs(level, detector, 7)
    found = verify(detector.points, level, windows, candidates, 1.0, COARSE, all_tests=True)
    points = detector.points
    for k in np.random.default_rng(0).choice(len(candidates.windows), 200, replace=False):
        t, (x0, y0) = candidates.templates[k], windows[candidates.windows[k]]
        for number, at, bits, count, response in (
            (0, points.normal_points, points.normal_bits, points.normal_counts, level.normal_response),
            (1, points.gradient_points, points.gradient_bits, points.gradient_counts, level.gradient_response),
        ):
            x, y = (at[t, : count[t]].astype(int) + np.array([x0, y0])).T
            seen = ~level.masked[y, x]
            matched = ((response[y, x] & bits[t, : count[t]]) != 0)[seen]
            assert found.fractions[k, number] == pytest.approx(matched.mean() if seen.any() else 0.0)


def test_limits_of_distance_spare_searches_but_change_nothing(
    detector: Detector, level: Level, monkeypatch: pytest.MonkeyPatch
):
    windows, candidates = all_pairs(level, detector, 5)
    found = []
    for pixels in (0, 10**9):  # never, always
        monkeypatch.setattr("pipeline.hashmatch.verification._PIXELS_PER_TEST", pixels)
        found.append(verify(detector.points, level, windows, candidates, 1.0, COARSE, all_tests=True))
    np.testing.assert_array_equal(found[0].fractions, found[1].fractions)
    assert 0 < found[0].fractions[:, 2].mean() < 1


def test_limits_of_distance_are_those_of_the_square_around(level: Level):
    nearest, farthest = level.distance_limits
    for v, u in np.random.default_rng(0).integers((0, 0), level.distance.shape, (200, 2)):
        square = level.distance[max(0, v - 2) : v + 3, max(0, u - 2) : u + 3]
        measured = square[square > 0]
        assert nearest[v, u] == (measured.min() if len(measured) else np.finfo(np.float32).max)
        assert farthest[v, u] == square.max()


@pytest.mark.parametrize("count", [1, 2, 3, 10, 99, 100])
def test_the_median_is_that_of_numpy(count: int):
    rng = np.random.default_rng(count)
    many = (rng.normal(size=count), rng.integers(3, size=count), np.full(count, 0.25), np.arange(count)[::-1])
    for values in many:
        values = values.astype(np.float32)
        assert _median(values.copy(), count) == np.median(values)


def test_threads_change_nothing(detector: Detector):
    def columns(threads: int) -> tuple[Matching, dict[str, np.ndarray]]:
        found = Detector(detector.objects, replace(COARSE, threads=threads)).match(IMAGE)
        return found, vars(found.detections)

    one, two = columns(1), columns(2)
    assert len(one[0].detections) > 10
    for name, values in one[1].items():
        np.testing.assert_array_equal(values, two[1][name])
    for own, other in zip(one[0].levels, two[0].levels, strict=True):
        for values, others in zip(own.candidates, other.candidates, strict=True):
            np.testing.assert_array_equal(values, others)
    assert set(one[0].seconds) == {"pyramid", "objectness", "hashing", "verification", "nms"}
