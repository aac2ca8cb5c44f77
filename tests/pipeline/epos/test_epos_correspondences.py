"""Correspondences against loops over pixels and fragments."""

import numpy as np
import pytest

from pipeline.epos.config import CorrespondenceConfig
from pipeline.epos.correspondences import establish
from pipeline.epos.fragments import Fragments
from pipeline.epos.prediction import ObjectPrediction
from pipeline.exceptions import InputError

RNG = np.random.default_rng(3)
FRAGMENTS = Fragments(RNG.normal(size=(6, 3)) * 0.03, RNG.uniform(0.01, 0.02, 6))


def prediction(count=40, n=6):
    rng = np.random.default_rng(5)
    cells = np.stack([np.arange(count) % 10, np.arange(count) // 10], axis=1)
    b = rng.dirichlet(np.ones(n), count).astype(np.float32)
    a = rng.uniform(0, 1, count).astype(np.float32)
    return ObjectPrediction(4, (12, 10), cells, a, b, rng.normal(size=(count, n, 3)).astype(np.float32))


@pytest.mark.parametrize(("tau_a", "tau_b"), [(0.1, 0.5), (0.6, 0.9), (0.0, 0.0)])
def test_correspondences_are_those_of_the_thesis(tau_a, tau_b):
    p, expected = prediction(), []
    for k, (column, row) in enumerate(p.cells):
        for f in range(6):
            a, b = p.object_probability[k], p.fragment_probability[k, f]
            if a > tau_a and b / p.fragment_probability[k].max() > tau_b:
                x = FRAGMENTS.sizes[f] * p.coordinates[k, f] + FRAGMENTS.centers[f]
                expected.append((4 * column + 1.5, 4 * row + 1.5, *x, a * b, f))
    found = establish(p, FRAGMENTS, CorrespondenceConfig(tau_a, tau_b))
    columns = [found.pixels, found.points_in_model, found.confidence[:, None], found.fragment_ids[:, None]]
    np.testing.assert_allclose(np.hstack(columns), expected, rtol=1e-6)
    assert found.obj_id == 4


def test_pixel_ids_tell_cells_apart():
    found = establish(prediction(), FRAGMENTS)
    pairs = {
        (*pixel, key)
        for pixel, key in zip(found.pixels.tolist(), found.pixel_ids.tolist(), strict=False)
        for pixel in [tuple(pixel)]
    }
    assert len(pairs) == len(np.unique(found.pixel_ids)) == len(np.unique(found.pixels, axis=0))
    assert len(found) > len(pairs)  # many to many


def test_without_regression_points_are_centers():
    found = establish(prediction(), FRAGMENTS, CorrespondenceConfig(regression=False))
    np.testing.assert_allclose(found.points_in_model, FRAGMENTS.centers[found.fragment_ids])


def test_no_cell_gives_no_correspondences():
    assert len(establish(prediction(0), FRAGMENTS)) == 0


def test_another_number_of_fragments_is_refused():
    with pytest.raises(InputError, match="object 4: the network predicts 5 fragments, the object has 6"):
        establish(prediction(n=5), FRAGMENTS)


def test_thresholds_outside_0_to_1_are_refused():
    with pytest.raises(InputError, match=r"EPOS: min_fragment_probability is 1.0; expected 0 to less than 1"):
        CorrespondenceConfig(min_fragment_probability=1.0)
