"""The search for poses as it is replayed: what each hypothesis was, and what is said and drawn of it."""

import numpy as np
import pytest

from inspector.epos.figures import MOST_DOTS, decisions_html, search_html, step_at
from inspector.epos.search import MOST_STOPS, Search
from pipeline.recording import Hypotheses

LABELS = ("early", "sample", "optimized, best so far", "sample", "optimized", "final, best so far")
QUALITY = np.array([0.9, 0.2, 0.5, 0.3, 0.4, 0.6])
SAMPLES = np.array([[0, 1, 2], [3, 4, 5], [3, 4, 5], [6, 7, 8], [6, 7, 9], [-1, -1, -1]])


def search(labels: tuple[str, ...] = LABELS, samples: np.ndarray | None = SAMPLES, correspondences: int = 10) -> Search:
    poses = np.broadcast_to(np.eye(4), (len(QUALITY), 4, 4)).copy()
    poses[:, 2, 3] = np.arange(len(QUALITY))
    return Search(Hypotheses(1, poses, QUALITY, samples=samples, labels=labels), correspondences)


def test_local_optimization_is_told_with_what_it_began_from():
    found = search().at(2)
    assert (found.stage, found.best, found.quality) == ("optimized", True, 0.5)
    assert found.camera_from_model[2, 3] == 2
    assert found.before is not None
    assert (found.before.stage, found.before.quality) == ("sample", 0.2)


def test_of_another_triplet_it_did_not_begin():
    assert search().at(4).before is None


def test_triplets_are_rows_of_the_correspondences():
    assert str(search().at(1).triplet) == "[3 4 5]"
    assert search().at(5).triplet is None, "it came from none"
    assert search(correspondences=5).at(1).triplet is None, "these correspondences were not recorded"
    assert search(samples=None).at(1).triplet is None


def test_hypotheses_dropped_early_do_not_count_as_the_best():
    assert search().best_quality.tolist() == [0.0, 0.2, 0.5, 0.5, 0.5, 0.6]


def test_a_method_that_names_no_stages_has_its_best_by_quality():
    other = search(labels=(), samples=None)
    assert np.flatnonzero(other.best).tolist() == [0]
    assert other.at(3).stage == "hypothesis"
    assert other.best_quality.tolist() == [0.9] * 6


def test_the_next_best_comes_after_and_then_again_from_the_start():
    found = search()
    assert [found.next_best(i) for i in (None, 0, 2, 5)] == [2, 2, 5, 2]


@pytest.mark.parametrize("asked", [-3, 6, 10**6])
def test_an_address_may_ask_for_a_hypothesis_that_is_not_there(asked):
    assert search().at(asked).position in (0, 5)


def long_search(count: int) -> Search:
    quality = np.random.default_rng(0).random(count) * 0.5
    quality[count // 3] = 0.75
    labels = ["sample"] * count
    labels[count // 3] = "sample, best so far"
    return Search(Hypotheses(1, np.tile(np.eye(4), (count, 1, 1)), quality, labels=tuple(labels)), 0)


def test_a_long_search_is_replayed_in_a_minute_and_misses_no_best():
    found = long_search(20_000)
    assert len(found.stops) <= MOST_STOPS + 1
    assert 20_000 // 3 in found.stops
    assert {0, 19_999} <= set(found.stops.tolist())


def test_the_plot_of_a_long_search_stays_small_and_shows_the_best():
    drawn = search_html(long_search(20_000), None)
    assert drawn.count("<circle") <= MOST_DOTS + 1
    assert 'r="2.8"' in drawn


def test_a_click_on_the_plot_goes_to_the_hypothesis_under_it():
    found = search()
    assert step_at(found, 0.0) == 0
    assert step_at(found, 1.0) == 5
    x = float(search_html(found, 3).split('class="pi-epos-shown" cx="')[1].split('"')[0])
    assert step_at(found, x / 340) == 3


def test_texts_of_the_search_are_escaped():
    assert decisions_html(("taken: <b>1</b>", "2 poses; why")) == (
        '<ul class="pi-epos-list"><li><b>taken</b> &lt;b&gt;1&lt;/b&gt;</li><li><b>found</b> 2 poses; why</li></ul>'
    )
