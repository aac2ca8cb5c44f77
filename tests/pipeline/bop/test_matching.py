import numpy as np

from pipeline.bop.evaluation.matching import assign, match


def test_each_estimate_takes_the_free_ground_truth_of_lowest_error_in_order_of_score():
    errors = np.array([[0.2, 0.1], [0.05, 0.01], [0.3, 0.3]])
    assert match(errors, 0.5).tolist() == [1, 0, -1]


def test_scores_decide_the_order_and_equal_scores_keep_theirs():
    errors = np.array([[0.2, 0.1], [0.05, 0.01], [0.3, 0.02]])
    assert match(errors, 0.5, scores=np.array([0.1, 0.9, 0.9])).tolist() == [-1, 1, 0]


def test_the_best_score_wins_even_if_a_later_estimate_is_nearer():
    assert match(np.array([[0.4], [0.0]]), 0.5, scores=np.array([0.9, 0.1])).tolist() == [0, -1]


def test_an_error_equal_to_the_threshold_is_no_match():
    assert match(np.array([[0.3]]), 0.3).tolist() == [-1]
    assert match(np.array([[0.3]]), 0.3 + 1e-12).tolist() == [0]


def test_an_invalid_ground_truth_is_left_out():
    assert match(np.array([[0.1, 0.2]]), 0.5, valid=np.array([False, True])).tolist() == [1]
    assert match(np.array([[0.1, 0.7]]), 0.5, valid=np.array([False, True])).tolist() == [-1]


def test_infinite_and_undefined_errors_never_match():
    errors = np.array([[np.nan, np.inf], [np.nan, 3.0]])
    assert match(errors, np.inf).tolist() == [-1, 1]


def test_of_equal_errors_the_first_ground_truth_is_taken():
    assert match(np.array([[0.1, 0.1]]), 0.5).tolist() == [0]


def test_errors_are_not_changed():
    errors = np.array([[0.2, 0.1], [0.05, 0.01]])
    before = errors.copy()
    match(errors, 0.5, valid=np.array([True, False]))
    np.testing.assert_array_equal(errors, before)


def test_assign_gives_every_ground_truth_an_estimate_however_far_off():
    errors = np.array([[7.0, 9.0], [8.0, 0.1], [0.0, 0.0]])
    assert assign(errors).tolist() == [0, 1]
    assert assign(errors, scores=np.array([1.0, 2.0, 3.0])).tolist() == [2, 1]


def test_assign_says_where_no_estimate_is_left():
    assert assign(np.array([[0.1, 0.2]])).tolist() == [0, -1]


def test_no_estimates_or_no_ground_truth_is_no_error():
    assert match(np.empty((0, 3)), 1.0).tolist() == []
    assert match(np.empty((2, 0)), 1.0).tolist() == [-1, -1]
    assert assign(np.empty((0, 3))).tolist() == [-1, -1, -1]
    assert assign(np.empty((2, 0))).tolist() == []
