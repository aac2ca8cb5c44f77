"""Correspondences that mean nothing give no poses, those that mean something do; and compiled loops are kept."""

import numpy as np
import pytest
from fitting_cases import exact_correspondences, random_pose

from pipeline.epos.fitting.chance import chance_support
from pipeline.epos.fitting.config import FittingConfig
from pipeline.epos.fitting.correspondences import PotentialCorrespondences
from pipeline.epos.fitting.fit import fit_poses
from pipeline.epos.fitting.synthetic import K, make_scene
from pipeline.epos.fitting.warm_up import is_warm
from pipeline.exceptions import InputError

WHATEVER = FittingConfig(min_over_chance=0.0)


def nonsense(seed: int, pixels: int, alternatives: int) -> PotentialCorrespondences:
    """Random points of a box of 8 cm at each cell of a square in the image."""
    rng = np.random.default_rng(seed)
    side = int(np.ceil(np.sqrt(pixels)))
    cells = np.stack(np.meshgrid(np.arange(side), np.arange(side)), axis=-1).reshape(-1, 2)[:pixels] + 60
    rows = np.repeat(np.arange(pixels), alternatives)
    points = rng.uniform(-0.04, 0.04, (len(rows), 3))
    return PotentialCorrespondences(1, cells[rows] * 4 + 1.5, points, rng.random(len(rows)), rows)


@pytest.mark.parametrize("instances", [1, None])
@pytest.mark.parametrize(("pixels", "alternatives"), [(25, 1), (100, 3), (900, 2), (900, 10)])
def test_nonsense_gives_no_pose(pixels: int, alternatives: int, instances: int | None):
    for seed in range(3):
        fitting = fit_poses(nonsense(seed, pixels, alternatives), K, instances=instances, seed=seed)
        assert not fitting.poses
        assert "are needed" in fitting.stopped


def test_whoever_wants_the_best_of_nonsense_gets_it():
    c = nonsense(0, 400, 2)
    fitting = fit_poses(c, K, WHATEVER)
    assert len(fitting.poses) == 1
    assert fitting.poses[0].quality * fitting.pixels < 1.25 * chance_support(fitting.pixels, len(c), 4.0)


def test_nonsense_gives_no_pose_by_the_scheme_of_the_thesis_either():
    fitting = fit_poses(nonsense(0, 100, 3), K, FittingConfig("progressive_x"), instances=1)
    assert not fitting.poses


@pytest.mark.parametrize("symmetry", ["two-fold", "continuous"])
def test_poses_among_four_wrong_points_of_five_are_kept(symmetry):
    for seed in range(3):
        scene = make_scene(seed, 1, symmetry, outliers=0.8)
        assert len(fit_poses(scene.correspondences, K, seed=seed).poses) == 1


def test_few_pixels_that_agree_are_enough():
    rng = np.random.default_rng(0)
    assert len(fit_poses(exact_correspondences(rng, random_pose(rng), 8), K).poses) == 1


def test_bad_factor_is_refused():
    with pytest.raises(InputError, match="fitting: min_over_chance is -1; expected a number from 0"):
        FittingConfig(min_over_chance=-1)


def test_compiled_loops_are_known_to_be_kept():
    fit_poses(nonsense(0, 25, 1), K)
    assert is_warm("pooled")
