"""One damaged file costs what hangs on it and is named; everything else stays usable."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.bop import models, point_distances
from pipeline.bop.assessment import assess, with_adi
from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.doctor import diagnose
from pipeline.bop.results import Results, read_results, write_results
from pipeline.exceptions import FormatError, InputError, MissingFileError
from pipeline.run import Run
from pipeline.scene import ImageKey

REPOSITORY = Path(__file__).resolve().parent.parent.parent.parent
SCENE = Path("test") / "000002"
KEY = ImageKey(2, 0)


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A copy of the demo that may be damaged."""
    return Path(shutil.copytree(REPOSITORY / "assets" / "demo", tmp_path / "demo"))


@pytest.fixture
def results() -> Results:
    return read_results(REPOSITORY / "assets" / "demo" / "results" / "perturbed-1_demo-test.csv")


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def edit(path: Path, change) -> None:
    content = json.loads(path.read_text())
    change(content)
    path.write_text(json.dumps(content))


def said(dataset: Dataset, results: Results | None = None) -> str:
    return "\n".join(assess(dataset, results).problems)


@pytest.mark.parametrize("suffix", ["jpg", "png"])
def test_an_image_that_is_cut_off_is_no_image(root, suffix, capfd):
    path = root / SCENE / ("rgb" if suffix == "jpg" else "depth") / f"000000.{suffix}"
    cut(path)
    dataset = open_dataset(root)
    read = dataset.rgb if suffix == "jpg" else dataset.depth
    with pytest.raises(FormatError, match=rf"000000\.{suffix}: is no image or is cut off"):
        read(KEY)
    assert capfd.readouterr().err == ""  # the decoder would print a line of its own
    assert dataset.camera(KEY).width == 640


def test_an_image_without_a_head_leaves_its_camera_and_rows(root, results):
    whole = len(assess(open_dataset(root), results))
    (root / SCENE / "rgb" / "000000.jpg").write_text("no image")
    dataset = open_dataset(root)
    assert (dataset.camera(KEY).width, dataset.camera(KEY).height) == (640, 480)  # from the depth image
    (root / SCENE / "depth" / "000000.png").write_bytes(b"")
    assert (open_dataset(root).camera(KEY).width, dataset.camera(KEY).height) == (640, 480)  # from camera.json
    assert len(assess(open_dataset(root), results)) == whole


@pytest.mark.parametrize(
    ("pixels", "message"),
    [
        (np.zeros((100, 120), np.uint16), r"depth.000000\.png: has 120 x 100 pixels, its image 640 x 480; register it"),
        (np.zeros((480, 640), np.uint8), r"depth.000000\.png: has 8 bits, which is a picture of depth; export"),
    ],
)
def test_depth_that_cannot_be_meant_is_named(root, pixels, message):
    cv2.imwrite(str(root / SCENE / "depth" / "000000.png"), pixels)
    with pytest.raises(FormatError, match=message):
        open_dataset(root).depth(KEY)


def test_a_damaged_list_of_targets_leaves_the_annotated_instances(root, results):
    cut(root / "test_targets_bop19.json")
    dataset = open_dataset(root)
    with pytest.raises(FormatError, match="is no complete JSON"):
        dataset.targets()
    assert len(assess(dataset, results)) >= 160
    assert "test_targets_bop19.json: is no complete JSON" in said(dataset, results)


@pytest.mark.parametrize("listed", [True, False])
def test_a_damaged_scene_is_named_also_where_no_list_of_targets_speaks_of_it(root, results, listed):
    cut(root / SCENE / "scene_gt.json")
    if not listed:
        (root / "test_targets_bop19.json").unlink()
    assessment = assess(open_dataset(root), results)
    assert set(assessment.scene_id.tolist()) == {1, 3}
    assert [text for text in assessment.problems if "000002" in text and "scene_gt.json: is no complete" in text]


def test_one_damaged_models_info_gives_way_to_the_other(root):
    symmetries = len(open_dataset(root).model(1).symmetries)
    cut(root / "models_eval" / "models_info.json")
    dataset = open_dataset(root)
    assert len(dataset.model(1).symmetries) == symmetries > 1
    assert "models_eval/models_info.json: is no complete JSON" in str(dataset.problems()[0])


def test_without_a_whole_models_info_models_have_no_symmetries_and_that_is_said(root, caplog):
    diameter = open_dataset(root).model(1).diameter
    for folder in ("models", "models_eval"):
        cut(root / folder / "models_info.json")
    dataset = open_dataset(root)
    assert len(dataset.model(1).symmetries) == 1
    assert dataset.model(1).diameter == pytest.approx(diameter, rel=1e-4)
    assert "until then objects count as without symmetries" in said(dataset)
    assert len([line for line in caplog.messages if "models_eval/models_info.json" in line]) == 1


def test_instances_of_an_object_without_a_model_are_named(root):
    edit(root / SCENE / "scene_gt.json", lambda content: content["0"][0].update(obj_id=77))
    assert "000002/scene_gt.json: has instances of objects without a model (77); add their models" in said(
        open_dataset(root)
    )


def test_a_camera_matrix_that_cannot_be_inverted_is_named(root):
    edit(root / SCENE / "scene_camera.json", lambda content: content["0"]["cam_K"].__setitem__(8, 0))
    with pytest.raises(FormatError, match=r"image 0: cam_K cannot be inverted \(\[.*\]\); expected fx 0 cx"):
        open_dataset(root).camera(KEY)
    assert open_dataset(root).camera(ImageKey(2, 1)).width == 640


def test_a_results_file_that_is_none_is_named(tmp_path):
    with pytest.raises(MissingFileError, match=r"none\.csv: no such file; give a results file"):
        read_results(tmp_path / "none.csv")
    with pytest.raises(MissingFileError, match="is no file; give a results file"):
        read_results(tmp_path)


def test_estimates_for_absent_images_are_found_by_the_doctor(root, results, tmp_path):
    path = tmp_path / "mine_demo-test.csv"
    results.scene_id[:3] = 77
    results.im_id[3:5] = 1_000_000
    results.translation_mm[5] = 1e300
    write_results(path, results)
    found = next(f for f in diagnose(root, results=[path]) if f.title == "Estimates for images that are not there")
    assert found.evidence.startswith(f"5 of {len(results)} estimates, first scene 77 image")


def test_a_run_folder_that_cannot_be_made_is_named(root, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match=r"file.recordings: cannot be made \(Not a directory\)"):
        Run.create(tmp_path / "file", dataset=open_dataset(root), method="mine")


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("dataset_root", 5, "run.json: dataset_root is 5; expected text"),
        ("method", None, "run.json: method is None; expected text"),
        ("config", [1], r"run.json: config is \[1\]; expected an object"),
    ],
)
def test_a_run_that_says_nonsense_is_named(root, tmp_path, name, value, message):
    Run.create(tmp_path / "run", dataset=open_dataset(root), method="mine").close()
    edit(tmp_path / "run" / "run.json", lambda content: content.update({name: value}))
    with pytest.raises(FormatError, match=message):
        Run.open(tmp_path / "run")


@pytest.mark.parametrize("wrong", [{"scene_id": []}, {"im_id": "1"}, {"results_bytes": None}, {"timings": 3}])
def test_a_finished_image_that_is_none_is_named(root, tmp_path, wrong):
    with Run.create(tmp_path / "run", dataset=open_dataset(root), method="mine") as run:
        run.add(KEY, [])
    path = tmp_path / "run" / "images.jsonl"
    path.write_text(json.dumps(json.loads(path.read_text()) | wrong) + "\n")
    with pytest.raises(FormatError, match=r"images\.jsonl: line .* is no finished image; delete this line"):
        Run.open(tmp_path / "run").finished()


def test_loops_are_compiled_also_where_nothing_can_be_written(monkeypatch):
    compiled = point_distances.njit

    def njit(cache=False, **options):
        if cache:
            raise RuntimeError("cannot cache function: no locator available")
        return compiled(**options)

    monkeypatch.setattr(point_distances, "njit", njit)
    assert point_distances._compiled()(lambda x: x + 1)(1) == 2


@pytest.mark.parametrize("stretch", [(1, 1, 1), (3, 2, 1), (1, 1, 0.01)])
def test_the_diameter_of_many_points_is_exact(stretch, monkeypatch):
    monkeypatch.setattr(models, "MOST_COMPARED", 10)
    points = np.random.default_rng(0).normal(size=(2000, 3))
    points *= np.array(stretch) / np.linalg.norm(points, axis=1, keepdims=True)
    brute = max(np.linalg.norm(points - point, axis=1).max() for point in points)
    assert models.diameter_of(points) == pytest.approx(brute, rel=1e-14)


def test_adi_of_huge_models_is_left_out_and_that_is_said(root, results, monkeypatch):
    dataset = open_dataset(root)
    assessment = assess(dataset, results)
    monkeypatch.setattr("pipeline.bop.assessment.MOST_ADI_VERTICES", len(dataset.model(1).vertices) - 1)
    filled = with_adi(dataset, results, assessment)
    assert np.isnan(filled.add[(filled.obj_id == 1) & (filled.estimate >= 0)]).all()
    assert [text for text in filled.problems if "obj_000001.ply: has" in text and "ADI is left out" in text]
