import numpy as np
import pytest

from pipeline.bop.evaluation.matching import match
from pipeline.bop.evaluation.scores import (
    MSPD_THETAS_PX,
    THETAS,
    FoundInstances,
    Scores,
    average_recalls,
    average_recalls_by,
    found,
    most_visible,
    recalls,
)


def instances(mssd: list[list[bool]], obj_id: list[int] | None = None, vsd: np.ndarray | None = None) -> FoundInstances:
    """Instances with the given MSSD, none of which is found by MSPD."""
    at, ids = np.array(mssd, bool), np.arange(len(mssd))
    objects = np.array(obj_id or [1] * len(mssd))
    return FoundInstances(ids, ids, objects, ids, np.ones(len(mssd)), at, np.zeros_like(at), vsd)


def test_thresholds_are_those_of_bop():
    np.testing.assert_allclose(THETAS, [0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5], rtol=1e-15)
    assert MSPD_THETAS_PX.tolist() == [5, 10, 15, 20, 25, 30, 35, 40, 45, 50]


@pytest.mark.parametrize("seed", range(40))
def test_found_is_the_greedy_matching_at_every_threshold(seed: int):
    rng = np.random.default_rng(seed)
    errors = rng.choice([0.0, 0.05, 0.1, 0.12, 0.3, 0.31, np.inf, np.nan], size=rng.integers(0, 6, 2))
    thresholds = np.array([0.05, 0.1, 0.2, 0.5])
    expected = [[g in match(errors, theta).tolist() for theta in thresholds.tolist()] for g in range(errors.shape[1])]
    assert found(errors, thresholds).tolist() == expected


def test_an_error_equal_to_the_threshold_is_not_below_it():
    thresholds = np.array([0.05, 0.1])
    assert found(np.array([[0.05]]), thresholds).tolist() == [[False, True]]
    assert found(np.array([[0.05, 9.0]]), thresholds).tolist() == [[False, True], [False, False]]


def test_a_duplicate_finds_nothing_more():
    assert found(np.array([[0.01, 9.0], [0.0, 9.0]]), np.array([0.5])).tolist() == [[True], [False]]


def test_a_better_scored_estimate_may_take_the_instance_that_a_later_one_needs():
    errors = np.array([[0.3, 0.2], [9.0, 0.1]])
    assert found(errors, np.array([0.25, 0.4])).tolist() == [[False, False], [True, True]]


def test_the_most_visible_instances_count_and_of_equal_ones_the_first():
    assert most_visible([0.2, 0.9, 0.5], 2) == [1, 2]
    assert most_visible([0.5, 0.5, 0.5], 2) == [0, 1]
    assert most_visible([0.5], 3) == [0]


def test_recall_is_pooled_over_objects():
    three_of_object_1 = instances([[True], [True], [True], [False]], obj_id=[1, 1, 1, 2])
    assert average_recalls(three_of_object_1).mssd == 0.75  # a mean over objects would be 0.5
    by_object = average_recalls_by(three_of_object_1, three_of_object_1.obj_id)
    assert {obj_id: scores.mssd for obj_id, scores in by_object.items()} == {1: 1.0, 2: 0.0}


def test_recall_of_nothing_is_zero():
    assert recalls(np.zeros((0, 10), bool)).tolist() == [0.0] * 10


def test_the_average_is_that_of_all_three_errors_or_none():
    assert Scores(0.3, 0.6, 0.9).average == pytest.approx(0.6, abs=1e-15)
    assert Scores(None, 0.6, 0.9).average is None


def test_vsd_is_averaged_over_tolerances_and_thresholds():
    vsd = np.zeros((2, 10, 10), bool)
    vsd[0, :, 5:] = True
    assert average_recalls(instances([[True] * 10, [False] * 10], vsd=vsd)) == (0.25, 0.5, 0.0)
