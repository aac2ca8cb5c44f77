"""Bars and curves of the leaderboard: the numbers of the evaluation, and gaps where there is nothing."""

import numpy as np
import pytest

from inspector.leaderboard.figures import Entry, figures
from inspector.selection import Board
from pipeline.bop.evaluation.evaluate import Evaluation
from pipeline.bop.evaluation.scores import FoundInstances


def evaluation(method: str = "method", vsd: bool = True) -> Evaluation:
    """Four instances: object 1 found at the larger half of the thresholds, object 2 never; visible 15 % and 95 %."""
    found = np.zeros((4, 10), bool)
    found[:2, 5:] = True
    return Evaluation(
        "tiny",
        method,
        FoundInstances(
            scene_id=np.array([1, 1, 2, 2]),
            im_id=np.array([0, 1, 0, 1]),
            obj_id=np.array([1, 1, 2, 2]),
            gt_index=np.zeros(4, int),
            visible_fraction=np.array([0.15, 0.95, 0.95, np.nan]),
            mssd=found,
            mspd=np.ones((4, 10), bool),
            vsd=np.repeat(found[:, None], 10, axis=1) if vsd else None,
        ),
        "" if vsd else "no depth",
        0.1,
    )


def curve(page: dict, title: str) -> dict:
    return next(item for item in page["curves"] if item["title"] == title)


def test_bars_are_the_scores_per_object_or_scene():
    entry = Entry("first", 7, evaluation())
    of_objects = figures([entry], Board(score="mssd"))
    assert [group["label"] for group in of_objects["groups"]] == ["object 1", "object 2"]
    assert [group["values"] for group in of_objects["groups"]] == [[0.5], [0.0]]
    assert [group["filter"] for group in of_objects["groups"]] == [{"obj_id": 1}, {"obj_id": 2}]
    of_scenes = figures([entry], Board(score="average", by="scene"))
    assert of_scenes["groups"][0]["values"] == [pytest.approx((0.5 + 0.5 + 1.0) / 3)]
    assert of_scenes["groups"][1]["filter"] == {"scene_id": 2}


def test_two_methods_stand_side_by_side():
    page = figures([Entry("first", 7, evaluation("a")), Entry("second", 8, evaluation("b"))], Board())
    assert [(m["place"], m["submission"], m["name"]) for m in page["methods"]] == [
        ("first", 7, "a"),
        ("second", 8, "b"),
    ]
    assert all(len(group["values"]) == 2 for group in page["groups"])
    assert all([line["method"] for line in item["lines"]] == [0, 1] for item in page["curves"])


def test_curves_are_the_recall_at_each_threshold():
    page = figures([Entry("first", 7, evaluation())], Board())
    assert curve(page, "MSSD")["x"][:3] == [0.05, 0.1, 0.15]
    assert curve(page, "MSSD")["lines"][0]["y"] == [0.0] * 5 + [0.5] * 5
    assert curve(page, "MSPD")["lines"][0]["y"] == [1.0] * 10


def test_the_visible_fraction_has_gaps_where_there_are_no_instances():
    page = figures([Entry("first", 7, evaluation())], Board(score="mssd"))
    line = curve(page, "AR_MSSD over visible fraction")["lines"][0]["y"]
    assert line[1] == 0.5
    assert line[9] == 0.25
    assert [value for i, value in enumerate(line) if i not in (1, 9)] == [None] * 8


def test_without_depth_there_is_no_curve_of_vsd_and_no_ar():
    page = figures([Entry("first", 7, evaluation(vsd=False))], Board())
    assert "VSD" not in {item["title"] for item in page["curves"]}
    assert page["groups"][0]["values"] == [None]


def test_nothing_marked_gives_no_bars_and_no_lines():
    page = figures([], Board())
    assert page["methods"] == page["groups"] == []
    assert all(item["lines"] == [] for item in page["curves"])
