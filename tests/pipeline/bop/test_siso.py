import csv
import json
from pathlib import Path

import numpy as np
import pytest

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.evaluation.curves import siso_curves
from pipeline.bop.evaluation.siso import SisoEvaluation, evaluate_siso
from pipeline.bop.results import read_results
from pipeline.exceptions import FormatError, InputError
from pipeline.scene import ImageKey
from tests.conftest import REPOSITORY
from tests.slow_vsd import slow_vsd
from tests.tiny_dataset import ANNOTATED, FIRST, SECOND, claim, make_dataset, moved, perfect, results_of

(_, LEFT), (_, RIGHT), (_, SMALL) = ANNOTATED[FIRST]
((_, ALONE),) = ANNOTATED[SECOND]
DEMO = REPOSITORY / "assets" / "demo"


@pytest.fixture
def tiny(tmp_path: Path) -> Path:
    """The tiny dataset with depth: three pairs of an image and an object."""
    return make_dataset(tmp_path / "tiny")


def evaluated(root: Path, *claims) -> SisoEvaluation:
    return evaluate_siso(open_dataset(root), results_of(*claims))


def recall(root: Path, *claims) -> float | None:
    return evaluated(root, *claims).summary.scores["siso_recall"]


# ---- parity with the equations


def slow_recall(dataset: Dataset, results: Path) -> dict[tuple[int, int, int], bool]:
    """Whether each target is found, in plain loops over the files."""
    with results.open() as file:
        rows = list(csv.DictReader(file))
    found = {}
    for target in json.loads((dataset.root / "test_targets_bop19.json").read_text()):
        ids = [target[name] for name in ("scene_id", "im_id", "obj_id")]
        folder = dataset.root / "test" / f"{ids[0]:06d}"
        truths = json.loads((folder / "scene_gt.json").read_text())[str(ids[1])]
        infos = json.loads((folder / "scene_gt_info.json").read_text())[str(ids[1])]
        visible = [
            truth
            for truth, info in zip(truths, infos, strict=True)
            if truth["obj_id"] == ids[2] and info["visib_fract"] >= 0.1
        ]
        if not visible:
            continue
        best = None
        for row in rows:
            same = [int(row[name]) for name in ("scene_id", "im_id", "obj_id")] == ids
            if same and (best is None or float(row["score"]) > float(best["score"])):
                best = row
        errors = [1.0]
        if best is not None:
            estimate = matrix(np.array(best["R"].split(), float), np.array(best["t"].split(), float))
            poses = [matrix(truth["cam_R_m2c"], truth["cam_t_m2c"]) for truth in visible]
            errors = [
                slow_vsd(dataset, ImageKey(*ids[:2]), ids[2], estimate, pose, [0.020], False)[0] for pose in poses
            ]
        found[tuple(ids)] = min(errors) < 0.3
    return found


def matrix(R, t_mm) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = np.reshape(R, (3, 3)), np.array(t_mm) / 1000
    return pose


def test_recall_on_the_demo_equals_the_equations():
    path, dataset = DEMO / "results" / "perturbed-1_demo-test.csv", open_dataset(DEMO)
    evaluation = evaluate_siso(dataset, read_results(path))
    slow = slow_recall(dataset, path)
    targets = evaluation.targets
    assert targets is not None
    keys = zip(targets.scene_id.tolist(), targets.im_id.tolist(), targets.obj_id.tolist(), strict=True)
    assert dict(zip(keys, targets.found.tolist(), strict=True)) == slow
    summary = evaluation.summary
    assert summary.scores["siso_recall"] == sum(slow.values()) / len(slow)
    for number, per in ((0, summary.per_scene), (2, summary.per_object)):
        for i, scores in per.items():
            of_id = [found for ids, found in slow.items() if ids[number] == i]
            assert scores["siso_recall"] == sum(of_id) / len(of_id)


# ---- cases of known recall


def test_perfect_estimates_find_all_targets(tiny: Path):
    evaluation = evaluate_siso(open_dataset(tiny), perfect())
    assert evaluation.summary.scores["siso_recall"] == 1.0
    assert evaluation.summary.targets == 3  # box 1 in both images, box 2 in one
    assert evaluation.summary.targets_per_object == {1: 2, 2: 1}


def test_any_instance_of_the_object_will_do(tiny: Path):
    assert recall(tiny, claim(FIRST, 1, LEFT)) == recall(tiny, claim(FIRST, 1, RIGHT)) == 1 / 3


def test_only_the_best_scored_estimate_counts(tiny: Path):
    wrong = moved(LEFT, y=-0.05)
    assert recall(tiny, claim(FIRST, 1, LEFT, 0.5), claim(FIRST, 1, wrong, 0.6)) == 0.0
    assert recall(tiny, claim(FIRST, 1, LEFT, 0.6), claim(FIRST, 1, wrong, 0.5)) == 1 / 3
    assert recall(tiny, claim(FIRST, 1, LEFT, 0.5), claim(FIRST, 1, wrong, 0.5)) == 1 / 3  # the first in the file


def test_an_instance_visible_by_less_than_a_tenth_is_no_target_and_no_help(tiny: Path):
    info = {"0": [{"visib_fract": f} for f in (0.09, 0.1, 0.0)], "1": [{"visib_fract": 1.0}]}
    (tiny / "test" / "000001" / "scene_gt_info.json").write_text(json.dumps(info))
    assert recall(tiny, claim(FIRST, 1, LEFT)) == 0.0
    assert recall(tiny, claim(FIRST, 1, RIGHT)) == 0.5  # of two: box 2 is not asked for


def test_a_shift_along_the_axis_counts_in_millimetres(tiny: Path):
    assert recall(tiny, claim(SECOND, 1, moved(ALONE, z=0.010))) == 1 / 3
    assert recall(tiny, claim(SECOND, 1, moved(ALONE, z=-0.026))) == 0.0


def test_targets_are_those_of_2017_where_they_are_listed(tiny: Path):
    entry = {"scene_id": 1, "im_id": 1, "obj_id": 1, "inst_count": 1}
    (tiny / "test_targets_bop18.json").write_text(json.dumps([entry]))
    evaluation = evaluated(tiny, claim(SECOND, 1, ALONE))
    assert evaluation.summary.scores["siso_recall"] == 1.0
    assert evaluation.summary.targets == 1


def test_curves_count_targets_by_tolerance_threshold_and_visibility(tiny: Path):
    evaluation = evaluated(tiny, claim(FIRST, 1, moved(LEFT, z=0.05)), claim(SECOND, 1, ALONE))
    assert evaluation.targets is not None
    found = siso_curves(evaluation.targets)
    assert found.count == 3
    assert found.vsd[0, 5] == evaluation.summary.scores["siso_recall"] == 1 / 3  # tau 20 mm, theta 0.3
    assert found.vsd[1, -2] == 2 / 3  # tau 80 mm
    assert found.per_visibility.sum() == 0  # unknown in the tiny dataset
    assert siso_curves(evaluation.targets, evaluation.targets.im_id == 1).vsd[0].tolist() == [1.0] * 20


# ---- what cannot be scored


def test_without_depth_the_recall_is_none_with_the_reason(tiny: Path):
    (tiny / "test" / "000001" / "depth" / "000001.png").unlink()
    evaluation = evaluate_siso(open_dataset(tiny), perfect())
    assert evaluation.targets is None
    assert evaluation.summary.scores == {"siso_recall": None}
    assert evaluation.summary.reasons["siso_recall"].startswith("no depth image for 1 of 2 images with targets")


def test_a_target_without_annotation_is_refused(tiny: Path):
    entry = {"scene_id": 1, "im_id": 1, "obj_id": 2, "inst_count": 1}
    (tiny / "test_targets_bop18.json").write_text(json.dumps([entry]))
    with pytest.raises(FormatError, match="scene 1, image 1: no annotation of object 2, which is a target there"):
        evaluated(tiny, claim(SECOND, 2, ALONE))


def test_nothing_visible_is_refused(tiny: Path):
    info = {"0": [{"visib_fract": 0.0}] * 3, "1": [{"visib_fract": 0.05}]}
    (tiny / "test" / "000001" / "scene_gt_info.json").write_text(json.dumps(info))
    (tiny / "test_targets_bop18.json").write_text(json.dumps([{"scene_id": 1, "im_id": 0, "obj_id": 1}]))
    with pytest.raises(InputError, match="tiny/test: no instance of a target is visible by 10 %"):
        evaluated(tiny, claim(FIRST, 1, LEFT))


def test_results_of_other_data_are_refused(tiny: Path):
    with pytest.raises(InputError, match="none of the 1 estimates is for a target of tiny/test"):
        evaluated(tiny, claim(FIRST._replace(scene_id=9), 1, LEFT))
