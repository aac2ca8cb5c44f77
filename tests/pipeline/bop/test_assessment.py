"""Estimates held against ground truth: who is paired with whom, and what the numbers say."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from tiny_dataset import (
    ANNOTATED,
    BARE,
    CAMERA,
    FIRST,
    HALF_TURN,
    SECOND,
    box,
    claim,
    make_dataset,
    moved,
    perfect,
    results_of,
)

from pipeline.bop import errors
from pipeline.bop.assessment import Assessment, assess, pair, with_adi, with_visibility, with_vsd
from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.results import Results, read_results
from pipeline.bop.vsd import vsd_of_poses
from pipeline.rendering import render_scene
from pipeline.scene import Target

LEFT, RIGHT = (p for obj_id, p in ANNOTATED[FIRST] if obj_id == 1)
SYMMETRIC = ANNOTATED[FIRST][2][1]
SECOND_POSE = ANNOTATED[SECOND][0][1]


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    return open_dataset(make_dataset(tmp_path / "tiny"))


def rows(assessment: Assessment, *columns: str) -> list[tuple]:
    return list(zip(*(getattr(assessment, column).tolist() for column in columns), strict=True))


def of_first_image(assessment: Assessment, obj_id: int) -> np.ndarray:
    return np.flatnonzero((assessment.im_id == 0) & (assessment.scene_id == 1) & (assessment.obj_id == obj_id))


def test_perfect_estimates_have_no_error(dataset: Dataset):
    found = with_adi(dataset, perfect(), assess(dataset, perfect()))
    assert rows(found, "scene_id", "im_id", "obj_id", "gt_index") == [
        (1, 0, 1, 0),
        (1, 0, 1, 1),
        (1, 0, 2, 2),
        (1, 1, 1, 0),
    ]
    for column in (found.mssd, found.mspd, found.add):
        np.testing.assert_allclose(column, 0, atol=1e-12)
    np.testing.assert_array_equal(found.score, 0.5)
    np.testing.assert_allclose(found.diameter, [box(obj_id).diameter for obj_id in found.obj_id.tolist()])
    assert found.method == "perfect"
    assert found.problems == ()


def test_each_instance_gets_the_estimate_that_is_nearest(dataset: Dataset):
    results = results_of(claim(FIRST, 1, moved(RIGHT, x=0.001), 0.9), claim(FIRST, 1, moved(LEFT, x=0.002), 0.8))
    found = assess(dataset, results)
    assert found.estimate[of_first_image(found, 1)].tolist() == [1, 0]
    np.testing.assert_allclose(found.mssd[of_first_image(found, 1)], [0.002, 0.001])


def test_the_surer_estimate_chooses_first(dataset: Dataset):
    # Both are nearest to the left box; the surer one gets it, the other one the right box, however far.
    results = results_of(claim(FIRST, 1, moved(LEFT, x=0.001), 0.3), claim(FIRST, 1, moved(LEFT, x=0.004), 0.9))
    found = assess(dataset, results)
    assert found.estimate[of_first_image(found, 1)].tolist() == [1, 0]


def test_an_instance_without_an_estimate_has_infinite_errors(dataset: Dataset):
    found = assess(dataset, results_of(claim(FIRST, 1, RIGHT)))
    left, right = of_first_image(found, 1)
    assert (found.estimate[left], found.estimate[right]) == (-1, 0)
    assert np.isinf([found.mssd[left], found.mspd[left], found.add[left]]).all()
    assert np.isnan(found.score[left])
    assert np.isnan(found.vsd).all()


def test_only_as_many_estimates_count_as_there_are_instances(dataset: Dataset):
    results = results_of(*(claim(SECOND, 1, moved(SECOND_POSE, z=0.001 * i), 0.1 * i) for i in range(1, 4)))
    found = assess(dataset, results)
    second = found.im_id == 1
    assert found.estimate[second].tolist() == [2]  # the surest, though the others are nearer
    assert (found.gt_index >= 0).all()


def test_an_estimate_that_is_not_finite_leaves_its_instance_missing_and_is_extra(dataset: Dataset):
    broken = moved(SECOND_POSE, z=np.nan)
    found = assess(dataset, results_of(claim(SECOND, 1, broken)))
    second = np.flatnonzero(found.im_id == 1)
    assert rows(found, "gt_index", "estimate")[second[0]] == (0, -1)
    assert rows(found, "gt_index", "estimate")[second[1]] == (-1, 0)
    assert np.isnan(found.mssd[second[1]])


def test_symmetric_objects_have_no_error_at_a_symmetric_pose(dataset: Dataset):
    results = results_of(claim(FIRST, 2, SYMMETRIC @ HALF_TURN))
    found = assess(dataset, results)
    (row,) = of_first_image(found, 2)
    np.testing.assert_allclose([found.mssd[row], found.mspd[row]], 0, atol=1e-9)
    assert np.isnan(found.add[row])
    found = with_adi(dataset, results, found)
    assert found.add[row] == pytest.approx(0, abs=1e-9)


def test_adi_is_filled_in_for_objects_with_symmetries_only(dataset: Dataset):
    near = moved(SYMMETRIC, x=0.002)
    results = results_of(claim(FIRST, 2, near), claim(FIRST, 1, moved(LEFT, x=0.003)), claim(BARE, 2, near))
    before = assess(dataset, results)
    found = with_adi(dataset, results, before)
    (row,) = of_first_image(found, 2)
    assert found.add[row] == errors.adi(dataset.model(2), near, SYMMETRIC)
    others = np.arange(len(found)) != row
    np.testing.assert_array_equal(found.add[others], before.add[others])


def test_what_is_ready_is_handed_out_on_the_way(dataset: Dataset, monkeypatch: pytest.MonkeyPatch):
    seconds = iter(range(0, 1000, 10))
    monkeypatch.setattr("pipeline.bop.assessment.time.monotonic", lambda: next(seconds))
    partial: list[Assessment] = []
    found = assess(dataset, perfect(), so_far=partial.append)
    assert partial
    assert len(partial[0]) <= len(found)
    assert partial[0].estimate.tolist() == found.estimate[: len(partial[0])].tolist()


def test_numbers_are_those_of_the_error_functions_in_pixels_at_640(dataset: Dataset):
    estimate = moved(SECOND_POSE, x=0.004, z=0.03)
    found = assess(dataset, results_of(claim(SECOND, 1, estimate)))
    (row,) = np.flatnonzero(found.im_id == 1)
    model = dataset.model(1)
    assert found.mssd[row] == errors.mssd(model, estimate, SECOND_POSE).value
    assert found.mspd[row] == errors.mspd(model, CAMERA.K, estimate, SECOND_POSE).value * 640 / 64
    assert found.add[row] == errors.add(model, estimate, SECOND_POSE)


def test_images_without_ground_truth_give_a_row_for_each_estimate(dataset: Dataset):
    results = results_of(claim(BARE, 1, SECOND_POSE, 0.2), claim(BARE, 2, SECOND_POSE, 0.7), claim(BARE, 1, LEFT, 0.4))
    found = assess(dataset, results)
    bare = found.scene_id == 2
    assert sorted(zip(found.obj_id[bare].tolist(), found.estimate[bare].tolist(), strict=True)) == [
        (1, 0),
        (1, 2),
        (2, 1),
    ]
    assert (found.gt_index[bare] == -1).all()
    assert np.isnan(found.mssd[bare]).all()
    np.testing.assert_array_equal(np.sort(found.score[bare]), [0.2, 0.4, 0.7])


def test_estimates_of_images_that_are_not_there_are_left_out(dataset: Dataset):
    strange = [
        claim(key, 1, LEFT) for key in (FIRST._replace(im_id=77), BARE._replace(im_id=77), BARE._replace(scene_id=9))
    ]
    assert len(assess(dataset, results_of(*strange))) == len(assess(dataset, None))


def test_without_results_the_rows_are_the_annotations(dataset: Dataset):
    found = assess(dataset, None)
    assert len(found) == 4
    assert (found.estimate == -1).all()
    assert np.isnan(found.mssd).all()
    assert found.method == "ground truth"


def test_empty_results_miss_everything(dataset: Dataset):
    found = assess(dataset, results_of())
    assert len(found) == 4
    assert np.isinf(found.mssd).all()
    assert len(with_vsd(dataset, results_of(), found, 0.02, 0.015)) == 4


def test_of_more_instances_than_targets_the_most_visible_count(tmp_path: Path):
    root = make_dataset(tmp_path / "tiny")
    targets = [{"scene_id": 1, "im_id": 0, "obj_id": 1, "inst_count": 1}]
    (root / "test_targets_bop19.json").write_text(json.dumps(targets))
    info = {"0": [{"visib_fract": 0.3}, {"visib_fract": 0.9}, {"visib_fract": 1.0}], "1": [{"visib_fract": 1.0}]}
    (root / "test" / "000001" / "scene_gt_info.json").write_text(json.dumps(info))
    found = assess(open_dataset(root), perfect())
    assert rows(found, "obj_id", "gt_index", "visible_fraction") == [(1, 1, 0.9)]


def test_a_model_that_cannot_be_read_is_named_and_the_others_are_assessed(tmp_path: Path):
    root = make_dataset(tmp_path / "tiny")
    (root / "models" / "obj_000002.ply").write_text("no mesh")
    found = assess(open_dataset(root), perfect())
    assert found.obj_id.tolist() == [1, 1, 1]
    (problem,) = found.problems
    assert "obj_000002.ply" in problem
    assert "\n" not in problem


def test_unknown_objects_in_a_results_file_do_no_harm(dataset: Dataset):
    found = assess(dataset, results_of(claim(FIRST, 99, LEFT), claim(BARE, 99, LEFT), claim(FIRST, 1, LEFT)))
    assert 99 not in found.obj_id
    assert len(found.problems) == 1
    assert "99" in found.problems[0]


def test_pairs_are_those_of_the_table(dataset: Dataset):
    results = results_of(claim(FIRST, 1, moved(RIGHT, x=0.001), 0.9))
    (left, nothing), (right, partner) = pair(dataset, results, Target(*FIRST, 1, 2))
    assert (left.index, right.index) == (0, 1)
    assert nothing is None
    assert partner is not None
    assert partner.score == 0.9


def test_progress_goes_forward_from_0(dataset: Dataset):
    shares: list[float] = []
    assess(dataset, perfect(), shares.append)
    assert shares[0] == 0.0
    assert shares == sorted(shares)
    assert max(shares) <= 1.0


# ---------------------------------------------------------------------------------------------------------- VSD
def test_vsd_is_that_of_the_error_function(dataset: Dataset):
    estimate = moved(SECOND_POSE, x=0.01, z=0.03)
    results = results_of(claim(SECOND, 1, estimate), claim(FIRST, 1, LEFT))
    found = with_vsd(dataset, results, assess(dataset, results), tau=0.02, delta=0.015)
    depth, model = dataset.depth(SECOND), dataset.model(1)
    assert depth is not None
    expected = vsd_of_poses(model, CAMERA, estimate, SECOND_POSE, depth, [0.02 / model.diameter], 0.015).values[0]
    assert 0.1 < expected <= 1
    assert found.vsd[found.im_id == 1].tolist() == [expected]
    left, right = of_first_image(found, 1)
    assert found.vsd[left] < 0.05
    assert found.vsd[right] == 1.0  # no estimate


def test_without_depth_vsd_is_unknown(tmp_path: Path):
    dataset = open_dataset(make_dataset(tmp_path / "tiny", depth=False))
    assert np.isnan(with_vsd(dataset, perfect(), assess(dataset, perfect()), 0.02, 0.015).vsd).all()


def test_vsd_of_rows_without_ground_truth_is_unknown(dataset: Dataset):
    results = results_of(claim(BARE, 1, LEFT), claim(SECOND, 1, SECOND_POSE))
    found = with_vsd(dataset, results, assess(dataset, results), 0.02, 0.015)
    assert np.isnan(found.vsd[found.scene_id == 2]).all()
    assert found.vsd[found.im_id == 1][0] < 0.05


@pytest.mark.parametrize("damage", ["size", "content"])
def test_one_bad_depth_image_costs_only_its_own_vsd_and_is_named(tmp_path: Path, damage: str):
    root = make_dataset(tmp_path / "tiny")
    path = root / "test" / "000001" / "depth" / "000000.png"
    if damage == "size":
        cv2.imwrite(str(path), np.full((10, 10), 500, np.uint16))
    else:
        path.write_bytes(b"no image")
    dataset = open_dataset(root)
    found = with_vsd(dataset, perfect(), assess(dataset, perfect()), 0.02, 0.015)
    assert np.isnan(found.vsd[found.im_id == 0]).all()
    assert (found.vsd[found.im_id == 1] < 0.05).all()
    assert any("depth" in problem for problem in found.problems)


# ---------------------------------------------------------------------------------------------------- visibility
def test_visible_fractions_come_from_the_annotated_models_where_the_dataset_has_none(dataset: Dataset):
    found = with_visibility(dataset, assess(dataset, None))
    scene = render_scene([(box(obj_id), p) for obj_id, p in ANNOTATED[FIRST]], CAMERA)
    expected = [(scene.instance_ids == i).sum() / alone.mask.sum() for i, alone in enumerate(scene.renderings)]
    first = found.im_id == 0
    np.testing.assert_allclose(found.visible_fraction[first], np.array(expected)[found.gt_index[first]])
    assert found.visible_fraction[~first].tolist() == [1.0]
    assert found.visibility_estimated


def test_an_object_behind_another_is_partly_visible(tmp_path: Path):
    root = make_dataset(tmp_path / "tiny")
    path = root / "test" / "000001" / "scene_gt.json"
    truth = json.loads(path.read_text())
    truth["0"][1] = {**truth["0"][0], "cam_t_m2c": [1.2 * x for x in truth["0"][0]["cam_t_m2c"]]}
    path.write_text(json.dumps(truth))
    dataset = open_dataset(root)
    found = with_visibility(dataset, assess(dataset, None))
    front, behind = of_first_image(found, 1)
    assert found.visible_fraction[front] == 1.0
    assert found.visible_fraction[behind] < 0.3


def test_fractions_that_the_dataset_tells_are_kept(tmp_path: Path):
    root = make_dataset(tmp_path / "tiny")
    info = {"0": [{"visib_fract": 0.3}] * 3, "1": [{"visib_fract": 0.4}]}
    (root / "test" / "000001" / "scene_gt_info.json").write_text(json.dumps(info))
    dataset = open_dataset(root)
    found = with_visibility(dataset, assess(dataset, None))
    assert found.visible_fraction.tolist() == [0.3, 0.3, 0.3, 0.4]
    assert not found.visibility_estimated


# ------------------------------------------------------------------------------------------------------ real data
def test_lmo(lmo: Path):
    dataset = open_dataset(lmo)
    results: Results = read_results(lmo / "results" / "megapose_lmo-test.csv")
    found = assess(dataset, results)
    assert len(found) == sum(target.inst_count for target in dataset.targets())
    assert found.problems == ()
    with_partner = found.estimate >= 0
    assert 0.5 < with_partner.mean() < 1
    assert np.isfinite(found.mssd[with_partner]).all()
    assert np.isinf(found.mssd[~with_partner]).all()
    filled = with_vsd(dataset, results, found, 0.02, 0.015)
    assert np.isfinite(filled.vsd[filled.im_id == 3]).all()
    assert np.isnan(filled.vsd[filled.im_id != 3]).all()
