import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh

from pipeline.bop.dataset import open_dataset
from pipeline.bop.errors import sphere_projections_overlap
from pipeline.bop.evaluation.evaluate import Evaluation, evaluate
from pipeline.bop.results import read_results
from pipeline.bop.vsd import vsd_of_poses
from pipeline.exceptions import FormatError, InputError
from tests.random_dataset import DIAMETERS, greedy, make_random, read_scene, slow_mspd, slow_mssd, write_rows
from tests.slow_vsd import slow_vsd
from tests.tiny_dataset import ANNOTATED, FIRST, SECOND, claim, make_dataset, moved, perfect, results_of

(_, LEFT), (_, RIGHT), (_, SMALL) = ANNOTATED[FIRST]
((_, ALONE),) = ANNOTATED[SECOND]
DIAMETER = float(np.linalg.norm([0.06, 0.04, 0.02]))
"""Of box 1, metres."""


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny dataset with depth: four instances in two annotated images."""
    return make_dataset(tmp_path_factory.mktemp("data") / "tiny")


@pytest.fixture
def own(tiny: Path, tmp_path: Path) -> Path:
    """A copy of it to change."""
    return shutil.copytree(tiny, tmp_path / "tiny")


def evaluated(root: Path, *claims, **options) -> Evaluation:
    return evaluate(open_dataset(root), results_of(*claims), **options)


# ---- parity with the equations


def slow_scores(root: Path, results: Path) -> tuple[float, float]:
    """AR_MSSD and AR_MSPD straight from the equations, in millimetres, from the files themselves."""
    scene = root / "test" / "000002"
    truths = json.loads((scene / "scene_gt.json").read_text())
    cameras = json.loads((scene / "scene_camera.json").read_text())
    infos = json.loads((root / "models_eval" / "models_info.json").read_text())
    on_disk = {int(path.stem) for path in (scene / "rgb").iterdir()}
    with results.open() as file:
        rows = list(csv.DictReader(file))
    mssd, mspd = [], []
    for target in json.loads((root / "test_targets_bop19.json").read_text()):
        if target["im_id"] not in on_disk:
            continue
        assert target["inst_count"] == 1
        image, obj = str(target["im_id"]), str(target["obj_id"])
        (truth,) = [entry for entry in truths[image] if entry["obj_id"] == target["obj_id"]]
        R, t = np.reshape(truth["cam_R_m2c"], (3, 3)), np.array(truth["cam_t_m2c"])
        claims = [row for row in rows if (row["im_id"], row["obj_id"]) == (image, obj)]
        if not claims:
            mssd.append(np.inf)
            mspd.append(np.inf)
            continue
        best = max(claims, key=lambda row: float(row["score"]))
        R_e, t_e = np.array(best["R"].split(), float).reshape(3, 3), np.array(best["t"].split(), float)
        points = trimesh.load_mesh(root / "models_eval" / f"obj_{int(obj):06d}.ply", process=False).vertices
        K = np.reshape(cameras[image]["cam_K"], (3, 3))
        at_estimate = points @ R_e.T + t_e
        in_space, in_image = [], []
        for S in [np.eye(4), *(np.reshape(S, (4, 4)) for S in infos[obj].get("symmetries_discrete", []))]:
            at_truth = (points @ S[:3, :3].T + S[:3, 3]) @ R.T + t
            in_space.append(np.linalg.norm(at_estimate - at_truth, axis=1).max())
            a, b = at_estimate @ K.T, at_truth @ K.T
            in_image.append(np.linalg.norm(a[:, :2] / a[:, 2:] - b[:, :2] / b[:, 2:], axis=1).max())
        diameter = infos[obj]["diameter"]
        near = np.linalg.norm(t_e - t) < diameter
        mssd.append(min(in_space) / diameter if near else np.inf)
        mspd.append(min(in_image) * 640 / 640)
    return (
        float(np.mean([sum(e < theta for e in mssd) / len(mssd) for theta in np.arange(0.05, 0.51, 0.05)])),
        float(np.mean([sum(e < theta for e in mspd) / len(mspd) for theta in np.arange(5, 51, 5)])),
    )


def test_lmo_equals_the_equations_to_the_last_digit(lmo: Path):
    results = lmo / "results" / "megapose_lmo-test.csv"
    evaluation = evaluate(open_dataset(lmo), read_results(results))
    assert (evaluation.scores.mssd, evaluation.scores.mspd) == slow_scores(lmo, results)
    assert evaluation.scores.vsd is None
    assert "no depth image for 49 of 50 images" in evaluation.why_no_vsd


def test_vsd_equals_that_of_each_pair_alone(tiny: Path):
    dataset = open_dataset(tiny)
    claims = [
        claim(FIRST, 1, moved(LEFT, x=0.004, z=0.01), 0.9),
        claim(FIRST, 1, moved(RIGHT, y=0.006), 0.8),
        claim(FIRST, 2, moved(SMALL, x=0.002), 0.7),
        claim(SECOND, 1, moved(ALONE, x=3.0), 0.6),  # far out of sight
    ]
    values = []
    for estimate, truth in zip(claims, (LEFT, RIGHT, SMALL, ALONE), strict=True):
        model, depth = dataset.model(estimate.obj_id), dataset.depth(estimate.image)
        pose = estimate.camera_from_model
        assert depth is not None
        if sphere_projections_overlap(pose, truth, model.diameter):
            values.append(vsd_of_poses(model, dataset.camera(estimate.image), pose, truth, depth).values)
        else:
            values.append(np.ones(10))
    expected = np.mean(np.array(values)[:, :, None] < np.arange(0.05, 0.51, 0.05))
    assert 0.1 < expected < 0.9
    assert evaluated(tiny, *claims).scores.vsd == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize("seed", range(6))
def test_vsd_of_random_estimates_equals_the_equations_to_the_last_digit(tiny: Path, seed: int):
    rng, dataset = np.random.default_rng(seed), open_dataset(tiny)
    claims, found = [], []
    for key in (FIRST, SECOND):
        for obj_id in (1, 2):
            truths = [pose for i, pose in ANNOTATED[key] if i == obj_id]
            own = [claim(key, obj_id, moved(pose, *rng.normal(scale=0.01, size=3)), rng.random()) for pose in truths]
            claims += own
            best = sorted(own, key=lambda estimate: -estimate.score)
            taus = [i / 20 * dataset.model(obj_id).diameter for i in range(1, 11)]
            errors = np.array(
                [
                    [slow_vsd(dataset, key, obj_id, e.camera_from_model, truth, taus, True) for truth in truths]
                    for e in best
                ]
            ).reshape(len(best), len(truths), 10)
            for at_tau in range(10):
                pairs = {(e, g): errors[e, g, at_tau] for e in range(len(best)) for g in range(len(truths))}
                for theta in np.arange(0.05, 0.51, 0.05):
                    found.append(len(greedy(pairs, len(best), len(truths), theta)))
    at = np.sum(np.reshape(found, (4, 10, 10)), axis=0) / 4
    scores = evaluated(tiny, *claims).scores
    assert scores.vsd == at.mean()
    assert 0.0 < at.mean() < 1.0


@pytest.mark.parametrize("seed", range(10))
def test_recalls_of_each_scene_and_object_equal_the_equations(tmp_path: Path, seed: int):
    root = tmp_path / "random"
    rows = make_random(root, seed)
    found: dict[str, list] = {"scene": [], "object": [], "mssd": [], "mspd": []}
    for scene_id in (1, 2):
        truths, infos = read_scene(root, scene_id, "gt"), read_scene(root, scene_id, "gt_info")
        for im_id, entries in truths.items():
            fractions = [info["visib_fract"] for info in infos[im_id]]
            for obj_id in (1, 2):
                instances = [i for i, entry in enumerate(entries) if entry["obj_id"] == obj_id]
                count = sum(fractions[i] >= 0.1 for i in instances)
                instances = sorted(instances, key=lambda i: -fractions[i])[:count]
                claims = [r for r in rows if (r["scene_id"], r["im_id"], r["obj_id"]) == (scene_id, im_id, obj_id)]
                claims = sorted(claims, key=lambda row: -row["score"])[:count]
                found["scene"] += [scene_id] * count
                found["object"] += [obj_id] * count
                for name, error, thetas in (
                    ("mssd", lambda r, t: slow_mssd(r, t) / DIAMETERS[r["obj_id"]], np.arange(0.05, 0.51, 0.05)),
                    ("mspd", slow_mspd, np.arange(5, 51, 5)),
                ):
                    errors = {
                        (e, g): error(row, entries[i]) for e, row in enumerate(claims) for g, i in enumerate(instances)
                    }
                    taken = [greedy(errors, len(claims), count, theta).values() for theta in thetas]
                    found[name] += [[g in at for at in taken] for g in range(count)]
    results = read_results(write_rows(tmp_path / "method_random-test.csv", rows))
    evaluation = evaluate(open_dataset(root), results, with_vsd=False)
    for ids, parts in ((found["scene"], evaluation.per_scene), (found["object"], evaluation.per_object)):
        assert set(parts) == set(ids)
        for i, scores in parts.items():
            of_id = np.array(ids) == i
            for name in ("mssd", "mspd"):
                assert getattr(scores, name) == np.mean(np.sum(np.array(found[name])[of_id], axis=0) / of_id.sum())


# ---- cases of known recall


def test_perfect_estimates_score_one(tiny: Path):
    evaluation = evaluate(open_dataset(tiny), perfect())
    assert evaluation.scores == (1.0, 1.0, 1.0)
    assert evaluation.scores.average == 1.0
    assert evaluation.why_no_vsd == ""
    assert len(evaluation.instances) == 4
    assert evaluation.per_object == {1: (1.0, 1.0, 1.0), 2: (1.0, 1.0, 1.0)}
    assert evaluation.per_scene == {1: (1.0, 1.0, 1.0)}


def test_instances_without_an_estimate_are_missed(tiny: Path):
    evaluation = evaluated(tiny, claim(FIRST, 1, LEFT), claim(FIRST, 2, SMALL))
    assert evaluation.scores == (0.5, 0.5, 0.5)
    assert evaluation.per_object[1] == pytest.approx((1 / 3,) * 3, abs=1e-15)
    assert evaluation.per_object[2] == (1.0,) * 3
    found = evaluation.instances.mssd.all(axis=1)
    assert found.tolist() == [True, False, True, False]


def test_a_duplicate_takes_the_place_of_another_instance(tiny: Path):
    twice = (claim(FIRST, 1, LEFT, 0.9), claim(FIRST, 1, LEFT, 0.8))
    assert evaluated(tiny, *twice, claim(FIRST, 1, RIGHT, 0.7)).scores.mssd == 0.25  # two count, both of LEFT
    assert evaluated(tiny, *twice, claim(FIRST, 1, RIGHT, 0.85)).scores.mssd == 0.5


def test_only_the_best_scored_estimate_of_a_single_instance_counts(tiny: Path):
    wrong = moved(ALONE, x=1.0)
    assert evaluated(tiny, claim(SECOND, 1, wrong, 0.6), claim(SECOND, 1, ALONE, 0.5)).scores.mssd == 0.0
    assert evaluated(tiny, claim(SECOND, 1, wrong, 0.5), claim(SECOND, 1, ALONE, 0.6)).scores.mssd == 0.25
    assert evaluated(tiny, claim(SECOND, 1, ALONE, 0.5), claim(SECOND, 1, wrong, 0.5)).scores.mssd == 0.25  # file order


def test_mssd_counts_in_diameters(tiny: Path):
    shifted = moved(ALONE, z=0.22 * DIAMETER)  # below 0.25, 0.30, ..., 0.50
    assert evaluated(tiny, claim(SECOND, 1, shifted)).instances.mssd[3].tolist() == [False] * 4 + [True] * 6


def test_mssd_is_infinite_where_the_spheres_are_apart_but_mspd_is_not(tiny: Path):
    behind = moved(ALONE, z=1.01 * DIAMETER)
    at = evaluated(tiny, claim(SECOND, 1, behind)).instances
    assert not at.mssd[3].any()
    assert at.mspd[3].any()


def test_mspd_is_scaled_to_an_image_640_wide(tiny: Path):
    one_pixel = moved(ALONE, x=0.35 / 80)  # in an image 64 wide: some 10 in one of 640
    at = evaluated(tiny, claim(SECOND, 1, one_pixel)).instances.mspd[3]
    assert at.tolist() == [False, False] + [True] * 8


def test_a_listed_symmetry_costs_nothing(tiny: Path):
    turned = SMALL @ np.diag([-1.0, -1.0, 1.0, 1.0])
    assert evaluated(tiny, claim(FIRST, 2, turned)).scores.mssd == 0.25
    assert evaluated(tiny, claim(FIRST, 1, LEFT @ np.diag([-1.0, -1.0, 1.0, 1.0]))).scores.mssd == 0.0


def test_a_pose_that_is_not_finite_is_missed(tiny: Path):
    broken = np.full((4, 4), np.nan)
    assert evaluated(tiny, claim(FIRST, 1, broken, 0.9), claim(FIRST, 2, SMALL)).scores == (0.25, 0.25, 0.25)


def test_estimates_for_other_objects_and_images_do_not_count(tiny: Path):
    extra = (claim(SECOND, 2, SMALL), claim(FIRST._replace(im_id=77), 1, LEFT))
    assert evaluated(tiny, claim(SECOND, 1, ALONE), *extra).scores.mssd == 0.25


def list_targets(root: Path, **counts: int) -> None:
    """Ask for these numbers of instances of box 1 by image: `im0=1`."""
    entries = [
        {"scene_id": 1, "im_id": int(name.removeprefix("im")), "obj_id": 1, "inst_count": count}
        for name, count in counts.items()
    ]
    (root / "test_targets_bop19.json").write_text(json.dumps(entries))


def test_of_more_instances_than_asked_for_the_most_visible_count(own: Path):
    list_targets(own, im0=1)
    info = own / "test" / "000001" / "scene_gt_info.json"
    info.write_text(json.dumps({"0": [{"visib_fract": f} for f in (0.3, 0.6, 0.9)], "1": [{"visib_fract": 1.0}]}))
    evaluation = evaluated(own, claim(FIRST, 1, RIGHT))
    assert evaluation.scores.mssd == 1.0
    assert evaluation.instances.gt_index.tolist() == [1]
    assert evaluated(own, claim(FIRST, 1, LEFT)).scores.mssd == 0.0


# ---- no VSD


def test_without_depth_vsd_is_none_with_the_reason(own: Path):
    (own / "test" / "000001" / "depth" / "000001.png").unlink()
    evaluation = evaluate(open_dataset(own), perfect())
    assert evaluation.scores == (None, 1.0, 1.0)
    assert evaluation.scores.average is None
    assert evaluation.why_no_vsd == "no depth image for 1 of 2 images with targets (first: scene 1, image 1)"


def test_vsd_can_be_left_out(tiny: Path):
    evaluation = evaluate(open_dataset(tiny), perfect(), with_vsd=False)
    assert evaluation.scores == (None, 1.0, 1.0)
    assert evaluation.why_no_vsd == "not asked for"


# ---- input that cannot be scored


def test_results_of_other_data_are_refused(tiny: Path):
    with pytest.raises(InputError, match="none of the 1 estimates is for a target of tiny/test; give the dataset"):
        evaluated(tiny, claim(FIRST._replace(scene_id=9), 1, LEFT))


def test_results_without_a_row_score_zero(tiny: Path):
    assert evaluated(tiny).scores == (0.0, 0.0, 0.0)


def test_a_target_without_ground_truth_is_refused(own: Path):
    (own / "test" / "000001" / "scene_gt.json").unlink()
    with pytest.raises(InputError, match="tiny/test: no targets and no ground truth"):
        evaluate(open_dataset(own), perfect())
    list_targets(own, im0=2)
    with pytest.raises(FormatError, match="scene 1, image 0: no annotation of object 1, which is a target there"):
        evaluate(open_dataset(own), perfect())


def test_damaged_ground_truth_is_refused_also_where_it_makes_the_targets(own: Path):
    path = own / "test" / "000001" / "scene_gt.json"
    content = json.loads(path.read_text())
    content["1"][0]["cam_t_m2c"] = [0, 0]
    path.write_text(json.dumps(content))
    with pytest.raises(FormatError, match=r"scene_gt\.json: image 1"):
        evaluate(open_dataset(own), perfect())


def test_which_instances_count_is_not_guessed(own: Path):
    list_targets(own, im0=1)
    with pytest.raises(
        FormatError, match="annotated 2 times and the 1 most visible ones count, but visibility is unknown"
    ):
        evaluate(open_dataset(own), perfect())


def test_progress_ends_at_one(tiny: Path):
    shares: list[float] = []
    evaluate(open_dataset(tiny), perfect(), shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
