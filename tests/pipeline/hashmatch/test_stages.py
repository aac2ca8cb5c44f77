"""Each stage of the cascade against a slow, obviously right reference on small inputs."""

from dataclasses import replace

import numpy as np
import pytest
from hashmatch_parts import CAMERA, COARSE, image_of, looking_at, part

from pipeline.hashmatch import hashing, nms, objectness, templates
from pipeline.hashmatch.channels import NONE
from pipeline.hashmatch.detector import Detector
from pipeline.hashmatch.poses import centroid_distance, pose_at_window, rotation_to_ray
from pipeline.hashmatch.pyramid import Level, level_indices, make_level, prepare
from pipeline.hashmatch.rendered_templates import learn
from pipeline.hashmatch.template_store import size_ranges
from pipeline.hashmatch.verification import verify
from pipeline.hashmatch.views import CENTER, render_views
from pipeline.hashmatch.voting import Candidates, vote
from pipeline.rendering import render

POSE = looking_at(0.42, (2.6, 0.3, 0.2))


@pytest.fixture(scope="module")
def detector() -> Detector:
    return Detector([learn(part(), COARSE, 300.0)], COARSE)


@pytest.fixture(scope="module")
def level(detector: Detector) -> Level:
    return make_level(prepare(image_of((part(), POSE)), detector.edgel_threshold), 0, COARSE)


def test_edgels_are_at_depth_steps_larger_than_tau():
    depth = np.full((20, 30), 0.6, np.float32)
    depth[:, 15:] += 0.02
    found = objectness.edgels(depth, 0.03)  # a step of 20 mm answers with 80 mm
    assert found[:, 14:16].all()
    assert found.sum() == 40
    assert not objectness.edgels(depth, 0.1).any()
    assert not objectness.edgels(np.zeros((20, 30), np.float32), 0.03).any()


def test_edgels_are_counted_as_one_by_one(level: Level):
    windows = level.windows(5)
    counts = level.edgel_counts(windows)
    for i in np.random.default_rng(0).integers(len(windows), size=30):
        x, y = windows[i]
        assert counts[i] == level.edgel[y : y + 108, x : x + 108].sum()
    assert counts.max() > 0


def test_windows_cover_the_level_in_steps(level: Level):
    windows = level.windows(5)
    assert windows[:, 0].max() + 108 <= level.distance.shape[1] < windows[:, 0].max() + 108 + 5
    centers = make_level(prepare(image_of((part(), POSE)), 0.05), 2, COARSE).centers(np.array([[0, 0]]))
    np.testing.assert_allclose((centers[0] + 0.5) * 1.44 - 0.5, 53.5 - COARSE.overhang_px)


def test_levels_are_added_for_objects_near_by_and_far_away(detector: Detector):
    base = prepare(image_of((part(), POSE), background=5.0), 0.05)
    assert level_indices(base, detector.objects, replace(COARSE, fit_scales=False)) == [-2, -1, 0, 1, 2]
    assert level_indices(base, detector.objects, COARSE)[-1] > 2


def test_depth_bins_are_equally_frequent(detector: Detector):
    own, tables = detector.objects[0], detector.tables
    differences = []
    for first, *others in tables.triplets:
        for other in others:
            a, b = own.grid_distances[:, first], own.grid_distances[:, other]
            both = (a != templates.NO_DISTANCE) & (b != templates.NO_DISTANCE)
            differences.append((b[both].astype(int) - a[both]) * templates.DISTANCE_UNIT)
    triplets = tables.triplets
    boundaries = hashing.equal_frequency_boundaries(own.grid_distances, triplets, 5)
    shares = np.bincount(np.searchsorted(boundaries, np.concatenate(differences), side="right"), minlength=5)
    np.testing.assert_allclose(shares / shares.sum(), 0.2, atol=0.02)


def test_entropy_of_keys():
    assert hashing.surprisal(np.array([3, 3, 5, 5])).mean() == 1.0
    assert hashing.surprisal(np.array([1, 2, 3, 4])).tolist() == [2.0] * 4
    assert hashing.surprisal(np.array([7, 7, 7, 7])).tolist() == [0.0] * 4
    assert hashing.surprisal(np.array([-1, -1, 4, 4])).tolist() == [0.0, 0.0, 1.0, 1.0]  # invalid ones tell nothing


def test_the_triplet_with_the_largest_entropy_is_chosen_first_and_useless_ones_last(detector: Detector):
    own = detector.objects[0]
    rng = np.random.default_rng(0)
    triplets = hashing.random_triplets(own.grid_normals != NONE, 300, rng)
    empty = np.flatnonzero((own.grid_normals == NONE).all(axis=0))[:3]
    triplets[0] = empty if len(empty) == 3 else triplets[0]
    boundaries = hashing.equal_frequency_boundaries(own.grid_distances, triplets, 5)
    chosen, entropies = hashing.most_informative(own.grid_distances, own.grid_normals, triplets, boundaries, 40)
    each = [
        hashing.surprisal(hashing.keys_of(own.grid_distances, own.grid_normals, triplet, boundaries)).mean()
        for triplet in triplets
    ]
    assert entropies[0] == pytest.approx(max(each), rel=1e-6)
    assert entropies.mean() > np.mean(each)
    assert len(np.unique(chosen, axis=0)) == 40


def test_all_templates_are_in_some_table_and_keys_are_in_range(detector: Detector):
    tables, own = detector.tables, detector.objects[0]
    assert tables.starts.shape == (100 * 5**2 * 8**3 + 1,)
    assert set(tables.ids.tolist()) == set(range(len(own)))
    key = hashing.keys_of(own.grid_distances, own.grid_normals, tables.triplets[0], tables.boundaries)
    for template in (0, 50, 107):
        bucket = tables.ids[tables.starts[key[template]] : tables.starts[key[template] + 1]]
        assert (template in bucket) == (key[template] >= 0)


def slow_votes(detector: Detector, level: Level, window: np.ndarray) -> np.ndarray:
    tables, own = detector.tables, detector.objects[0]
    x, y = (window + templates.reference_points(12)).T
    depth, bins = level.distance[y, x], level.normal_bins[y, x]
    votes = np.zeros(len(own), int)
    for h, (a, b, c) in enumerate(tables.triplets):
        if (depth[[a, b, c]] > 0).all() and (bins[[a, b, c]] != NONE).all():
            first, second = (np.searchsorted(tables.boundaries, depth[i] - depth[a], side="right") for i in (b, c))
            key = (((first * 5 + second) * 8 + int(bins[a])) * 8 + int(bins[b])) * 8 + int(bins[c])
            row = h * 5**2 * 8**3 + key
            votes[tables.ids[tables.starts[row] : tables.starts[row + 1]]] += 1
    return votes


def test_votes_equal_those_counted_one_by_one(detector: Detector, level: Level):
    windows = level.windows(5)
    near = np.abs(level.centers(windows) - CAMERA.K[:2, 2]).max(axis=1) < 12
    windows = windows[near]
    config = replace(COARSE, votes_kept=10, votes_needed=3)
    found = vote(detector.tables, level.distance, level.normal_bins, windows, np.ones((len(windows), 1), bool), config)
    assert found.votes.max() > 3
    for w, window in enumerate(windows):
        expected = slow_votes(detector, level, window)
        own = found.templates[found.windows == w]
        counts = found.votes[found.windows == w]
        np.testing.assert_array_equal(counts, expected[own])
        best = np.sort(expected[expected >= 3])[::-1][:10]
        np.testing.assert_array_equal(counts, best)  # the best ones, in order


def test_missing_depth_and_unwanted_objects_get_no_votes(detector: Detector, level: Level):
    windows = level.windows(5)[:50]
    nothing = np.zeros_like(level.distance)
    allowed = np.ones((50, 1), bool)
    assert not len(vote(detector.tables, nothing, level.normal_bins, windows, allowed, COARSE).windows)
    every = level.windows(5)
    found = vote(detector.tables, level.distance, level.normal_bins, every, np.zeros((len(every), 1), bool), COARSE)
    assert not len(found.windows)


def slow_verify(detector: Detector, level: Level, window: np.ndarray, t: int) -> tuple[bool, list[float]]:
    """T1 passed, and the fractions of T2 to T5."""
    own, (x0, y0) = detector.objects[0], window
    expected = own.distance + own.nearest[t] - own.distance
    at = [level.distance[y0 + y, x0 + x] for x, y in templates.size_points()]
    size = any(expected / np.sqrt(1.2) <= d <= expected * np.sqrt(1.2) for d in at if d > 0)
    points, count = own.normal_points[t].astype(int), int(own.normal_counts[t])
    squares = [
        (slice(max(0, y0 + y - 2), y0 + y + 3), slice(max(0, x0 + x - 2), x0 + x + 3)) for x, y in points[:count]
    ]
    normal = [any(1 << b & own.normal_bits[t, i] for b in level.normal_bins[s].ravel() if b != NONE)
              for i, s in enumerate(squares)]  # fmt: skip
    gradient = [bool(level.gradient_response[y0 + y, x0 + x] & own.gradient_bits[t, i])
                for i, (x, y) in enumerate(own.gradient_points[t, : own.gradient_counts[t]].astype(int))]  # fmt: skip
    shown = own.distance + own.point_distances[t, :count] * templates.DISTANCE_UNIT
    centre = np.array([level.distance[y0 + y, x0 + x] for x, y in points[:count]])
    median = np.median((centre - shown)[centre > 0])
    distance = [((np.abs(level.distance[s] - median - shown[i]) < 0.05 * own.diameter) & (level.distance[s] > 0)).any()
                for i, s in enumerate(squares)]  # fmt: skip
    apart = [
        np.abs(level.hue[s].astype(int) - int(own.point_hues[t, i]))[level.hue[s] != NONE]
        for i, s in enumerate(squares)
    ]
    color = [(np.minimum(a, 180 - a) <= COARSE.hue_tolerance_deg / 2).any() for a in apart]
    return size, [float(np.mean(matches)) for matches in (normal, gradient, distance, color)]


def test_the_tests_equal_slow_ones(detector: Detector, level: Level):
    every = level.windows(5)
    inside = (every >= level.overhang).all(axis=1) & (every + 108 <= np.array(level.size) + level.overhang).all(axis=1)
    near = np.abs(level.centers(every) - CAMERA.K[:2, 2]).max(axis=1) < 14
    windows = every[inside & near]
    rng = np.random.default_rng(0)
    count = 60
    rows, chosen = rng.integers(len(windows), size=count), rng.integers(108, size=count)
    candidates = Candidates(rows, chosen.astype(np.int32), np.zeros(count, np.int16))
    found = verify(detector.points, level, windows, candidates, 1.0, COARSE, all_tests=True)
    stopped = verify(detector.points, level, windows, candidates, 1.0, COARSE)
    for k in range(count):
        size, fractions = slow_verify(detector, level, windows[rows[k]], chosen[k])
        np.testing.assert_allclose(found.fractions[k], fractions, atol=0.011)  # a value on a limit may go either way
        passed = [size, *(fraction >= 0.6 for fraction in found.fractions[k])]
        assert found.failed[k] == (0 if all(passed) else passed.index(False) + 1)
    np.testing.assert_array_equal(found.failed, stopped.failed)
    assert len(set(found.failed.tolist())) > 2
    assert stopped.scores[stopped.failed == 1].tolist() == [0.0] * int((stopped.failed == 1).sum())


def test_without_colour_t5_is_off(level: Level):
    own = learn(part(color=None), COARSE, 300.0)
    plain = Detector([own], COARSE)
    windows = level.windows(5)
    candidates = Candidates(np.arange(len(windows)), np.zeros(len(windows), np.int32), np.zeros(len(windows), np.int16))
    found = verify(plain.points, level, windows, candidates, 1.0, COARSE, all_tests=True)
    assert (found.fractions[:, 3] == 0).all()
    assert not (found.failed == 5).any()


def test_the_size_test_of_the_thesis_can_be_had(detector: Detector):
    thesis = Detector(detector.objects, replace(COARSE, size_from_surface=False))
    own = detector.objects[0]
    expected = 1.44 * own.distance - 0.5 * own.diameter
    np.testing.assert_allclose(
        size_ranges(thesis.points, 1.44, 1.2), [[expected / np.sqrt(1.2), expected * np.sqrt(1.2)]], rtol=1e-6
    )


def test_suppression_equals_a_slow_one():
    rng = np.random.default_rng(0)
    corner, size = rng.random((60, 2)) * 100, 20 + rng.random((60, 2)) * 30
    boxes, groups = np.hstack([corner, corner + size]), rng.integers(2, size=60)
    scores = rng.random(60).round(1)  # with ties
    found = nms.suppress(scores, boxes, groups, 0.4)
    left, kept, by = sorted(range(60), key=lambda i: (-scores[i], i)), [], {}
    while left:
        best, *others = left
        kept.append(best)
        by[best] = best
        left = []
        for other in others:
            low, high = np.maximum(boxes[best, :2], boxes[other, :2]), np.minimum(boxes[best, 2:], boxes[other, 2:])
            shared = np.prod(np.maximum(high - low, 0))
            union = np.prod(size[best]) + np.prod(size[other]) - shared
            if groups[best] == groups[other] and shared / union > 0.4:
                by[other] = best
            else:
                left.append(other)
    assert found.kept.tolist() == kept
    assert found.by.tolist() == [by[i] for i in range(60)]
    assert 1 < len(kept) < 60


def test_the_score_prefers_what_explains_more():
    assert nms.ranking_scores(np.array([3.0, 3.0]), np.array([100, 200]), np.array([1.0, 2.0])).tolist() == [300, 300]


def test_r_a_turns_the_axis_to_the_ray():
    R_a = rotation_to_ray(CAMERA.K, np.array([220.0, 20.0]))
    ray = np.linalg.inv(CAMERA.K) @ [220.0, 20.0, 1.0]
    np.testing.assert_allclose(R_a[:, 2], ray / np.linalg.norm(ray), atol=1e-12)
    np.testing.assert_allclose(R_a @ R_a.T, np.eye(3), atol=1e-12)
    angle = np.arccos((np.trace(R_a) - 1) / 2)
    assert angle == pytest.approx(np.arccos(1 / np.linalg.norm(ray)))  # no more turn than needed


@pytest.mark.parametrize(
    ("center", "scale"), [((118.0, 91.0), 1.0), ((170.0, 60.0), 1.0), ((90.0, 120.0), 1.44), ((120.0, 90.0), 1 / 1.2)]
)
def test_the_pose_at_a_shifted_and_scaled_window_shows_the_template_there(
    detector: Detector, center: tuple[float, float], scale: float
):
    own = detector.objects[0]
    template = 40
    pose = pose_at_window(own, template, CAMERA.K, np.array(center), centroid_distance(own, scale, 300.0))
    view = render_views(part(), own.rotations[[template]].astype(float), own.distance, 300.0)[0]
    mask = render(part(), CAMERA, pose, pixel_center=0.0).mask
    v, u = np.nonzero(mask)
    assert mask.sum() == pytest.approx((view.depth > 0).sum() / scale**2, rel=0.1)
    y, x = np.nonzero(view.depth > 0)
    in_image = (np.array([x.mean(), y.mean()]) - CENTER) / scale + center
    assert np.linalg.norm(in_image - [u.mean(), v.mean()]) < 2.0
    distances = own.distance * scale
    assert np.linalg.norm(pose[:3, :3] @ own.centroid + pose[:3, 3]) == pytest.approx(distances)
