from dataclasses import replace

import pytest

from pipeline.bop.evaluation.over_datasets import challenge, check_once_each, means_over_datasets
from pipeline.bop.evaluation.summary import Summary
from pipeline.exceptions import InputError

CORE = ("hb", "icbin", "itodd", "lmo", "tless", "tudl", "ycbv")


def summary(dataset: str, score: float | None, method: str = "mine", **more) -> Summary:
    scores = {"bop19_average_recall": score, "bop19_average_recall_mssd": 0.5}
    return replace(Summary(dataset, "test", "localization", method, scores, {}, {}, 1, {}, 1.0), **more)


def test_the_core_datasets_are_seven():
    assert sorted(challenge("localization")) == list(CORE)
    assert sorted(challenge("siso")) == ["icbin", "icmi", "lm", "lmo", "ruapc", "tless", "tudl"]


def test_all_core_datasets_whole_give_the_score_of_the_challenge():
    (mean,) = means_over_datasets([summary(name, i / 10) for i, name in enumerate(CORE)])
    assert (mean.label, mean.complete) == ("AR_Core", True)
    assert mean.scores["bop19_average_recall"] == pytest.approx(0.3, abs=1e-15)


def test_some_core_datasets_are_named_for_what_they_are():
    (mean,) = means_over_datasets([summary("lmo", 0.2), summary("tless", 0.4)])
    assert (mean.label, mean.complete) == ("mean over 2 of 7 core datasets", False)
    assert mean.missing == ("hb", "icbin", "itodd", "tudl", "ycbv")


def test_a_dataset_in_part_is_not_taken_for_the_whole():
    parts = [summary(name, 0.5, incomplete="3 of the 9 instances" if name == "hb" else "") for name in CORE]
    (mean,) = means_over_datasets(parts)
    assert (mean.label, mean.complete) == ("mean over 7 of 7 core datasets, not all of them whole", False)
    assert mean.incomplete == {"hb": "3 of the 9 instances"}


def test_other_datasets_are_left_out_beside_core_ones_and_averaged_without_any():
    (mean,) = means_over_datasets([summary("lmo", 0.2), summary("mine", 1.0)])
    assert mean.scores["bop19_average_recall"] == 0.2
    assert mean.datasets == ("lmo",)
    (own,) = means_over_datasets([summary("a", 0.0), summary("b", 1.0)])
    assert (own.label, own.scores["bop19_average_recall"]) == ("mean over 2 datasets", 0.5)


def test_a_score_that_a_dataset_lacks_has_no_mean():
    (mean,) = means_over_datasets([summary("lmo", 0.2), summary("tless", None)])
    assert mean.scores == {"bop19_average_recall": None, "bop19_average_recall_mssd": 0.5}


def test_each_method_has_its_mean():
    means = means_over_datasets([summary("lmo", 0.2), summary("lmo", 0.6, "other"), summary("tless", 0.4)])
    assert [(mean.method, len(mean.datasets)) for mean in means] == [("mine", 2), ("other", 1)]


def test_two_results_for_one_dataset_are_refused():
    with pytest.raises(InputError, match="two results files of mine for lmo: a mean over datasets takes one of each"):
        means_over_datasets([summary("lmo", 0.2), summary("lmo", 0.3)])
    check_once_each([("mine", "lmo"), ("mine", "tless"), ("other", "lmo")])
