"""What a trace tells is what happened, and asking for it changes nothing."""

import numpy as np
import pytest
from fitting_cases import TAU, reprojection_errors, slow_quality

from pipeline.epos.fitting.config import FittingConfig, Scheme
from pipeline.epos.fitting.correspondences import PotentialCorrespondences
from pipeline.epos.fitting.fit import fit_poses
from pipeline.epos.fitting.results import Fitting, FittingTrace, HypothesisTrace
from pipeline.epos.fitting.synthetic import K, make_scene

SCHEMES: list[Scheme] = ["pooled", "progressive_x"]


def correspondences() -> PotentialCorrespondences:
    """Two instances, not sorted by pixel, the first ten without numbers."""
    c = make_scene(1, 3, "two-fold", 0.4).correspondences
    c = c.at(np.random.default_rng(0).permutation(len(c)))
    points = c.points_in_model.copy()
    points[:10] = np.nan
    return PotentialCorrespondences(1, c.pixels, points, c.confidence, c.pixel_ids)


@pytest.fixture(scope="module", params=SCHEMES)
def traced(request: pytest.FixtureRequest) -> tuple[PotentialCorrespondences, FittingConfig, Fitting, FittingTrace]:
    c, config, trace = correspondences(), FittingConfig(request.param), FittingTrace()
    return c, config, fit_poses(c, K, config, instances=3, trace=trace), trace


def hypotheses(traced: tuple) -> HypothesisTrace:
    return traced[3].all_hypotheses()


def test_a_trace_changes_nothing(traced: tuple):
    c, config, fitting, _ = traced
    plain = fit_poses(c, K, config, instances=3)
    assert (plain.stopped, plain.iterations) == (fitting.stopped, fitting.iterations)
    for one, other in zip(plain.poses, fitting.poses, strict=True):
        np.testing.assert_array_equal(one.camera_from_model, other.camera_from_model)


def test_a_hypothesis_comes_from_its_triplet(traced: tuple):
    """P3P's pose sees the three points at their pixels."""
    c, h = traced[0], hypotheses(traced)
    samples = [i for i, stage in enumerate(h.stage) if stage in ("early", "sample")]
    assert len(samples) > 100
    for i in samples[:: len(samples) // 50]:
        triplet = c.at(h.triplets[i])
        assert np.all(h.triplets[i] >= 10)
        assert len(np.unique(triplet.pixel_ids)) == 3
        assert reprojection_errors(triplet, h.camera_from_model[i]).max() < 1e-3


def test_the_triangles_are_large_enough(traced: tuple):
    c, h = traced[0], hypotheses(traced)
    corners = c.pixels[h.triplets[h.triplets[:, 0] >= 0]]
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    assert np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).min() / 2 >= 100.0


def test_the_last_hypotheses_are_the_poses_returned(traced: tuple):
    fitting, h = traced[2], hypotheses(traced)
    final = [i for i, stage in enumerate(h.stage) if stage == "final"]
    assert len(final) == len(fitting.poses) == 3
    for i, pose in zip(final, fitting.poses, strict=True):
        np.testing.assert_array_equal(h.camera_from_model[i], pose.camera_from_model)
        assert h.quality[i] == pose.quality
    assert h.proposals[final].tolist() == [0, 1, 2]


def test_the_quality_told_is_that_of_the_pose(traced: tuple):
    """Before any instance is known; of a raw hypothesis of the pooled search the tolerance is wider."""
    c, config, _, trace = traced
    usable = c.at(np.arange(10, len(c)))
    h = trace.all_hypotheses()
    stage = "optimized" if config.scheme == "pooled" else "sample"
    first = h.proposals <= 0
    rows = [i for i, each in enumerate(h.stage) if each == stage and first[i]]
    assert len(rows) >= 5
    for i in rows[:: max(1, len(rows) // 8)]:
        assert h.quality[i] == pytest.approx(slow_quality(usable, h.camera_from_model[i]), abs=2e-4)


def test_decisions_are_told_in_order(traced: tuple):
    _, config, fitting, trace = traced
    kinds = [event.kind for event in trace.events]
    assert kinds[-1] == "stopped"
    assert trace.events[-1].text == fitting.stopped
    expected = ("searched", "taken") if config.scheme == "pooled" else ("proposed", "merged")
    assert kinds[0] == expected[0]
    assert expected[1] in kinds
    taken = [event.instance for event in trace.events if event.kind in ("taken", "proposed") and event.instance >= 0]
    assert sorted(set(taken)) == [0, 1, 2]


def test_a_full_trace_leaves_out_the_rest():
    c, trace = correspondences(), FittingTrace(capacity=20)
    fitting = fit_poses(c, K, instances=3, trace=trace)
    assert len(trace.all_hypotheses().quality) == 20 + len(fitting.poses)


def test_an_empty_trace_can_be_read():
    h = FittingTrace().all_hypotheses()
    assert (h.camera_from_model.shape, h.stage) == ((0, 4, 4), ())


def test_opencv_s_variant_tells_its_proposals():
    trace = FittingTrace()
    fit_poses(correspondences(), K, FittingConfig("progressive_x", ransac="opencv"), trace=trace)
    assert "refined" in trace.all_hypotheses().stage


def test_inliers_of_the_poses_are_positions_in_what_was_given(traced: tuple):
    c, _, fitting, _ = traced
    for pose in fitting.poses:
        assert pose.inliers.min() >= 10
        assert reprojection_errors(c.at(pose.inliers), pose.camera_from_model).max() < TAU + 1e-3
