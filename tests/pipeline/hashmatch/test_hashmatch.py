"""HashMatch as a whole: poses, all tasks, determinism, and bad images."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hashmatch_parts import CAMERA, COARSE, KEY, image_of, looking_at, other_part, part

from pipeline.bop.errors import mssd
from pipeline.exceptions import InputError, UnknownIdError
from pipeline.hashmatch.estimator import Found, HashMatchEstimator
from pipeline.hashmatch.fit import depth_fit
from pipeline.hashmatch.pso import swarms
from pipeline.hashmatch.pyramid import prepare
from pipeline.recording import NullRecorder
from pipeline.scene import Camera, Image, PoseEstimate, Target

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


def test_siso_reports_one_instance_whatever_the_targets_say(estimator: HashMatchEstimator, image: Image):
    siso = HashMatchEstimator(estimator.models, replace(estimator.config, task="siso"), 300.0)
    found = siso.estimate(image, [Target(*KEY, 2, 3)], NullRecorder())
    assert [estimate.obj_id for estimate in found] == [2]
    assert mssd(other_part(), found[0].camera_from_model, OTHER).value < 0.004


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


def test_an_object_that_was_not_learned_is_named(estimator: HashMatchEstimator, image: Image):
    with pytest.raises(UnknownIdError, match="object 7 is not in the templates that were learned; available: 1, 2"):
        estimator.estimate(image, [Target(*KEY, 7, 1)], NullRecorder())


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
