import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.bop.dataset import open_dataset
from pipeline.bop.evaluation.average_precision import average_precision
from pipeline.bop.evaluation.columns import Execution
from pipeline.bop.evaluation.detection_outcomes import LEFT_OUT, RIGHT, WRONG
from pipeline.bop.evaluation.pose_detection import PoseDetectionEvaluation, evaluate_pose_detection
from pipeline.bop.results import read_results
from pipeline.exceptions import FormatError, InputError
from tests.random_dataset import (
    DIAMETERS,
    Row,
    greedy,
    make_random,
    read_scene,
    slow_mspd,
    slow_mssd,
    write_rows,
)
from tests.tiny_dataset import ANNOTATED, FIRST, SECOND, claim, make_dataset, moved, results_of

(_, LEFT), (_, RIGHT_BOX), (_, SMALL) = ANNOTATED[FIRST]
((_, ALONE),) = ANNOTATED[SECOND]


# ---- parity with the rules, followed one by one


def slow_average_precision(detections: list[tuple[float, bool]], demanded: int) -> float:
    """Of scores and whether they are right, in the order in which equal scores stay."""
    detections = sorted(detections, key=lambda detection: -detection[0])
    recalls, precisions, right = [], [], 0
    for number, (_, is_right) in enumerate(detections, start=1):
        right += is_right
        recalls.append(right / float(demanded))
        precisions.append(right / number)
    sampled = []
    for recall in np.linspace(0, 1, 101):
        reached = [p for r, p in zip(recalls, precisions, strict=True) if r >= recall]
        sampled.append(max(reached, default=0.0))
    return float(np.mean(sampled))


def slow_scores(root: Path, rows: list[Row], most: int = 100) -> dict[str, float]:
    """The benchmark's rules for 6D detection, from the files, in plain loops."""
    images = []  # scene, image, annotations, fractions, the best rows
    for folder in sorted((root / "test").iterdir()):
        truths, infos = (read_scene(root, int(folder.name), name) for name in ("gt", "gt_info"))
        for im_id, entries in truths.items():
            own = [row for row in rows if (row["scene_id"], row["im_id"]) == (int(folder.name), im_id)]
            best = sorted(own, key=lambda row: -row["score"])[:most]
            images.append((entries, [info["visib_fract"] for info in infos[im_id]], best))
    thresholds = {"mssd": np.arange(0.05, 0.51, 0.05), "mspd": np.arange(5, 51, 5), "mssd_mm": range(2, 21, 2)}
    means = {}
    for error, thetas in thresholds.items():
        of_objects = []
        for obj_id in (1, 2):
            demanded = sum(
                entry["obj_id"] == obj_id and fraction >= 0.1
                for entries, fractions, _ in images
                for entry, fraction in zip(entries, fractions, strict=True)
            )
            if demanded == 0:
                continue
            of_thresholds = []
            for theta in thetas:
                detections = []
                for entries, fractions, best in images:
                    instances = [i for i, entry in enumerate(entries) if entry["obj_id"] == obj_id]
                    claims = [row for row in best if row["obj_id"] == obj_id]
                    errors = {
                        (e, g): slow_error(error, claim_, entries[i])
                        for e, claim_ in enumerate(claims)
                        for g, i in enumerate(instances)
                    }
                    matched = greedy(errors, len(claims), len(instances), theta)
                    for e, claim_ in enumerate(claims if instances else []):
                        if e not in matched:
                            detections.append((claim_["score"], False))
                        elif fractions[instances[matched[e]]] >= 0.1:
                            detections.append((claim_["score"], True))
                of_thresholds.append(slow_average_precision(detections, demanded))
            of_objects.append(np.mean(of_thresholds))
        means[error] = float(np.mean(of_objects))
    return {
        "bop24_mAP": float(np.mean([means["mssd"], means["mspd"]])),
        "bop24_mAP_mssd": means["mssd"],
        "bop24_mAP_mspd": means["mspd"],
        "bop24_mAP_mssd_mm": means["mssd_mm"],
        "bop25_mAP": means["mssd"],
        "bop25_mAP_mm": means["mssd_mm"],
    }


def slow_error(error: str, row: Row, truth: dict) -> float:
    if error == "mspd":
        return slow_mspd(row, truth)
    return slow_mssd(row, truth) / (DIAMETERS[row["obj_id"]] if error == "mssd" else 1.0)


@pytest.mark.parametrize("seed", range(25))
def test_scores_equal_the_rules_to_the_last_digit(tmp_path: Path, seed: int):
    rows = make_random(tmp_path / "random", seed)
    results = read_results(write_rows(tmp_path / "method_random-test.csv", rows))
    evaluation = evaluate_pose_detection(open_dataset(tmp_path / "random"), results)
    assert dict(evaluation.summary.scores) == slow_scores(tmp_path / "random", rows)


def test_random_cases_are_neither_all_right_nor_all_wrong(tmp_path: Path):
    make = [slow_scores(tmp_path / str(s), make_random(tmp_path / str(s), s))["bop24_mAP"] for s in range(8)]
    assert 0.1 < np.mean(make) < 0.9
    assert len(set(make)) == len(make)


@pytest.mark.parametrize("seed", range(200))
def test_average_precision_of_random_detections(seed: int):
    rng = np.random.default_rng(seed)
    demanded = int(rng.integers(1, 30))
    right = np.zeros(rng.integers(0, 60), bool)
    right[rng.permutation(len(right))[:demanded]] = rng.random() < 0.9
    slow = slow_average_precision([(0.0, bool(is_right)) for is_right in right], demanded)
    assert average_precision(right, demanded) == slow


# ---- cases of known precision


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    """The tiny dataset, all of whose instances are visible, but for the one of box 2, of which 5 % are."""
    root = make_dataset(tmp_path / "tiny")
    info = {"0": [{"visib_fract": f} for f in (0.9, 0.1, 0.05)], "1": [{"visib_fract": 1.0}]}
    (root / "test" / "000001" / "scene_gt_info.json").write_text(json.dumps(info))
    return root


def evaluated(root: Path, *claims) -> PoseDetectionEvaluation:
    return evaluate_pose_detection(open_dataset(root), results_of(*claims))


ALL = (claim(FIRST, 1, LEFT, 0.9), claim(FIRST, 1, RIGHT_BOX, 0.8), claim(SECOND, 1, ALONE, 0.7))


def test_right_estimates_of_all_that_is_visible_score_one(tiny: Path):
    evaluation = evaluated(tiny, *ALL)
    assert set(evaluation.summary.scores.values()) == {1.0}
    assert evaluation.summary.targets_per_object == {1: 3}  # box 2 does not have to be detected


def test_an_estimate_of_what_is_hardly_visible_is_neither_right_nor_wrong(tiny: Path):
    evaluation = evaluated(tiny, *ALL, claim(FIRST, 2, SMALL, 1.0))
    assert evaluation.summary.scores["bop24_mAP"] == 1.0
    outcomes = evaluation.outcomes
    assert outcomes.mssd[(outcomes.row == 3)].tolist() == [[LEFT_OUT] * 10]


def test_a_wrong_estimate_above_the_right_ones_costs_precision(tiny: Path):
    wrong = claim(FIRST, 1, moved(LEFT, x=1.0), 1.0)
    first_wrong = evaluated(tiny, *ALL, wrong)
    assert first_wrong.summary.scores["bop24_mAP"] == 0.75  # the best precision is that of 3 of 4
    last_wrong = evaluated(tiny, *ALL, wrong.__class__(**{**vars(wrong), "score": 0.1}))
    assert last_wrong.summary.scores["bop24_mAP"] == 1.0


def test_a_missed_instance_costs_recall(tiny: Path):
    found = evaluated(tiny, *ALL[:2])
    assert found.summary.scores["bop24_mAP"] == pytest.approx(67 / 101, abs=1e-15)  # recalls 0, 0.01, ..., 0.66
    at = found.outcomes
    assert at.mssd[(at.im_id == 1) & (at.gt_index == 0)].tolist() == [[WRONG] * 10]
    assert at.mssd[(at.im_id == 0) & (at.gt_index == 1)].tolist() == [[RIGHT] * 10]


def test_a_second_estimate_of_an_instance_is_wrong(tiny: Path):
    doubled = evaluated(tiny, *ALL, claim(FIRST, 1, LEFT, 0.95))
    assert doubled.summary.scores["bop24_mAP"] < 1.0


def test_estimates_of_objects_that_are_not_in_the_image_do_not_count(tiny: Path):
    evaluation = evaluated(tiny, *ALL, claim(SECOND, 2, ALONE, 1.0))
    assert evaluation.summary.scores["bop24_mAP"] == 1.0
    assert any("not annotated in their image do not count (BOP's rule): 1" in note for note in evaluation.summary.notes)


def test_the_hundred_best_estimates_of_an_image_count(tiny: Path):
    far = [claim(SECOND, 1, moved(ALONE, x=1.0), 1.0)] * 100
    assert (
        evaluated(tiny, *ALL, *far[:99]).summary.scores["bop24_mAP_mssd"]
        > evaluated(tiny, *ALL, *far).summary.scores["bop24_mAP_mssd"]
    )
    assert (evaluated(tiny, *ALL, *far).outcomes.row >= 0).sum() == 2 + 100


def test_images_are_those_of_the_list_of_2024(tiny: Path):
    (tiny / "test_targets_bop24.json").write_text(json.dumps([{"scene_id": 1, "im_id": 1}]))
    evaluation = evaluated(tiny, ALL[2])
    assert evaluation.summary.scores["bop24_mAP"] == 1.0
    assert evaluation.summary.targets == 1


def test_listed_images_that_are_not_here_are_told(tiny: Path):
    (tiny / "test_targets_bop24.json").write_text(json.dumps([{"scene_id": 1, "im_id": i} for i in (1, 2, 3)]))
    assert evaluated(tiny, ALL[2]).summary.incomplete == "1 of the 3 images of test_targets_bop24.json are here"


# ---- unknown visibility


def without_fractions(root: Path, **counts: int) -> Path:
    """Only the list of 2019 tells what is visible: counts of box 1 by image, and of box 2 in image 0."""
    (root / "test" / "000001" / "scene_gt_info.json").unlink()
    entries = [
        {"scene_id": 1, "im_id": int(name[2]), "obj_id": int(name[4]), "inst_count": n} for name, n in counts.items()
    ]
    (root / "test_targets_bop19.json").write_text(json.dumps(entries))
    return root


def test_the_list_of_2019_tells_what_is_visible_where_nothing_else_does(tiny: Path):
    root = without_fractions(tiny, im0_1=2, im1_1=1)
    evaluation = evaluated(root, *ALL)
    assert evaluation.summary.targets_per_object == {1: 3}
    assert evaluation.summary.scores["bop24_mAP"] == 1.0
    assert "of 4 annotated instances" in evaluation.summary.notes[0]
    assert "list of targets of 2019" in evaluation.summary.notes[0]


def test_which_of_several_is_visible_is_not_guessed(tiny: Path):
    root = without_fractions(tiny, im0_1=1, im1_1=1)
    with pytest.raises(FormatError, match=r"unknown which of the 2 instances of object 1 are visible.*asks for 1; add"):
        evaluated(root, *ALL)
    (root / "test_targets_bop19.json").unlink()
    with pytest.raises(FormatError, match=r"visible by 10 %; add the scene's scene_gt_info\.json: inspector gt-info"):
        evaluated(root, *ALL)


def test_nothing_to_detect_is_refused(tiny: Path):
    info = {"0": [{"visib_fract": 0.0}] * 3, "1": [{"visib_fract": 0.0}]}
    (tiny / "test" / "000001" / "scene_gt_info.json").write_text(json.dumps(info))
    with pytest.raises(InputError, match="tiny/test: no instance is visible by 10 %"):
        evaluated(tiny, *ALL)


# ---- real data, pieces


def test_lmo_on_real_estimates(lmo: Path):
    results = read_results(lmo / "results" / "megapose_lmo-test.csv")
    evaluation = evaluate_pose_detection(open_dataset(lmo), results)
    scores = evaluation.summary.scores
    assert 0.3 < scores["bop24_mAP_mssd"] < scores["bop24_mAP_mspd"] < 0.7  # type: ignore[operator]
    outcomes = evaluation.outcomes
    claims = outcomes.row >= 0
    rows = outcomes.row[claims]
    assert len(np.unique(rows)) == len(rows) == len(results)
    assert (results.obj_id[rows] == outcomes.obj_id[claims]).all()
    assert (results.score[rows] == outcomes.score[claims]).all()


def test_pieces_do_not_change_the_scores(lmo: Path, monkeypatch: pytest.MonkeyPatch):
    results, dataset = read_results(lmo / "results" / "megapose_lmo-test.csv"), open_dataset(lmo)
    whole = evaluate_pose_detection(dataset, results)
    monkeypatch.setattr("pipeline.bop.evaluation.columns.TARGETS_PER_PIECE", 1)
    in_pieces = evaluate_pose_detection(dataset, results, execution=Execution())
    assert in_pieces.summary.scores == whole.summary.scores
    assert (in_pieces.outcomes.row == whole.outcomes.row).all()
