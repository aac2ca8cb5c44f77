"""The thesis's own scheme: GC-RANSAC, its variants, Progressive-X and PEARL."""

from itertools import pairwise

import numpy as np
import pytest
from fitting_cases import exact_correspondences, random_pose, right_instances, slow_quality

from pipeline.epos.fitting.config import FittingConfig, Ransac, Solver
from pipeline.epos.fitting.fit import fit_poses
from pipeline.epos.fitting.primitives.problem import plain_arrays, prepare
from pipeline.epos.fitting.progressive_x.gc_ransac import View
from pipeline.epos.fitting.progressive_x.pearl import consolidate
from pipeline.epos.fitting.progressive_x.prosac import prosac_sizes
from pipeline.epos.fitting.results import FittingTrace
from pipeline.epos.fitting.synthetic import K, MadeScene, make_scene

THESIS = FittingConfig("progressive_x")


def view_of(scene: MadeScene) -> View:
    state = np.array([0], np.uint64)
    problem = prepare(*plain_arrays(scene.correspondences, K), state)
    return View(problem, THESIS, state, np.zeros(4, np.int64), None)


def true_poses(scene: MadeScene, view: View) -> list[np.ndarray]:
    """Of points relative to the view's centre."""
    poses = [pose[:3].copy() for pose in scene.camera_from_model]
    for pose in poses:
        pose[:, 3] += pose[:, :3] @ view.problem.centre
    return poses


@pytest.mark.parametrize("ransac", ["gc", "msac"])
@pytest.mark.parametrize("outliers", [0.3, 0.5])
def test_one_instance_is_found(ransac: Ransac, outliers: float):
    scene = make_scene(2, 1, "two-fold", outliers)
    fitting = fit_poses(scene.correspondences, K, FittingConfig("progressive_x", ransac=ransac))
    assert right_instances(scene, fitting) == [0]
    assert fitting.iterations <= 400


@pytest.mark.parametrize("solver", ["epnp+lm", "epnp", "sqpnp+lm", "sqpnp"])
def test_each_solver_of_the_ablation_gives_the_exact_pose_of_exact_data(solver: Solver):
    rng = np.random.default_rng(3)
    pose = random_pose(rng)
    fitting = fit_poses(exact_correspondences(rng, pose), K, FittingConfig("progressive_x", solver=solver))
    np.testing.assert_allclose(fitting.poses[0].camera_from_model, pose, atol=1e-4)


def test_opencv_s_ransac_finds_what_has_few_outliers():
    rng = np.random.default_rng(4)
    pose = random_pose(rng)
    fitting = fit_poses(exact_correspondences(rng, pose), K, FittingConfig("progressive_x", ransac="opencv"))
    np.testing.assert_allclose(fitting.poses[0].camera_from_model, pose, atol=1e-4)


def test_three_instances_are_found_and_share_the_pixels():
    scene = make_scene(5, 3, "two-fold", 0.3)
    fitting = fit_poses(scene.correspondences, K, THESIS, instances=3)
    assert right_instances(scene, fitting) == [0, 1, 2]
    pixels = np.concatenate([scene.correspondences.pixel_ids[pose.inliers] for pose in fitting.poses])
    assert np.mean(np.unique(pixels, return_counts=True)[1] == 1) > 0.9


def test_the_search_ends_when_another_instance_is_improbable():
    scene = make_scene(6, 1, "two-fold", 0.3)
    fitting = fit_poses(scene.correspondences, K, THESIS, instances=None)
    assert right_instances(scene, fitting) == [0]
    assert "the probability of finding another instance is" in fitting.stopped or "nothing new" in fitting.stopped


@pytest.mark.parametrize("seed", range(3))
def test_the_symmetric_twin_is_no_second_instance(seed: int):
    scene = make_scene(seed, 1, "two-fold", 0.3)
    fitting = fit_poses(scene.correspondences, K, THESIS, instances=2)
    assert len(fitting.poses) == 1
    assert fitting.stopped == "3 proposals in a row brought nothing new"


def test_a_proposal_with_known_inliers_is_refused():
    """Without the test for twins, Jaccard's similarity remains."""
    scene = make_scene(7, 1, "two-fold", 0.0, noise_px=0.3)
    trace, config = FittingTrace(), FittingConfig("progressive_x", reject_twins=False, max_similarity=0.0)
    fit_poses(scene.correspondences, K, config, instances=2, trace=trace)
    assert any(event.kind == "refused" and "Jaccard similarity" in event.text for event in trace.events)


def test_local_optimization_raises_the_quality():
    better = 0
    for seed in range(6):
        c = make_scene(40 + seed, 1, "two-fold", 0.5).correspondences
        gc, msac = (
            fit_poses(c, K, FittingConfig("progressive_x", ransac=ransac, max_iterations=60)).poses[0]
            for ransac in ("gc", "msac")
        )
        better += slow_quality(c, gc.camera_from_model) >= slow_quality(c, msac.camera_from_model)
    assert better >= 4


def test_the_search_ends_at_the_quality_that_is_enough():
    scene = make_scene(8, 1, "two-fold", 0.0, noise_px=0.3)
    early = fit_poses(scene.correspondences, K, FittingConfig("progressive_x", quality_threshold=0.3))
    assert early.poses[0].quality > 0.3
    assert early.iterations < 100
    whole = fit_poses(scene.correspondences, K, FittingConfig("progressive_x", quality_threshold=1.0))
    assert whole.iterations > 200


def test_pearl_keeps_the_true_poses_and_drops_one_that_explains_nothing():
    scene = make_scene(9, 3, "two-fold", 0.3)
    view = view_of(scene)
    poses = true_poses(scene, view)
    nonsense = poses[0].copy()
    nonsense[:, 3] = [0.0, 0.0, 40.0]
    kept_poses, kept, energies = consolidate(view, [poses[0], nonsense, poses[1], poses[2]])
    assert kept == [0, 2, 3]
    assert len(kept_poses) == 3
    assert all(later < earlier for earlier, later in pairwise(energies))


def test_pearl_merges_a_pose_given_twice():
    scene = make_scene(10, 1, "two-fold", 0.3)
    view = view_of(scene)
    (pose,) = true_poses(scene, view)
    assert len(consolidate(view, [pose, pose.copy()])[0]) == 1


def test_prosac_begins_with_the_most_confident_and_never_shrinks():
    sizes = prosac_sizes(1600, 400)
    assert abs(sizes[0]) == 3
    assert np.all(np.diff(np.abs(sizes)) >= 0)
    assert 100 < abs(sizes[-1]) < 400  # T_N is 200,000 triplets
    assert abs(prosac_sizes(20, 1200)[-1]) == 20  # there are 1,140 triplets
    assert np.all(np.abs(prosac_sizes(3, 100)) == 3)
