"""What the tab of HashMatch computes from a recording, without a browser."""

from typing import Any

import numpy as np
import pytest

from inspector.address import from_query
from inspector.hashmatch import pieces
from inspector.hashmatch.chain import checks, trace_part, verdict_line
from inspector.hashmatch.choice import query, window_query
from inspector.hashmatch.heat import STRONGEST, WEAKEST, counted, heat_pixels, scale_of, shades_of, thumbnail
from inspector.hashmatch.modalities import MATCHED, UNMATCHED, Pair, median_shift, pairs, with_points
from inspector.hashmatch.refinement import Refinement, number_of
from inspector.hashmatch.window import outcomes_of, shown_test
from inspector.selection import Selection
from pipeline.explaining import Evidence, Explanation
from pipeline.hashmatch.window_report import Pictures, PointsOfTests, TemplateVotes
from pipeline.recording import Heatmap, Hypotheses
from pipeline.scene import ImageKey, PoseEstimate

KEY = ImageKey(2, 5)


def vote(failed: int, fractions: tuple[float, float, float, float] = (0.9, 0.8, 0.7, 0.65)) -> TemplateVotes:
    return TemplateVotes(1, 7, 12, 1, failed, fractions, None, None, None)


# ------------------------------------------------------------------ numbers and colours of candidates
@pytest.mark.parametrize(
    ("number", "text"),
    [(0, "0"), (3.4, "3.4"), (186, "186"), (14665, "14,665"), (28_542_398_976, "2.9·10¹⁰"), (9_999_999, "1.0·10⁷")],
)
def test_counts_are_short(number: float, text: str):
    assert counted(number, markup=False) == text


def test_exponents_are_raised_by_markup_in_the_tab():
    assert counted(5.2e5) == "5.2·10<sup>5</sup>"


def test_colours_go_by_the_logarithm_only_where_values_differ_by_much():
    alike, wide = np.linspace(1, 5, 100).reshape(10, 10), np.logspace(0, 5, 100).reshape(10, 10)
    assert not shades_of(alike).logarithmic
    assert shades_of(wide).logarithmic
    assert "logarithmic" in scale_of(Heatmap(wide)).label
    assert scale_of(Heatmap(alike)).low == "0"
    middle = shades_of(wide).shares(np.array([10**2.5]))[0]
    assert 0.4 < middle < 0.6  # half of the decades, though a three-hundredth of the largest


def test_the_heat_covers_its_cells_and_nothing_else():
    heatmap = Heatmap(np.array([[0.0, 5.0], [0.0, 10.0]]), cell_px=4)
    pixels = heat_pixels(heatmap, (7, 8))
    assert pixels.shape == (8, 7, 4)
    assert (pixels[:, :4, 3] == 0).all()
    assert len(np.unique(pixels[:4, 4:].reshape(-1, 4), axis=0)) == 1  # one cell, one colour
    opacity = pixels[[0, 7], 6, 3] / 255
    assert WEAKEST <= opacity[0] < opacity[1] <= STRONGEST + 0.01
    assert pixels[7, 6, 0] > pixels[7, 6, 2]  # the most are red


def test_the_heat_of_nothing_is_transparent():
    assert heat_pixels(Heatmap(np.zeros((2, 2)), cell_px=2), (4, 4))[..., 3].max() == 0


def test_thumbnails_show_the_image_where_no_candidate_is():
    rgb = np.full((60, 80, 3), 200, np.uint8)
    without = thumbnail(None, rgb)
    heat = np.zeros((15, 20))
    heat[:, 10:] = 3
    half = thumbnail(Heatmap(heat, cell_px=4), rgb)
    assert without.shape == half.shape
    assert (half[:, :60] == without[:, :60]).all()
    assert (half[:, 72:] != without[:, 72:]).any(axis=-1).all()


# ------------------------------------------------------------------ tests of a template
def test_after_the_test_that_failed_none_is_made():
    found = outcomes_of(vote(3), colored=True)
    assert [one.passed for one in found] == [True, True, False, None, None]
    assert [one.fraction for one in found] == [None, 0.9, 0.8, None, None]


def test_a_template_that_passed_all_shows_all_fractions():
    assert [one.passed for one in outcomes_of(vote(0), colored=True)] == [True] * 5


def test_without_colour_there_is_no_fifth_test():
    assert outcomes_of(vote(0), colored=False)[4] == (5, None, None)


def test_the_first_test_that_failed_is_shown_unless_another_is_chosen():
    assert shown_test(vote(4), 0) == 4
    assert shown_test(vote(4), 2) == 2
    assert shown_test(vote(0), 0) == 2
    assert shown_test(vote(0), 77) == 2


def pictures(distance: float, color: int) -> Pictures:
    size = (108, 108)
    normals = np.zeros((*size, 3), np.float32)
    normals[..., 2] = -1
    flat = np.full(size, distance, np.float32)
    flat[:20] = 0
    return Pictures(np.full((*size, 3), color, np.uint8), flat, normals, np.zeros(size), np.zeros(size))


def test_distances_are_compared_up_to_their_median_difference():
    window, template = pictures(0.9, 90), pictures(0.5, 10)
    assert median_shift(window.distance, template.distance) == pytest.approx(0.4)
    both = pairs(window, template)["distance"]
    assert np.abs(both.window.astype(int) - both.template).max() <= 2


def test_points_that_match_are_green_and_others_red():
    points = PointsOfTests(
        test=np.array([2, 2, 3]),
        pixels=np.zeros((3, 2)),
        template_pixels=np.array([[10, 20], [60, 70], [90, 90]]),
        matched=np.array([True, False, True]),
        masked=np.zeros(3, bool),
    )
    plain = np.full((108, 108, 3), 120, np.uint8)
    window, template = with_points(Pair(plain, plain), points, 2)
    for picture in (window, template):
        zoom = len(picture) // 108
        assert tuple(picture[20 * zoom + 2, 10 * zoom + 2]) == MATCHED
        assert tuple(picture[70 * zoom + 2, 60 * zoom + 2]) == UNMATCHED
        assert tuple(picture[90 * zoom + 2, 90 * zoom + 2]) not in (MATCHED, UNMATCHED)  # of another test


# ------------------------------------------------------------------ the swarm
def swarm() -> Refinement:
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, 2, 3] = 0.5
    scores = np.array([0.1, 0.2, 0.3, 0.5, 0.4, 0.45])
    found = Hypotheses(1, poses, scores, steps=np.array([0, 0, 1, 1, 2, 2]))
    rough = poses[0].copy()
    rough[0, 3] = 0.01
    return Refinement(0, PoseEstimate(2, 5, 1, 0.5, poses[3]), rough, found, np.array([0.2, 0.5, 0.5]), None)


def test_iterations_are_those_of_the_swarm():
    found = swarm()
    assert found.last == 2
    assert [found.iteration(asked) for asked in (None, 1, -4, 99)] == [2, 1, 0, 2]
    assert found.particles(1).tolist() == [False, False, True, True, False, False]


def test_how_far_refinement_moved_a_pose():
    moved = swarm().moved
    assert moved is not None
    np.testing.assert_allclose(moved, (0.01, 0.0), atol=1e-9)


def test_an_estimate_of_the_results_is_found_among_the_recorded_ones():
    found = swarm().estimate
    rounded = PoseEstimate(2, 5, 1, 0.5, found.camera_from_model.round(5))
    other = PoseEstimate(2, 5, 2, 0.5, found.camera_from_model)
    assert number_of({3: found}, rounded) == 3
    assert number_of({3: found}, other) is None
    assert number_of({3: found}, None) is None


# ------------------------------------------------------------------ why an instance was found or lost
def details(**changes: Any) -> dict[str, Any]:
    tests = [{"test": 1, "name": "T1 size", "measured": 0.5, "nearest": 0.45, "farthest": 0.55, "passed": True}]
    tests += [
        {"test": i, "name": f"T{i} name", "fraction": f, "needed": 0.6, "passed": f >= 0.6}
        for i, f in ((2, 0.9), (3, 0.48), (4, 0.2), (5, 0.9))
    ]
    usual = {
        "template": {"row": 4, "angle_deg": 6.0},
        "window": {"level": -1, "scale": 0.83, "u": 100.0, "v": 80.0},
        "objectness": {"edgels": 300, "needed": 100.0, "passed": True},
        "size_possible": True,
        "votes": {"votes": 9, "needed": 3, "rank": 2, "kept_at_most": 100, "passed": True},
        "tests": tests,
        "failed_test": 3,
        "detections": {
            "count": 0, "nearest_error": None, "best": None, "rank": None, "suppressed_by": None, "followed_up": False
        },
        "refinement": {
            "proposed": 0, "rough_error": None, "moved_error": None, "refined_error": None, "rough_score": None,
            "refined_score": None, "chosen_error": None,
        },
        "followed": [],
    }  # fmt: skip
    return usual | changes


def explanation(stage: str, **changes: Any) -> Explanation:
    return Explanation(0, 1, stage, "object 1: a <b> sentence.", (), details(**changes))


def test_the_check_that_failed_is_marked_and_what_follows_from_it_is_not():
    found = checks(KEY, explanation("verification"))
    failed = [check for check in found if check.passed is False]
    assert [check.name for check in failed] == ["T3 name"]
    assert "0.48 of 0.60, 0.12 short" in failed[0].text
    assert [check.passed for check in found[-3:]] == [None, None, None]


def test_the_evidence_of_a_test_is_the_window_with_its_points():
    failed = next(check for check in checks(KEY, explanation("verification")) if check.passed is False)
    choice = from_query(failed.choose, Selection()).hashmatch
    assert choice.is_of(KEY)
    assert (choice.pixel, choice.level, choice.test, choice.part) == ((100.0, 80.0), -1, 3, "window")


def test_an_instance_that_was_suppressed_leads_to_what_suppressed_it():
    suppressor = {"detection": 12, "u": 90.0, "v": 70.0, "score": 3.0}
    detections = {
        "count": 5, "nearest_error": 0.1, "best": 31, "rank": 8, "suppressed_by": suppressor, "followed_up": True
    }  # fmt: skip
    found = checks(KEY, explanation("suppression", detections=detections))
    (failed,) = [check for check in found if check.passed is False]
    assert failed.name == "non-max. suppression"
    choice = from_query(failed.choose, Selection()).hashmatch
    assert (choice.detection, choice.stage) == (12, "nms")


def test_nothing_is_red_where_the_instance_was_found():
    refinement = details()["refinement"] | {
        "proposed": 4, "rough_error": 0.2, "moved_error": 0.01, "refined_error": 0.01, "chosen_error": 0.01
    }  # fmt: skip
    detections = {
        "count": 5, "nearest_error": 0.1, "best": 31, "rank": 8, "suppressed_by": None, "followed_up": True
    }  # fmt: skip
    found = checks(KEY, explanation("found", detections=detections, refinement=refinement))
    assert not [check for check in found if check.passed is False]
    assert found[-1].text == "MSSD 0.010 d"


def test_without_a_window_the_pyramid_is_to_blame():
    nothing = dict.fromkeys(("template", "window", "objectness", "size_possible", "votes", "tests", "failed_test"))
    found = checks(KEY, explanation("pyramid", **nothing))
    assert found[0].passed is False
    assert "no level of the pyramid fits" in found[0].text


def test_of_another_method_the_numbers_are_listed():
    other = Explanation(0, 1, "matching", "too few.", (Evidence("inliers", 12, 20, "points"),), {})
    assert checks(KEY, other) == [("inliers", None, "12 points (limit 20)", "")]


def test_text_of_a_recording_is_escaped():
    shown = verdict_line(explanation("verification"), "") + trace_part(KEY, explanation("verification"))
    assert "a &lt;b&gt; sentence" in shown
    assert "<b> sentence" not in shown
    assert 'data-choose="x&quot;&gt;"' in pieces.choosing("span", 'x">', "")


# ------------------------------------------------------------------ what is chosen, as part of an address
def test_a_part_of_an_address_changes_what_it_names_only():
    before = from_query(query(KEY, stage="hashing", instance=3, part="swarm"), Selection())
    after = from_query(window_query(KEY, detection=8, level=None), before)
    assert after.hashmatch.detection == 8
    assert (after.hashmatch.stage, after.hashmatch.instance) == ("hashing", 3)
    assert not after.hashmatch.is_of(ImageKey(2, 6))
