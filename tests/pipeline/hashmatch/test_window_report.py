"""What a recording says about HashMatch's windows, against the matching that it was made of."""

from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hashmatch_parts import CAMERA, COARSE, KEY, image_of, looking_at, other_part, part

from pipeline.exceptions import InputError, UnknownIdError
from pipeline.explaining import record_explanation, recorded_explanations
from pipeline.hashmatch.estimator import Found, HashMatchEstimator
from pipeline.hashmatch.explaining import explanation
from pipeline.hashmatch.pictures import gradients_rgb, normals_rgb
from pipeline.hashmatch.points_of_tests import points_at_window
from pipeline.hashmatch.showing import detections as showing_detections
from pipeline.hashmatch.showing import show_matching
from pipeline.hashmatch.window_grid import corner_at
from pipeline.hashmatch.window_report import RecordedMatching, is_recorded
from pipeline.recording import Heatmap, Hypotheses, Recorder, RecordingReader, Series, Table
from pipeline.scene import GroundTruth, Image, PoseEstimate, Target

MODELS = {1: part(), 2: other_part()}
POSE = looking_at(0.45, (2.4, 0.25, 0.3), x=0.03, y=-0.01)
OTHER = looking_at(0.5, (2.0, 0.1, -0.2), x=-0.09, y=0.02)
TARGETS = [Target(*KEY, 1, 1), Target(*KEY, 2, 1)]


class Recorded(NamedTuple):
    """A recording, and what it was made of."""

    reader: RecordingReader
    matching: RecordedMatching
    estimator: HashMatchEstimator
    found: Found
    estimates: list[PoseEstimate]
    image: Image


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Recorded:
    folder = tmp_path_factory.mktemp("recorded")
    config = replace(COARSE, angle_step_deg=20, in_plane_limit_deg=40, cache=folder)
    estimator = HashMatchEstimator(MODELS, config, 300.0)
    image = image_of((part(), POSE), (other_part(), OTHER), noise=0.0005)
    assert image.rgb is not None
    assert image.depth is not None
    with Recorder(folder / "image.rrd", "id", KEY, CAMERA) as recorder:
        recorder.image("image/rgb", image.rgb)
        recorder.depth("image/depth", image.depth)
        estimates, found = estimator.found(image, TARGETS, recorder)
        for truth in (GroundTruth(1, POSE, 0), GroundTruth(2, OTHER, 1)):
            record_explanation(recorder, explanation(estimator.detector, found, truth, MODELS[truth.obj_id]))
    reader = RecordingReader.open(folder / "image.rrd")
    return Recorded(reader, RecordedMatching(reader, MODELS.__getitem__), estimator, found, estimates, image)


def test_candidates_thin_out_from_stage_to_stage(recorded: Recorded):
    counts = recorded.matching.stage_counts()
    assert list(counts) == ["windows", "objectness", "hashing", "verification", "nms"]
    candidates = [count.candidates for count in counts.values()]
    assert candidates == sorted(candidates, reverse=True)
    levels = recorded.found.matching.levels
    templates = sum(len(own) for own in recorded.estimator.detector.objects)
    assert counts["windows"].candidates == templates * sum(len(level.windows) for level in levels)
    assert counts["objectness"].windows == sum(len(level.foreground) for level in levels)
    assert counts["hashing"].candidates == sum(len(level.candidates.windows) for level in levels)
    assert counts["nms"].candidates == len(recorded.found.matching.detections.kept) > 0
    by_level = [recorded.matching.stage_counts(level)["hashing"].candidates for level in recorded.matching.levels]
    assert sum(by_level) == counts["hashing"].candidates


def test_heatmaps_count_the_candidates_over_each_cell(recorded: Recorded):
    heat = recorded.matching.heatmap("hashing")
    assert heat is not None
    expected = np.zeros(heat.values.shape)
    for matched in recorded.found.matching.levels:
        centers = matched.level.centers(matched.windows[matched.candidates.windows])
        half = 54 / matched.level.scale
        y, x = np.indices(expected.shape) * heat.cell_px + (heat.cell_px - 1) / 2
        for u, v in centers[::97]:
            expected += (x >= u - half) & (x < u + half) & (y >= v - half) & (y < v + half)
    counted = expected * (heat.values.sum() / expected.sum())
    assert np.abs(counted - heat.values).mean() < 0.05 * heat.values.mean()
    levels = [recorded.matching.heatmap("hashing", level) for level in recorded.matching.levels]
    there = [level for level in levels if level is not None]
    total = sum(float(level.values.sum()) * level.cell_px**2 for level in there)
    assert total == pytest.approx(float(heat.values.sum()) * heat.cell_px**2, rel=0.03)


def test_any_window_is_reported_as_it_was_matched(recorded: Recorded):
    detector, rng = recorded.estimator.detector, np.random.default_rng(0)
    stages = set()
    for matched in recorded.found.matching.levels:
        for row in rng.choice(len(matched.windows), 40):
            center = matched.level.centers(matched.windows[[row]])[0]
            if not ((center >= -0.5) & (center < (CAMERA.width - 0.5, CAMERA.height - 0.5))).all():
                continue
            report = recorded.matching.window_at(float(center[0]), float(center[1]), matched.level.index)
            stages.add(report.stage)
            np.testing.assert_array_equal(report.corner, matched.windows[row])
            np.testing.assert_allclose(report.center, center)
            assert report.edgels == matched.edgel_counts[row]
            assert report.objectness == (row in matched.foreground)
            its = np.flatnonzero(matched.candidates.windows == row)
            assert report.candidates == len(its)
            if report.objectness:
                assert (report.stage == "size") == (row not in matched.hashed)
            for vote in report.votes:
                at = its[vote.rank - 1]
                position = detector.tables.objects[matched.candidates.templates[at]]
                assert vote.obj_id == detector.objects[position].obj_id
                assert vote.template == matched.candidates.templates[at] - detector.tables.firsts[position]
                assert vote.votes == matched.candidates.votes[at]
                assert vote.failed_test == matched.verified.failed[at]
                if vote.failed_test == 0:
                    np.testing.assert_allclose(vote.fractions, matched.verified.fractions[at], atol=2e-3)
            if len(its):
                passed = (matched.verified.failed[its] == 0).any()
                assert (report.stage in ("suppression", "kept")) == passed
                assert [vote.rank for vote in report.votes][: min(4, len(its))] == list(range(1, min(4, len(its)) + 1))
    assert {"objectness", "size", "verification"} <= stages


def test_the_window_of_a_detection_says_what_became_of_it(recorded: Recorded):
    detections = recorded.found.matching.detections
    kept, suppressed = (
        int(np.flatnonzero((detections.suppressed_by == np.arange(len(detections))) == own)[0]) for own in (True, False)
    )
    best = recorded.matching.window_of(kept)
    assert best.stage == "kept"
    assert any(vote.detection == kept and vote.kept for vote in best.votes)
    assert f"was kept as detection {best.farthest and best.farthest.detection}" in best.verdict
    report = recorded.matching.window_of(suppressed)
    np.testing.assert_allclose(report.center, detections.centers[suppressed], atol=1e-3)
    ends = {vote.detection: vote.suppressed_by for vote in report.votes if vote.detection is not None}
    assert all(by == detections.suppressed_by[row] for row, by in ends.items() if by is not None)
    with pytest.raises(
        UnknownIdError, match=r"detection 99999 is not in the recording of \d+ detections; available: 0, 1"
    ):
        recorded.matching.window_of(99_999)


def test_without_a_level_the_window_that_came_farthest_is_taken(recorded: Recorded):
    detections = recorded.found.matching.detections
    u, v = detections.centers[detections.kept[0]]
    report = recorded.matching.window_at(float(u), float(v))
    assert report.stage == "kept"
    assert np.abs(np.array(report.center) - (u, v)).max() <= 1.5 * 5 / report.scale


def test_verdicts_name_the_number_that_was_missing(recorded: Recorded):
    corner = recorded.matching.window_at(0, 0, 2)
    assert corner.stage == "objectness"
    assert corner.verdict == f"It holds {corner.edgels} depth edgels; more than {corner.edgels_needed:.0f} are needed."
    failed = [
        report
        for u in range(20, 220, 9)
        for v in range(30, 150, 15)
        if (report := recorded.matching.window_at(u, v, 0)).stage == "verification"
        and report.farthest is not None
        and report.farthest.failed_test > 1
    ]
    assert failed
    for report in failed:
        assert report.farthest is not None
        assert report.farthest.missing is not None
        assert report.farthest.missing > -0.001
        assert "came farthest and failed T" in report.verdict
        assert report.verdict.endswith(" of 0.60 needed.")


def test_points_of_tests_are_the_same_recorded_and_computed_again(recorded: Recorded):
    detector, matching = recorded.estimator.detector, recorded.found.matching
    levels = {matched.level.index: matched for matched in matching.levels}
    again, failed = 0, set()
    step = max(1, len(matching.detections) // 8)
    reports = [recorded.matching.window_of(row) for row in range(0, len(matching.detections), step)]
    reports += [recorded.matching.window_at(u, v, 0) for u in range(30, 220, 20) for v in (60, 90, 120)]
    for report in reports:
        for vote in report.votes[:2]:
            points = recorded.matching.test_points(report, vote)
            own = next(own for own in detector.objects if own.obj_id == vote.obj_id)
            matched = levels[report.level]
            corner = np.array(report.corner)
            truth = points_at_window(own, matched.level, matched.scale, vote.template, corner, detector.config)
            for name in truth._fields:
                np.testing.assert_allclose(getattr(points, name), getattr(truth, name), atol=1e-4, err_msg=name)
            again += f"hashmatch/tests/{vote.detection}" not in recorded.reader.kinds()
            for test in range(2, (vote.failed_test or 5) + 1):
                its = truth.test == test
                share = truth.matched[its].sum() / (~truth.masked[its]).sum()
                assert share == pytest.approx(vote.fractions[test - 2], abs=0.02)
                failed.add(vote.failed_test)
    assert again > 3
    assert 0 in failed
    assert failed & {2, 3, 4, 5}, failed


def test_pictures_show_window_and_template_alike(recorded: Recorded):
    detections = recorded.found.matching.detections
    report = recorded.matching.window_of(int(detections.kept[0]))
    vote = next(vote for vote in report.votes if vote.kept)
    window = recorded.matching.window_pictures(report)
    template = recorded.matching.template_pictures(vote.obj_id, vote.template)
    for picture in (*window, *template):
        assert picture.shape[:2] == (108, 108)
    both = (template.distance > 0) & (window.distance > 0)
    assert both.sum() > 500
    shift = window.distance[both] - template.distance[both]
    assert np.median(np.abs(shift - np.median(shift))) < 0.005
    agreement = (template.normals * window.normals).sum(axis=-1)
    assert np.median(agreement[both]) > 0.9
    assert normals_rgb(window.normals).dtype == np.uint8
    assert gradients_rgb(window.gradients, window.orientations).any()
    position = 0 if vote.obj_id == 1 else 1
    expected = recorded.estimator.detector.objects[position].pose(vote.template)
    np.testing.assert_allclose(recorded.matching.template_pose(vote.obj_id, vote.template), expected, atol=1e-6)


def test_templates_that_were_followed_for_an_instance_have_pictures(recorded: Recorded):
    for told in recorded_explanations(recorded.reader).values():
        position = told.obj_id - 1
        for one in told.details["followed"]:
            row = one["template"]["row"]
            expected = recorded.estimator.detector.objects[position].pose(row)
            np.testing.assert_allclose(recorded.matching.template_pose(told.obj_id, row), expected, atol=1e-6)
            assert recorded.matching.template_pictures(told.obj_id, row).distance.any()
    with pytest.raises(UnknownIdError, match=r"template of object 1 99999 is not in .*image\.rrd; available: "):
        recorded.matching.template_pose(1, 99_999)


def test_a_window_at_the_border_has_pictures_too(recorded: Recorded):
    window = recorded.matching.window_pictures(recorded.matching.window_at(1, 1, 0))
    assert window.distance.shape == (108, 108)
    assert not window.distance[:20].any()  # beyond the image


def test_refined_poses_and_swarms_are_whole(recorded: Recorded):
    refined = recorded.reader.read("hashmatch/candidates/refined", Table).columns
    for number, (estimate, instance) in enumerate(zip(recorded.estimates, recorded.found.chosen, strict=True)):
        row = int(np.flatnonzero(refined["instance"] == number)[0])
        np.testing.assert_array_equal(refined["camera_from_model"][row], estimate.camera_from_model)
        rough = recorded.reader.read(f"hashmatch/rough/{number}", PoseEstimate)
        np.testing.assert_array_equal(rough.camera_from_model, instance.rough)
        assert rough.obj_id == estimate.obj_id
        particles = recorded.reader.read(f"hashmatch/pso/{number}", Hypotheses)
        assert particles.steps is not None
        scores = recorded.reader.read(f"hashmatch/pso_score/{number}", Series).values
        assert len(scores) == particles.steps.max() + 1
        best = [particles.quality[particles.steps <= step].max() for step in range(len(scores))]
        np.testing.assert_allclose(best, scores)


def test_what_cannot_be_answered_is_said_in_one_line(recorded: Recorded, tmp_path: Path):
    with pytest.raises(InputError, match=r"pixel \(500, 3\) is not in the image of 240 x 180 pixels; click into it"):
        recorded.matching.window_at(500, 3)
    with pytest.raises(UnknownIdError, match="level 7 is not in the pyramid of this image; available: -2, -1, 0, 1, 2"):
        recorded.matching.window_at(5, 3, 7)
    with pytest.raises(UnknownIdError, match="stage pose is not in HashMatch; available"):
        recorded.matching.heatmap("pose")
    vote = recorded.matching.window_of(0).votes[0]
    alone = RecordedMatching(recorded.reader)
    with pytest.raises(InputError, match=r"object \d: its model is needed to draw a template; open the run with its"):
        alone.template_pictures(vote.obj_id, vote.template)
    assert is_recorded(recorded.reader)
    with Recorder(tmp_path / "other.rrd", "id", KEY, CAMERA) as recorder:
        recorder.text("log", "another method")
    assert not is_recorded(RecordingReader.open(tmp_path / "other.rrd"))


def test_of_very_many_detections_the_best_are_recorded(
    recorded: Recorded, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(showing_detections, "MOST_SHOWN", 5)
    assert recorded.image.depth is not None
    with Recorder(tmp_path / "image.rrd", "id", KEY, CAMERA) as recorder:
        recorder.depth("image/depth", recorded.image.depth)
        show_matching(recorded.estimator.detector, recorded.found.matching, recorder)
    matching = RecordedMatching(RecordingReader.open(tmp_path / "image.rrd"))
    assert matching.window_of(4).stage in ("kept", "suppression")
    with pytest.raises(UnknownIdError, match="detection 5 is not in the recording of 5 detections"):
        matching.window_of(5)
    last = recorded.matching.window_of(len(recorded.found.matching.detections) - 1)
    again = matching.window_at(*last.center, last.level)
    assert [vote.template for vote in again.votes] == [vote.template for vote in last.votes]


def test_a_recording_is_small(recorded: Recorded):
    assert recorded.reader.path.stat().st_size < 3_000_000


def test_windows_are_named_by_their_corners(recorded: Recorded):
    for matched in recorded.found.matching.levels:
        for row in (0, len(matched.windows) // 2, len(matched.windows) - 1):
            center = matched.level.centers(matched.windows[[row]])[0]
            np.testing.assert_array_equal(corner_at(matched.level, center), matched.windows[row])
    assert isinstance(recorded.matching.heatmap("nms"), Heatmap)
