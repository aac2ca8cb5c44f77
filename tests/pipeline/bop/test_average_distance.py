import csv
import json
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from pipeline.bop.dataset import open_dataset
from pipeline.bop.evaluation.average_distance import ad_recalls, is_symmetric
from pipeline.bop.evaluation.evaluate import evaluate
from pipeline.bop.results import read_results
from tests.random_dataset import DIAMETERS, greedy, make_random, placed, read_scene, write_rows
from tests.tiny_dataset import ANNOTATED, FIRST, claim, make_dataset, results_of


def slow_ad(symmetric: bool, at_estimate: np.ndarray, at_truth: np.ndarray) -> float:
    """ADD, or ADI by comparing all points with all."""
    if not symmetric:
        return float(np.mean([np.linalg.norm(a - b) for a, b in zip(at_estimate, at_truth, strict=True)]))
    return float(np.mean([min(np.linalg.norm(b - a) for a in at_estimate) for b in at_truth]))


@pytest.mark.parametrize("seed", range(15))
def test_recalls_of_random_results_equal_the_equations(tmp_path: Path, seed: int):
    root = tmp_path / "random"
    rows = make_random(root, seed)
    found: list[tuple[int, bool]] = []
    for scene_id in (1, 2):
        truths, infos = read_scene(root, scene_id, "gt"), read_scene(root, scene_id, "gt_info")
        for im_id, entries in truths.items():
            fractions = [info["visib_fract"] for info in infos[im_id]]
            for obj_id in (1, 2):
                instances = [i for i, entry in enumerate(entries) if entry["obj_id"] == obj_id]
                count = sum(fractions[i] >= 0.1 for i in instances)
                instances = sorted(sorted(instances, key=lambda i: -fractions[i])[:count])
                claims = [r for r in rows if (r["scene_id"], r["im_id"], r["obj_id"]) == (scene_id, im_id, obj_id)]
                claims = sorted(claims, key=lambda row: -row["score"])[:count]
                errors = {}
                for e, row in enumerate(claims):
                    for g, i in enumerate(instances):
                        R, t = entries[i]["cam_R_m2c"], np.array(entries[i]["cam_t_m2c"])
                        ad = slow_ad(obj_id == 2, placed(obj_id, row["R"], row["t"]), placed(obj_id, R, t))
                        near = np.linalg.norm(row["t"] - t) < DIAMETERS[obj_id]
                        errors[e, g] = ad / DIAMETERS[obj_id] if near else np.inf
                taken = greedy(errors, len(claims), len(instances), 0.1).values()
                found += [(obj_id, g in taken) for g in range(len(instances))]
    if not found:
        pytest.skip("nothing is visible in this random dataset")
    results = read_results(write_rows(tmp_path / "method_random-test.csv", rows))
    ad = evaluate(open_dataset(root), results, with_vsd=False, with_ad=True).ad
    assert ad is not None
    per_object = {i: np.mean([right for obj_id, right in found if obj_id == i]) for i in {i for i, _ in found}}
    assert ad.recall == pytest.approx(np.mean([right for _, right in found]), abs=1e-15)
    assert ad.per_object == pytest.approx(per_object, abs=1e-15)
    assert ad.mean_over_objects == pytest.approx(np.mean(list(per_object.values())), abs=1e-15)


def test_lmo_equals_the_equations(lmo: Path):
    """ADI for the eggbox and the glue (10 and 11), ADD for the others, on real estimates."""
    path = lmo / "results" / "megapose_lmo-test.csv"
    infos = json.loads((lmo / "models_eval" / "models_info.json").read_text())
    truths = json.loads((lmo / "test" / "000002" / "scene_gt.json").read_text())
    on_disk = {int(image.stem) for image in (lmo / "test" / "000002" / "rgb").iterdir()}
    points = {
        i: trimesh.load_mesh(lmo / "models_eval" / f"obj_{int(i):06d}.ply", process=False).vertices for i in infos
    }
    with path.open() as file:
        rows = list(csv.DictReader(file))
    found: dict[int, list[bool]] = {}
    for target in json.loads((lmo / "test_targets_bop19.json").read_text()):
        if target["im_id"] not in on_disk:
            continue
        image, obj = str(target["im_id"]), str(target["obj_id"])
        (truth,) = [entry for entry in truths[image] if entry["obj_id"] == target["obj_id"]]
        claims = [row for row in rows if (row["im_id"], row["obj_id"]) == (image, obj)]
        right = False
        if claims:
            best = max(claims, key=lambda row: float(row["score"]))
            R, t = np.array(best["R"].split(), float).reshape(3, 3), np.array(best["t"].split(), float)
            at_estimate = points[obj] @ R.T + t
            at_truth = points[obj] @ np.reshape(truth["cam_R_m2c"], (3, 3)).T + truth["cam_t_m2c"]
            if obj in ("10", "11"):
                error = cKDTree(at_estimate).query(at_truth)[0].mean()
            else:
                error = np.linalg.norm(at_estimate - at_truth, axis=1).mean()
            near = np.linalg.norm(t - truth["cam_t_m2c"]) < infos[obj]["diameter"]
            right = bool(near and error < 0.1 * infos[obj]["diameter"])
        found.setdefault(int(obj), []).append(right)
    ad = evaluate(open_dataset(lmo), read_results(path), with_ad=True).ad
    assert ad is not None
    assert ad.per_object == {i: np.mean(found[i]) for i in sorted(found)}
    assert ad.recall == sum(map(sum, found.values())) / sum(map(len, found.values()))
    assert 0.2 < ad.mean_over_objects < 0.8


def test_adi_is_for_the_objects_that_the_thesis_names(tmp_path: Path):
    for name, symmetric in (("lm", {3, 7, 10, 11}), ("tless", set(range(1, 31))), ("lmo", {10, 11})):
        make_dataset(tmp_path / name)
        dataset = open_dataset(tmp_path / name)
        assert {i for i in dataset.facts.obj_ids if is_symmetric(dataset, i)} == symmetric


def test_adi_is_for_objects_with_listed_symmetries_of_other_datasets(tmp_path: Path):
    dataset = open_dataset(make_dataset(tmp_path / "tiny"))
    assert [is_symmetric(dataset, i) for i in (1, 2)] == [False, True]
    turned = ANNOTATED[FIRST][2][1] @ np.diag([-1.0, -1.0, 1.0, 1.0])
    assert evaluate(dataset, results_of(claim(FIRST, 2, turned)), with_ad=True).ad.per_object == {1: 0.0, 2: 1.0}  # type: ignore[union-attr]


def test_each_object_has_the_same_weight_in_the_mean():
    recalls = ad_recalls(np.array([True, True, True, False]), np.array([1, 1, 1, 2]))
    assert (recalls.recall, recalls.mean_over_objects, recalls.per_object) == (0.75, 0.5, {1: 1.0, 2: 0.0})


def test_ad_is_left_out_unless_asked_for(tmp_path: Path):
    dataset = open_dataset(make_dataset(tmp_path / "tiny"))
    evaluation = evaluate(dataset, results_of(claim(FIRST, 1, ANNOTATED[FIRST][0][1])), with_vsd=False)
    assert evaluation.ad is None
    assert "ad_recall" not in evaluation.as_dict()["scores"]
