import csv
import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
import trimesh
from rich.console import Console

from inspector.commands.evaluate import EvaluateConfig, run
from pipeline.bop.dataset import open_dataset
from pipeline.bop.errors import sphere_projections_overlap
from pipeline.bop.evaluate import Evaluation, evaluate
from pipeline.bop.results import Results, read_results, write_results
from pipeline.bop.vsd import vsd_of_poses
from pipeline.exceptions import FormatError, InputError
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


# ---- the command


def written(folder: Path, results: Results, name: str) -> Path:
    path = folder / f"{name}_tiny-test.csv"
    write_results(path, results)
    return path


def test_command_prints_and_writes_the_scores(tiny: Path, tmp_path: Path):
    out, console = tmp_path / "scores.json", Console(file=io.StringIO(), width=120)
    path = written(tmp_path, perfect(), "mine")
    assert run(EvaluateConfig(tiny, (path,), json=out), console) == 0
    content = json.loads(out.read_text())
    names = [f"bop19_average_recall{error}" for error in ("", "_vsd", "_mssd", "_mspd")]
    assert list(content) == ["dataset", "method", "scores", "per_object", "targets", "seconds"]
    assert (content["dataset"], content["method"], content["targets"]) == ("tiny", "mine", 4)
    assert content["scores"] == dict.fromkeys(names, 1.0)
    assert content["per_object"] == {"1": dict.fromkeys(names, 1.0), "2": dict.fromkeys(names, 1.0)}
    assert content["seconds"] > 0
    printed = console.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]
    assert "mine" in printed
    assert "1.0000" in printed


def test_command_writes_a_list_for_several_files(tiny: Path, tmp_path: Path):
    out = tmp_path / "scores.json"
    paths = tuple(written(tmp_path, results, name) for name, results in (("a", perfect()), ("b", results_of())))
    run(EvaluateConfig(tiny, paths, vsd=False, json=out), Console(file=io.StringIO()))
    content = json.loads(out.read_text())
    assert [(entry["method"], entry["scores"]["bop19_average_recall_mssd"]) for entry in content] == [
        ("a", 1.0),
        ("b", 0.0),
    ]
    assert content[0]["scores"]["bop19_average_recall_vsd"] is None
    assert content[0]["reasons"] == dict.fromkeys(["bop19_average_recall", "bop19_average_recall_vsd"], "not asked for")


def test_command_needs_a_results_file(tiny: Path):
    with pytest.raises(InputError, match="no results file; name one or more"):
        run(EvaluateConfig(tiny, ()), Console(file=io.StringIO()))


def test_command_says_that_images_are_missing(lmo: Path):
    console = Console(file=io.StringIO(), width=200)
    run(EvaluateConfig(lmo, (lmo / "results" / "megapose_lmo-test.csv",)), console)
    printed = console.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]
    assert "365 of the 1445 instances of the BOP Challenge are here" in printed
    assert "no VSD: no depth image for 49 of 50 images" in printed


def test_command_names_a_file_of_another_dataset(tiny: Path, tmp_path: Path):
    path, console = tmp_path / "mine_lmo-test.csv", Console(file=io.StringIO(), width=200)
    write_results(path, perfect())
    run(EvaluateConfig(tiny, (path,)), console)
    assert "by its name for lmo, evaluated on tiny" in console.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]
