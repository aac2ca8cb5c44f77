"""HashMatch as a whole: poses, both tasks, determinism, the cache, bad input, what is recorded, and the trace."""

import errno
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hashmatch_parts import CAMERA, COARSE, KEY, image_of, looking_at, other_part, part

from pipeline.bop.errors import mssd
from pipeline.exceptions import FormatError, InputError, UnknownIdError
from pipeline.hashmatch import template_cache
from pipeline.hashmatch.detector import Matching
from pipeline.hashmatch.estimator import Found, HashMatchEstimator
from pipeline.hashmatch.fit import depth_fit
from pipeline.hashmatch.pso import swarms
from pipeline.hashmatch.pyramid import prepare
from pipeline.hashmatch.trace import trace
from pipeline.recording import Heatmap, Hypotheses, NullRecorder, Recorder, RecordingReader, Series, Table
from pipeline.scene import Camera, GroundTruth, Image, PoseEstimate, Target

POSE = looking_at(0.45, (2.4, 0.25, 0.3), x=0.03, y=-0.01)
OTHER = looking_at(0.5, (2.0, 0.1, -0.2), x=-0.09, y=0.02)
TARGETS = [Target(*KEY, 1, 1), Target(*KEY, 2, 1)]
FINER = replace(COARSE, angle_step_deg=20, in_plane_limit_deg=40)


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("templates")


@pytest.fixture(scope="module")
def estimator(cache: Path) -> HashMatchEstimator:
    return HashMatchEstimator({1: part(), 2: other_part()}, replace(FINER, cache=cache), 300.0)


@pytest.fixture(scope="module")
def image() -> Image:
    return image_of((part(), POSE), (other_part(), OTHER), noise=0.0005)


@pytest.fixture(scope="module")
def found(estimator: HashMatchEstimator, image: Image) -> tuple[list[PoseEstimate], Found]:
    return estimator.found(image, TARGETS)


def test_both_objects_are_found_to_some_millimetres(found: tuple[list[PoseEstimate], Found]):
    by_object = {estimate.obj_id: estimate for estimate in found[0]}
    assert sorted(by_object) == [1, 2]
    assert mssd(part(), by_object[1].camera_from_model, POSE).value < 0.004
    assert mssd(other_part(), by_object[2].camera_from_model, OTHER).value < 0.004


def test_refinement_improves_rough_poses(
    found: tuple[list[PoseEstimate], Found], estimator: HashMatchEstimator, image: Image
):
    rough = {instance.position: instance.rough for instance in found[1].chosen}
    assert mssd(part(), rough[0], POSE).value > 0.004
    plain = HashMatchEstimator(estimator.models, replace(estimator.config, refine=False), 300.0)
    unrefined = plain.estimate(image, TARGETS, NullRecorder())
    assert {estimate.obj_id for estimate in unrefined} == {1, 2}


def test_the_same_image_gives_the_same_poses(
    found: tuple[list[PoseEstimate], Found], estimator: HashMatchEstimator, image: Image
):
    again = HashMatchEstimator(estimator.models, replace(estimator.config, threads=2), 300.0)
    for one, other in zip(found[0], again.estimate(image, TARGETS, NullRecorder()), strict=True):
        assert (one.obj_id, one.score) == (other.obj_id, other.score)
        np.testing.assert_array_equal(one.camera_from_model, other.camera_from_model)


def test_only_what_is_asked_for_is_reported(estimator: HashMatchEstimator, image: Image):
    only = estimator.estimate(image, TARGETS[1:], NullRecorder())
    assert [estimate.obj_id for estimate in only] == [2]


def test_detection_reports_what_fits_well(estimator: HashMatchEstimator, image: Image):
    detecting = HashMatchEstimator(estimator.models, replace(estimator.config, task="detection"), 300.0)
    estimates = detecting.estimate(image, [Target(*KEY, 1, 99), Target(*KEY, 2, 99)], NullRecorder())
    assert {1, 2} <= {estimate.obj_id for estimate in estimates}
    assert min(estimate.score for estimate in estimates) >= estimator.config.least_fit
    best = {estimate.obj_id: estimate for estimate in reversed(estimates)}
    assert mssd(part(), best[1].camera_from_model, POSE).value < 0.004


def test_a_swarm_comes_back_from_a_template_away_and_is_repeatable(image: Image):
    fit = depth_fit(part(), prepare(image, 0.03), 2, 0.01)
    start = looking_at(0.455, (2.5, 0.2, 0.36), x=0.033, y=-0.012)[None]
    first, second, other = (swarms(fit, start, 20, 30, seed, keep_particles=True)[0] for seed in (1, 1, 2))
    assert mssd(part(), first.pose, POSE).value < 0.3 * mssd(part(), start[0], POSE).value
    assert first.score > first.start_score
    assert (np.diff(first.best_scores) >= 0).all()
    np.testing.assert_array_equal(first.particles, second.particles)
    assert not np.array_equal(first.particles, other.particles)
    assert len(first.particles) == len(first.scores) == len(first.steps) == 20 * 31
    np.testing.assert_array_equal(first.particles[0], start[0])


def test_what_the_viewer_shows_is_recorded(estimator: HashMatchEstimator, image: Image, tmp_path: Path):
    path = tmp_path / "image.rrd"
    with Recorder(path, "id", KEY, CAMERA) as recorder:
        estimates = estimator.estimate(image, TARGETS, recorder)
    reader = RecordingReader.open(path)
    sums = [reader.read(f"hashmatch/{stage}", Heatmap).values.sum() for stage in
            ("windows", "objectness", "hashing", "verification", "nms")]  # fmt: skip
    assert sums == sorted(sums, reverse=True)
    assert sums[-1] > 0
    at_scales = np.sum(
        [reader.read(f"hashmatch/scales/hashing/{level}", Heatmap).values for level in range(-2, 3)], axis=0
    )
    assert at_scales.max() <= reader.read("hashmatch/hashing", Heatmap).values.max() + 1e-3
    detections = reader.read("hashmatch/candidates/verification", Table).columns
    assert {"pixels", "scale", "object", "template", "votes", "score", "suppressed_by"} <= set(detections)
    kept = reader.read("hashmatch/candidates/nms", Table).columns
    assert 0 < len(kept["votes"]) <= len(detections["votes"])
    votes = reader.read("hashmatch/candidates/hashing", Table).columns
    np.testing.assert_array_equal(votes["best_votes"][:, 0], votes["votes"])
    np.testing.assert_array_equal(votes["best_templates"][:, 0], votes["template"])
    assert (np.diff(votes["best_votes"], axis=1) <= 0).all()
    assert ((votes["best_templates"] >= 0).sum(axis=1) == np.minimum(votes["count"], 8)).all()
    refined = reader.read("hashmatch/candidates/refined", Table).columns
    for number, estimate in enumerate(estimates):
        row = int(np.flatnonzero(refined["instance"] == number)[0])
        np.testing.assert_array_equal(refined["camera_from_model"][row], estimate.camera_from_model)
        if refined["rescan"][row] == 0:
            points = reader.read(f"hashmatch/tests/{refined['candidate'][row]}", Table).columns
            found_again = points["matched"][points["test"] == 2].mean()
            assert found_again == pytest.approx(detections["fractions"][refined["candidate"][row], 0], abs=0.02)
    particles = reader.read("hashmatch/pso/0", Hypotheses)
    assert particles is not None
    assert particles.steps is not None
    assert particles.obj_id == estimates[0].obj_id
    assert len(reader.read("hashmatch/pso_score/0", Series).values) == particles.steps.max() + 1
    np.testing.assert_array_equal(reader.read("hashmatch/rough/0", PoseEstimate).camera_from_model.shape, (4, 4))


def test_the_trace_of_what_was_found(found: tuple[list[PoseEstimate], Found], estimator: HashMatchEstimator):
    result = found[1]
    traced = trace(estimator.detector, result.matching, GroundTruth(1, POSE, 0), part(), result.proposed, result.chosen)
    assert traced.stage == "found"
    assert traced.verdict.startswith("object 1 was found (MSSD 0.0")
    assert traced.refined_error is not None
    assert traced.rough_error is not None
    assert traced.refined_error < traced.rough_error
    assert traced.best is not None
    assert traced.best.objectness
    assert traced.best.angle_deg < 21
    assert traced.as_dict()["best"]["edgels"] == traced.best.edgels


@pytest.mark.parametrize(
    ("pose", "stage", "verdict"),
    [
        (looking_at(0.45, (-0.6, 0.2, 0.0), x=0.03), "template", "the nearest template is .* degrees off; use all views"),
        (looking_at(0.45, (2.4, 0.25, 0.3), x=0.03, y=0.11), "objectness", "its window holds .* depth edgels, .* are needed"),
        (looking_at(3.0, (2.4, 0.25, 0.3)), "pyramid", "no level of the pyramid"),
    ],
)  # fmt: skip
def test_the_trace_of_what_was_lost(
    found: tuple[list[PoseEstimate], Found], estimator: HashMatchEstimator, pose: np.ndarray, stage: str, verdict: str
):
    result = found[1]
    if stage == "objectness":
        result = replace(result, matching=replace(result.matching, edgels_needed=10_000.0))
        result = replace(result, matching=_without_foreground(result.matching))
    traced = trace(estimator.detector, result.matching, GroundTruth(1, pose, 0), part(), (), ())
    assert traced.stage == stage
    assert re.search(verdict, traced.verdict)


def _without_foreground(matching: Matching) -> Matching:
    return replace(matching, levels=tuple(replace(level, foreground=level.foreground[:0]) for level in matching.levels))


def test_an_object_that_was_not_learned_is_named(
    found: tuple[list[PoseEstimate], Found], estimator: HashMatchEstimator, image: Image
):
    with pytest.raises(UnknownIdError, match="object 7 is not in the templates that were learned; available: 1, 2"):
        estimator.estimate(image, [Target(*KEY, 7, 1)], NullRecorder())
    with pytest.raises(UnknownIdError, match="object 7 is not in the templates of this run; available: 1, 2"):
        trace(estimator.detector, found[1].matching, GroundTruth(7, POSE, 0), part())


def changed(image: Image, **changes: object) -> Image:
    return replace(image, **changes)


def camera_with(focal: float) -> Camera:
    K = CAMERA.K.copy()
    K[0, 0] = focal
    return replace(CAMERA, K=K)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda image: {"depth": None},
            "scene 1, image 0: has no depth image, which HashMatch needs; run it on the images",
        ),
        (
            lambda image: {"camera": replace(CAMERA, height=90)},
            "depth image has 240 x 180 pixels, its camera 240 x 90; register it",
        ),
        (lambda image: {"camera": camera_with(0.0)}, r"K has focal lengths 0\.0 and 300\.0; correct cam_K"),
        (lambda image: {"camera": camera_with(np.nan)}, "K has focal lengths nan and"),
        (lambda image: {"depth": image.depth * 0}, "its depth image is empty; check the file and depth_scale"),
    ],
)
def test_bad_images_are_one_line_errors(
    estimator: HashMatchEstimator, image: Image, change: Callable[[Image], dict], message: str
):
    with pytest.raises(InputError, match=message) as caught:
        estimator.estimate(changed(image, **change(image)), TARGETS, NullRecorder())
    assert "\n" not in str(caught.value)


def test_an_image_without_colour_is_worked_on(estimator: HashMatchEstimator, image: Image):
    assert isinstance(estimator.estimate(changed(image, rgb=None), TARGETS, NullRecorder()), list)


def test_templates_are_learned_once_and_read_back_exactly(
    cache: Path, estimator: HashMatchEstimator, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(template_cache, "learn_views", None)  # calling it would fail
    again = template_cache.cached_templates(part(), estimator.config, 300.2, cache)
    for name, value in vars(estimator.detector.objects[0]).items():
        np.testing.assert_array_equal(getattr(again, name), value)
    assert not list(cache.glob(".*"))


def test_a_new_object_leaves_the_others_as_they_are(tmp_path: Path):
    config = replace(COARSE, angle_step_deg=90, in_plane_limit_deg=0)
    template_cache.cached_templates(part(), config, 300.0, tmp_path)
    before = {path: path.stat().st_mtime_ns for path in tmp_path.iterdir()}
    template_cache.cached_templates(other_part(), config, 300.0, tmp_path)
    template_cache.cached_templates(part(), replace(config, points=50), 300.0, tmp_path)
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert len(list(tmp_path.iterdir())) == 3


def test_cancelled_learning_goes_on_where_it_stopped(tmp_path: Path):
    config = replace(COARSE, angle_step_deg=20, in_plane_limit_deg=0)  # 72 views, 2 parts
    whole = template_cache.cached_templates(part(), config, 300.0, tmp_path / "whole")

    class Cancelled(Exception):  # noqa: N818
        pass

    def stop(share: float) -> None:
        if share >= 0.5:
            raise Cancelled

    with pytest.raises(Cancelled):
        template_cache.cached_templates(part(), config, 300.0, tmp_path / "part", stop)
    assert len(list((tmp_path / "part").glob(".*.part*"))) == 1
    kept = {path: path.stat().st_mtime_ns for path in (tmp_path / "part").glob(".*.part*")}
    shares: list[float] = []

    def watch(share: float) -> None:
        shares.append(share)
        assert {path: path.stat().st_mtime_ns for path in kept if path.exists()} == (kept if share < 1 else {})

    resumed = template_cache.cached_templates(part(), config, 300.0, tmp_path / "part", watch)
    assert shares == [0, 0.5, 1]
    for name, value in vars(whole).items():
        np.testing.assert_array_equal(getattr(resumed, name), value)


def test_a_cache_of_another_version_or_damaged_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    config = replace(COARSE, angle_step_deg=90, in_plane_limit_deg=0)
    template_cache.cached_templates(part(), config, 300.0, tmp_path)
    (path,) = tmp_path.iterdir()
    monkeypatch.setattr(template_cache, "VERSION", 2)
    with pytest.raises(
        FormatError, match=r"obj_000001-\w+\.npz: has templates of version 1, this program uses 2; delete the file"
    ):
        template_cache.read_templates(path)
    path.write_bytes(path.read_bytes()[:5000])
    with pytest.raises(FormatError, match=r"is no readable file of templates; delete it"):
        template_cache.read_templates(path)


def test_a_full_disk_leaves_nothing_half_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def full(self: Path, data: bytes) -> int:
        with self.open("wb") as file:
            file.write(data[:100])
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with pytest.raises(InputError, match=r"cannot be written \(No space left on device\).*or free space") as caught:
        template_cache.cached_templates(part(), COARSE, 300.0, tmp_path)
    assert "\n" not in str(caught.value)
    assert not list(tmp_path.iterdir())
