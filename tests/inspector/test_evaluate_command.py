import csv
import io
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from rich.console import Console

from inspector.commands.evaluate import EvaluateConfig, run
from pipeline.bop.results import Results, write_results
from pipeline.exceptions import FormatError, InputError, UnknownIdError
from tests.pipeline.bop.test_coco_detection import A, annotation, detection, with_annotations
from tests.random_dataset import make_random, write_rows
from tests.tiny_dataset import ANNOTATED, FIRST, SECOND, claim, make_dataset, moved, perfect, results_of

(_, LEFT), (_, RIGHT), (_, SMALL) = ANNOTATED[FIRST]
((_, ALONE),) = ANNOTATED[SECOND]
NAMES = [f"bop19_average_recall{error}" for error in ("", "_vsd", "_mssd", "_mspd")]


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tiny dataset with depth: four instances in two annotated images."""
    return make_dataset(tmp_path_factory.mktemp("data") / "tiny")


def written(folder: Path, results: Results, name: str = "mine", dataset: str = "tiny") -> Path:
    path = folder / f"{name}_{dataset}-test.csv"
    write_results(path, results)
    return path


def called(*arguments, width: int = 100, **options) -> tuple[int, str]:
    """What the command returns and prints."""
    console = Console(file=io.StringIO(), width=width)
    code = run(EvaluateConfig(*arguments, **options), console)
    return code, console.file.getvalue()  # pyright: ignore[reportAttributeAccessIssue]


def test_it_prints_and_writes_the_scores(tiny: Path, tmp_path: Path):
    out = tmp_path / "scores.json"
    code, printed = called(tiny, (written(tmp_path, perfect()),), json=out)
    content = json.loads(out.read_text())
    assert code == 0
    assert list(content)[:6] == ["dataset", "method", "scores", "per_object", "targets", "seconds"]
    assert (content["dataset"], content["method"], content["targets"]) == ("tiny", "mine", 4)
    assert (content["split"], content["task"]) == ("test", "localization")
    assert content["scores"] == dict.fromkeys(NAMES, 1.0)
    assert content["per_object"] == {"1": dict.fromkeys(NAMES, 1.0), "2": dict.fromkeys(NAMES, 1.0)}
    assert content["per_scene"] == {"1": dict.fromkeys(NAMES, 1.0)}
    assert content["targets_per_object"] == {"1": 3, "2": 1}
    assert content["seconds"] > 0
    assert "reasons" not in content
    assert "mine" in printed
    assert "1.0000" in printed


def test_several_files_give_a_list(tiny: Path, tmp_path: Path):
    out = tmp_path / "scores.json"
    far = results_of(claim(FIRST, 1, moved(ANNOTATED[FIRST][0][1], z=1.0)))
    paths = tuple(written(tmp_path, results, name) for name, results in (("a", perfect()), ("b", far)))
    called(tiny, paths, vsd=False, json=out)
    content = json.loads(out.read_text())
    assert [(entry["method"], entry["scores"][NAMES[2]]) for entry in content] == [("a", 1.0), ("b", 0.0)]
    assert content[0]["scores"][NAMES[1]] is None
    assert content[0]["reasons"] == dict.fromkeys(NAMES[:2], "not asked for")
    assert any("targets have no estimate" in note for note in content[1]["notes"])


def test_a_file_without_estimates_is_refused(tiny: Path, tmp_path: Path):
    with pytest.raises(FormatError, match="it holds no estimates"):
        called(tiny, (written(tmp_path, results_of(), "empty"),), vsd=False)


def test_a_file_for_another_dataset_is_refused_though_some_rows_fit_by_chance(tiny: Path, tmp_path: Path):
    elsewhere = claim(FIRST._replace(scene_id=9), 1, ANNOTATED[FIRST][0][1])
    path = tmp_path / "method_lmo-test.csv"
    write_results(path, results_of(claim(FIRST, 1, ANNOTATED[FIRST][0][1]), elsewhere, elsewhere))
    with pytest.raises(
        FormatError, match=r"by its name method_lmo-test\.csv is for lmo, but it is checked against tiny"
    ):
        called(tiny, (path,), vsd=False)


def test_average_distances_if_asked_for(tiny: Path, tmp_path: Path):
    out = tmp_path / "scores.json"
    _, printed = called(tiny, (written(tmp_path, perfect()),), vsd=False, add=True, json=out)
    content = json.loads(out.read_text())
    assert (content["scores"]["ad_recall"], content["scores"]["ad_mean_object_recall"]) == (1.0, 1.0)
    assert content["per_object"]["2"]["ad_recall"] == 1.0
    assert "AD, mean over objects: 1.0000" in printed


@pytest.mark.parametrize(("task", "name", "value"), [("siso", "siso_recall", 1 / 3), ("detection", "bop24_mAP", None)])
def test_other_tasks(tmp_path: Path, task, name: str, value: float | None):
    root = make_dataset(tmp_path / "tiny")
    info = {"0": [{"visib_fract": 1.0}] * 3, "1": [{"visib_fract": 1.0}]}
    (root / "test" / "000001" / "scene_gt_info.json").write_text(json.dumps(info))
    path, out = written(tmp_path, results_of(claim(FIRST, 1, LEFT))), tmp_path / "scores.json"
    code, printed = called(root, (path,), task=task, json=out)
    content = json.loads(out.read_text())
    assert (code, content["task"]) == (0, task)
    assert 0.1 < content["scores"][name] < 0.5
    assert value in (None, content["scores"][name])
    assert f"{content['scores'][name]:.4f}" in printed


def test_2d_detections(tmp_path: Path):
    root = with_annotations(tmp_path / "random", {1: [annotation(0, 1, A)]})
    path, out = tmp_path / "mine_random-test.json", tmp_path / "scores.json"
    path.write_text(json.dumps([detection(0, 1, A, 0.9)]))
    code, printed = called(root, (path,), task="detection", json=out)
    content = json.loads(out.read_text())
    assert (code, content["task"], content["method"]) == (0, "bbox", "mine")
    assert content["scores"]["AP"] == pytest.approx(1.0, abs=1e-12)
    assert "2D detection" in printed
    with pytest.raises(
        InputError, match=r"mine_random-test\.json: a JSON file holds 2D detections; add --task detection"
    ):
        called(root, (path,))


def test_tables_fit_in_100_columns(tiny: Path, tmp_path: Path):
    _, printed = called(tiny, (written(tmp_path, perfect(), "a-method-of-some-length"),), add=True)
    (row,) = [line for line in printed.splitlines() if line.split()[1:2] == ["all"]]
    assert row.split()[:3] == ["a-method-of-some-length", "all", "4"]
    assert row.split()[3:8] == ["1.0000"] * 5


# ---- files


def rows_of(path: Path) -> list[dict[str, str]]:
    with path.open() as file:
        return list(csv.DictReader(file))


def test_a_folder_of_scores_curves_and_instances(tiny: Path, tmp_path: Path):
    shifted = results_of(claim(FIRST, 1, LEFT), claim(FIRST, 2, moved(SMALL, z=0.01)))
    called(tiny, (written(tmp_path, shifted),), add=True, out=tmp_path / "out")
    folder = tmp_path / "out" / "mine_tiny-test"
    scores = json.loads((folder / "scores.json").read_text())
    rows = rows_of(folder / "instances.csv")
    assert [(row["im_id"], row["obj_id"], row["gt_index"]) for row in rows] == [
        ("0", "1", "0"),
        ("0", "1", "1"),
        ("0", "2", "2"),
        ("1", "1", "0"),
    ]
    for column, name in (("average_recall", NAMES[0]), ("average_recall_vsd", NAMES[1]), ("ad_found", "ad_recall")):
        assert np.mean([float(row[column]) for row in rows]) == pytest.approx(scores["scores"][name], abs=1e-12)
    assert rows[0]["visible_fraction"] == ""
    curves = json.loads((folder / "curves.json").read_text())
    assert np.mean(curves["all"]["mssd"]) == pytest.approx(scores["scores"][NAMES[2]], abs=1e-12)
    assert np.shape(curves["all"]["vsd"]) == (10, 10)
    assert set(curves["per_object"]) == {"1", "2"}
    assert sorted(path.name for path in folder.iterdir()) == ["curves.json", "instances.csv", "scores.json"]


def test_a_folder_of_detections(tmp_path: Path):
    rows = make_random(tmp_path / "random", 3)
    path = write_rows(tmp_path / "mine_random-test.csv", rows)
    called(tmp_path / "random", (path,), task="detection", out=tmp_path / "out")
    folder = tmp_path / "out" / "mine_random-test"
    estimates = rows_of(folder / "estimates.csv")
    assert 0 < len(estimates) <= len(rows)
    assert all(float(row["score"]) == rows[int(row["row"])]["score"] for row in estimates)
    demanded = [row for row in rows_of(folder / "instances.csv") if row["demanded"] == "1"]
    assert len(demanded) == json.loads((folder / "scores.json").read_text())["targets"]
    assert np.shape(json.loads((folder / "curves.json").read_text())["all"]["mssd"]) == (10,)


def test_an_interrupted_evaluation_goes_on_where_it_stopped(
    tiny: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    path, out = written(tmp_path, perfect()), tmp_path / "out"
    computed: list[int] = []
    from pipeline.bop.evaluation import evaluate as module

    compute = module.errors_of_targets

    def failing(dataset, results, targets, *options):
        computed.append(targets[0].im_id)
        if len(computed) == 2:
            raise KeyboardInterrupt
        return compute(dataset, results, targets, *options)

    monkeypatch.setattr("pipeline.bop.evaluation.columns.TARGETS_PER_PIECE", 1)
    monkeypatch.setattr(module, "errors_of_targets", failing)
    with pytest.raises(KeyboardInterrupt):
        called(tiny, (path,), out=out, workers=1)
    called(tiny, (path,), out=out, workers=1)
    assert computed == [0, 1, 1]
    assert json.loads((out / "mine_tiny-test" / "scores.json").read_text())["scores"][NAMES[0]] == 1.0
    assert not (out / "mine_tiny-test" / "unfinished").exists()


def test_workers_give_the_same_numbers(lmo: Path, tmp_path: Path):
    path = lmo / "results" / "megapose_lmo-test.csv"
    found = []
    for workers in (1, 2):
        out = tmp_path / f"{workers}.json"
        called(lmo, (path,), json=out, workers=workers)
        found.append({k: v for k, v in json.loads(out.read_text()).items() if k != "seconds"})
    assert found[0] == found[1]


# ---- several datasets


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A folder of two core datasets, made of the tiny one."""
    folder = tmp_path / "datasets"
    for name in ("lmo", "icbin"):
        make_dataset(folder / name)
    return folder


def test_each_file_goes_to_the_dataset_that_its_name_tells(root: Path, tmp_path: Path):
    half = results_of(claim(FIRST, 1, LEFT), claim(FIRST, 2, SMALL))
    paths = (written(tmp_path, perfect(), dataset="lmo"), written(tmp_path, half, dataset="icbin"))
    out = tmp_path / "scores.json"
    _, printed = called(root, paths, vsd=False, json=out)
    content = json.loads(out.read_text())
    assert [(entry["dataset"], entry["scores"][NAMES[2]]) for entry in content["evaluations"]] == [
        ("lmo", 1.0),
        ("icbin", 0.5),
    ]
    (mean,) = content["over_datasets"]
    assert mean["label"] == "mean over 2 of 7 core datasets, not all of them whole"
    assert mean["scores"][NAMES[2]] == 0.75
    assert mean["complete"] is False
    assert "mean over 2 of 7 core datasets, not all of them whole" in " ".join(printed.split())


def test_files_without_a_dataset_here_are_refused(root: Path, tmp_path: Path):
    with pytest.raises(UnknownIdError, match=r"dataset tless is not in .*; available: icbin, lmo"):
        called(root, (written(tmp_path, perfect(), dataset="tless"),))
    nameless = tmp_path / "results.csv"
    write_results(nameless, perfect())
    with pytest.raises(FormatError, match=r"its name does not tell which dataset .* call it METHOD_DATASET-SPLIT"):
        called(root, (nameless,))


def test_two_files_of_a_method_for_one_dataset_are_refused_before_computing(root: Path, tmp_path: Path):
    (tmp_path / "more").mkdir()
    paths = (
        written(tmp_path, perfect(), dataset="lmo"),
        written(tmp_path / "more", perfect(), dataset="lmo"),
        written(tmp_path, perfect(), dataset="icbin"),
    )
    with pytest.raises(InputError, match="two results files of mine for lmo"):
        called(root, paths)


def test_the_split_is_the_one_that_the_file_names(tmp_path: Path):
    root = make_dataset(tmp_path / "tiny")
    shutil.copytree(root / "test", root / "val")
    out, path = tmp_path / "scores.json", tmp_path / "mine_tiny-val.csv"
    write_results(path, perfect())
    called(root, (path,), vsd=False, json=out)
    assert json.loads(out.read_text())["split"] == "val"
    called(root, (path,), vsd=False, json=out, split="test")
    assert json.loads(out.read_text())["split"] == "test"


# ---- bad input


def test_it_needs_a_results_file(tiny: Path):
    with pytest.raises(InputError, match="no results file; name one or more"):
        called(tiny, ())


@pytest.mark.parametrize("option", ["json", "out"])
def test_a_place_that_cannot_be_written_is_refused_before_computing(
    tiny: Path, tmp_path: Path, option: str, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "file").write_text("")
    monkeypatch.setattr("pipeline.bop.evaluation.evaluate.errors_of_targets", lambda *_: pytest.fail("computed first"))
    with pytest.raises(InputError, match=r"below[^.]*(/scores\.json)?: cannot be written"):
        called(tiny, (written(tmp_path, perfect()),), **{option: tmp_path / "file" / "below"})


def test_a_folder_is_no_file_for_scores(tiny: Path, tmp_path: Path):
    with pytest.raises(InputError, match="is a folder; give the name of a file"):
        called(tiny, (written(tmp_path, perfect()),), json=tmp_path)


def test_two_files_of_one_name_are_not_written_over_each_other(tiny: Path, tmp_path: Path):
    (tmp_path / "more").mkdir()
    paths = (written(tmp_path, perfect()), written(tmp_path / "more", perfect()))
    with pytest.raises(InputError, match="two results files have this name"):
        called(tiny, paths, out=tmp_path / "out")


def test_results_of_another_dataset_are_refused_in_one_line(tiny: Path, tmp_path: Path):
    other = results_of(claim(FIRST._replace(scene_id=9), 1, LEFT))
    with pytest.raises(FormatError, match=r"mine_lmo-test\.csv: .*no row of 1 is for a target of tiny/test") as caught:
        called(tiny, (written(tmp_path, other, dataset="lmo"),))
    assert "\n" not in str(caught.value)


def test_a_bad_row_is_named(tiny: Path, tmp_path: Path):
    path = written(tmp_path, perfect())
    lines = path.read_text().splitlines()
    lines[2] = lines[2].replace(",0.5,", ",high,")
    path.write_text("\n".join(lines))
    with pytest.raises(FormatError, match=r"mine_tiny-test\.csv: line 3, column score"):
        called(tiny, (path,))


def test_what_does_not_count_is_noted_with_its_line(tiny: Path, tmp_path: Path):
    path = written(tmp_path, results_of(claim(FIRST, 1, LEFT), claim(SECOND, 2, SMALL)))
    _, printed = called(tiny, (path,), vsd=False)
    assert "line 3, column obj_id: object 2 is not asked for in scene 1, image 1" in printed
    assert "2 of 3 targets have no estimate" in printed


def test_of_several_files_a_bad_one_does_not_cost_the_others(tiny: Path, tmp_path: Path):
    out = tmp_path / "scores.json"
    code, printed = called(tiny, (tmp_path / "none_tiny-test.csv", written(tmp_path, perfect())), vsd=False, json=out)
    assert code == 2
    assert "none_tiny-test.csv: no such file" in printed
    assert [entry["method"] for entry in json.loads(out.read_text())] == ["mine"]


def test_missing_images_are_told(lmo: Path):
    _, printed = called(lmo, (lmo / "results" / "megapose_lmo-test.csv",))
    assert "365 of the 1445 instances of the BOP Challenge are here" in printed
    assert "no AR, AR_VSD: no depth image for 49 of 50 images" in printed
