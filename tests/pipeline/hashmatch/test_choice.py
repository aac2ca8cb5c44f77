"""What speaks for poses, which are followed, and which explain an image best together."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from hashmatch_parts import CAMERA, COARSE, board, image_of, looking_at, model_of, other_part, part

from pipeline.geometry import transform
from pipeline.hashmatch.detector import Detector
from pipeline.hashmatch.evidence import Evidence, gather
from pipeline.hashmatch.fit import depth_fit
from pipeline.hashmatch.joint_choice import TWICE, choose_jointly
from pipeline.hashmatch.points_of_tests import points_of_tests
from pipeline.hashmatch.polish import polished
from pipeline.hashmatch.pose_search import boxes_of, distinct
from pipeline.hashmatch.proposals import first_of_each_place
from pipeline.hashmatch.pyramid import prepare
from pipeline.hashmatch.rendered_templates import learn
from pipeline.rendering import render
from pipeline.scene import Image, Model

POSE = looking_at(0.45, (2.4, 0.25, 0.3))


def evidence_of(model: Model, image: Image, *poses: np.ndarray) -> list[Evidence]:
    return gather(depth_fit(model, prepare(image, 0.05), 1, 0.005), np.array(poses))


def test_the_right_pose_explains_its_pixels_and_costs_nothing():
    image = image_of((part(), POSE))
    right, beside, nearer = evidence_of(
        part(), image, POSE, transform(np.eye(3), np.array([0.01, 0, 0])) @ POSE,
        transform(np.eye(3), np.array([0, 0, -0.05])) @ POSE,
    )  # fmt: skip
    mask = render(part(), CAMERA, POSE, pixel_center=0.0).mask
    assert set(right.pixels.tolist()) <= set(np.flatnonzero(mask).tolist())
    assert len(right.pixels) > 0.98 * mask.sum()
    assert right.cost < 0.02 * mask.sum()
    assert right.share > 0.8
    assert beside.net < 0.8 * right.net
    assert nearer.net < 0  # the camera looks through where it should be
    assert not len(nearer.pixels)


def test_hidden_surface_costs_little_and_explains_nothing():
    front = looking_at(0.30, (0.0, 0.0, 0.0), x=0.02)
    image = image_of((part(), POSE), (other_part(), front))
    free, hidden = evidence_of(part(), image_of((part(), POSE)), POSE)[0], evidence_of(part(), image, POSE)[0]
    gone = len(free.pixels) - len(hidden.pixels)
    assert gone > 0.1 * len(free.pixels)
    assert free.cost < hidden.cost < 0.25 * gone
    assert 0 < hidden.share < free.share


def test_another_colour_speaks_less_for_a_pose():
    image = image_of((part(color=(200, 60, 40)), POSE))
    alike, other = (evidence_of(part(color=color), image, POSE)[0] for color in ((200, 60, 40), (40, 60, 200)))
    plain = evidence_of(part(color=None), image, POSE)[0]
    assert other.net < 0.6 * alike.net
    assert plain.net == pytest.approx(alike.net, rel=1e-6)
    assert evidence_of(part(color=(40, 60, 200)), replace(image, rgb=None), POSE)[0].net == pytest.approx(alike.net)


def test_a_much_darker_surface_speaks_less_for_a_pose_and_a_shaded_one_does_not():
    image = image_of((part(color=(190, 190, 190)), POSE))
    alike, brighter, white = (
        evidence_of(part(color=(value, value, value)), image, POSE)[0] for value in (160, 210, 255)
    )
    dark = evidence_of(part(color=(190, 190, 190)), image_of((part(color=(50, 50, 50)), POSE)), POSE)[0]
    assert brighter.net > 0.95 * alike.net
    assert white.net > 0.8 * alike.net
    assert dark.net < 0.6 * alike.net


def test_a_side_that_lies_anywhere_on_a_table_goes_on_beyond_its_outline():
    tile = model_of(((-0.04, -0.04, 0.0), (0.04, 0.04, 0.02)), color=(120, 125, 120))
    pose = looking_at(0.60, (np.pi, 0, 0))  # its near side is at 0.58 m, the board's 0.01 m before the background
    lying = evidence_of(tile, image_of((tile, pose), background=0.61), pose)[0]
    flush = evidence_of(tile, image_of(background=0.59), pose)[0]
    assert len(flush.pixels) > 0.95 * len(lying.pixels)
    assert lying.going_on < 0.1
    assert flush.going_on > 0.9
    assert flush.net < 0.8 * lying.net


def made(rng: np.random.Generator, count: int) -> list[Evidence]:
    """Poses with random pixels of a strip."""
    found = []
    for _ in range(count):
        first, length = rng.integers(60), rng.integers(5, 25)
        gains = rng.uniform(-0.2, 1, length).astype(np.float32)
        found.append(Evidence(np.arange(first, first + length), gains, rng.uniform(0, 6), share=1.0))
    return found


def value_of(evidence: list[Evidence], rows: tuple[int, ...]) -> float:
    best: dict[int, float] = {}
    total = -sum(evidence[row].cost for row in rows)
    for row in rows:
        for pixel, gain in zip(evidence[row].pixels.tolist(), evidence[row].gains.tolist(), strict=True):
            total -= TWICE if pixel in best else 0
            best[pixel] = max(best.get(pixel, -np.inf), gain)
    return total + sum(best.values())


@pytest.mark.parametrize("seed", range(6))
def test_the_chosen_set_is_nearly_the_best_of_all(seed: int):
    rng = np.random.default_rng(seed)
    evidence, groups = made(rng, 9), rng.integers(3, size=9).tolist()
    counts = {0: 1, 1: 2, 2: 1}
    allowed = [
        rows
        for size in range(5)
        for rows in combinations(range(9), size)
        if all(sum(groups[row] == group for row in rows) <= count for group, count in counts.items())
    ]
    best = max(value_of(evidence, rows) for rows in allowed)
    chosen = tuple(choose_jointly(evidence, groups, counts))
    assert chosen in allowed
    assert value_of(evidence, chosen) >= 0.95 * best


def test_twins_go_to_the_places_that_suit_both():
    def at(first: int, gain: float) -> Evidence:
        return Evidence(np.arange(first, first + 100), np.full(100, gain, np.float32), 0.0, share=1.0)

    left, right = 0, 1000
    evidence = [
        at(left, 0.80),
        at(right, 0.82),
        at(left, 0.50),
        at(right, 0.79),
    ]  # twin 0 left, right; twin 1 left, right
    assert choose_jointly(evidence, [0, 0, 1, 1], {0: 1, 1: 1}) == [0, 3]
    assert choose_jointly(evidence[:2], [0, 0], {0: 1}) == [1]
    assert choose_jointly([], [], {}) == []


def test_detections_of_all_places_are_followed():
    crowded = np.full((50, 2), 100.0)
    centers = np.vstack([crowded, [[300.0, 50.0], [10.0, 200.0]]])
    assert first_of_each_place(centers, 4).tolist() == [0, 1, 50, 51]
    assert first_of_each_place(centers, 100).tolist() == list(range(52))
    assert first_of_each_place(np.zeros((0, 2)), 3).tolist() == []


def test_poses_that_are_followed_are_at_different_places():
    shifts = np.zeros((4, 4, 4)) + np.eye(4)
    shifts[:, 0, 3] = (0.0, 0.001, 0.1, 0.2)
    assert distinct(shifts, np.array([1.0, 0.9, 0.8, 0.95]), 4, 0.01, 2).tolist() == [0, 3, 2]
    assert distinct(shifts, np.array([1.0, 0.9, 0.8, 0.95]), 1, 0.01, 2).tolist() == [0]


def test_polishing_reaches_a_fraction_of_a_millimetre_and_never_lowers_the_score():
    image = image_of((part(), POSE), noise=0.0005)
    turn = looking_at(0.0, (0.03, -0.02, 0.03))[:3, :3]
    start = POSE.copy()
    start[:3, :3] = turn @ POSE[:3, :3]
    start[:3, 3] += (0.002, -0.001, 0.003)
    fit = depth_fit(part(), prepare(image, 0.05), 2, 0.005)
    poses, scores = polished(fit, start[None], boxes_of(fit, start[None]))
    assert scores[0] >= fit.scores(start[None], boxes_of(fit, start[None]))[0]
    points = part().vertices
    away = points @ poses[0, :3, :3].T + poses[0, :3, 3] - points @ POSE[:3, :3].T - POSE[:3, 3]
    assert np.linalg.norm(away, axis=1).max() < 0.001


@pytest.fixture(scope="module")
def detector() -> Detector:
    return Detector([learn(part(), COARSE, 300.0)], COARSE)


def test_masked_pixels_count_neither_for_nor_against(detector: Detector):
    image = image_of((part(), POSE))
    assert image.depth is not None
    covered = np.zeros(image.depth.shape, bool)
    covered[:, : int(CAMERA.K[0, 2]) - 8] = True  # something nearer hides the left part
    image = replace(image, depth=np.where(covered, image.depth - 0.15, image.depth).astype(np.float32))
    without = detector.match(image)
    masked = detector.match(image, masked=covered)
    best = [max((found.detections.fractions.sum(axis=1)).tolist(), default=0.0) for found in (without, masked)]
    assert len(masked.detections) > 0
    assert best[1] > best[0]
    assert not masked.base.distance[covered].any()
    assert (masked.base.edgel == without.base.edgel).all()
    everything = detector.match(image, masked=np.ones_like(covered))
    assert not len(everything.detections)


def test_the_points_of_the_tests_are_those_that_were_counted(detector: Detector):
    image = image_of((part(), POSE), (board(), transform(np.eye(3), np.array([0, 0, 0.9]))))
    matching = detector.match(image)
    found = matching.detections
    assert len(found) > 3
    for row in (0, len(found) // 2, len(found) - 1):
        points = points_of_tests(detector, matching, row)
        for test in (2, 3, 4, 5):
            matched = points.matched[points.test == test]
            assert matched.mean() == pytest.approx(found.fractions[row, test - 2], abs=0.021)
        assert points.matched[points.test == 1].any()
        x0, y0, x1, y1 = found.boxes[row]
        u, v = points.pixels[points.test == 2].T
        assert ((u > x0 - 2) & (u < x1 + 2) & (v > y0 - 2) & (v < y1 + 2)).all()
