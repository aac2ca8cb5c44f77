"""The data that all browsers share: assessed in the background, growing with a run, sound where files are damaged."""

import shutil
import threading
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest
from tiny_dataset import ANNOTATED, BARE, FIRST, SECOND, claim, make_dataset, moved, perfect, results_of

from inspector import workspace as workspace_module
from inspector.drawing import draw
from inspector.frame import frame_of
from inspector.image_cache import IMAGES_KEPT
from inspector.opening import open_workspace
from inspector.recordings import RECORDINGS_KEPT
from inspector.selection import Display, RowKey, Selection
from inspector.workspace import Method, Workspace, find_row
from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.results import Results, read_results, write_results
from pipeline.exceptions import FormatError, InputError, MissingFileError
from pipeline.replay import Replay
from pipeline.run import Run
from pipeline.running import run_estimator

PATIENCE = 30.0
"""Seconds after which something that should have happened did not."""
SECOND_ROW = RowKey(*SECOND, 1, 0, -1)
SECOND_POSE = ANNOTATED[SECOND][0][1]


@pytest.fixture
def root(tmp_path: Path) -> Path:
    return make_dataset(tmp_path / "tiny")


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[..., Workspace]]:
    """Opens workspaces and stops them."""
    monkeypatch.setattr(workspace_module, "RUN_POLL_SECONDS", 0.05)
    made: list[Workspace] = []

    def open_one(*arguments, **options) -> Workspace:
        made.append(open_workspace(*arguments, **options))
        return made[-1]

    yield open_one
    for one in made:
        one.stop()


def results_file(folder: Path, results: Results, name: str = "method_tiny-test.csv") -> Path:
    write_results(folder / name, results)
    return folder / name


def wait_until(found: Workspace, condition: Callable[[], object]) -> None:
    """Wait for a condition that only changes when the workspace tells its listeners."""
    news = threading.Event()
    stop = found.listen(news.set)
    try:
        while not condition():
            assert news.wait(PATIENCE), f"nothing happened; jobs {found.jobs}, problems {found.problems}"
            news.clear()
    finally:
        stop()


def record(dataset: Dataset, folder: Path, results: Results) -> Run:
    with Run.create(folder, dataset=dataset, method=results.method) as run:
        run_estimator(Replay(dataset, results), dataset, run)
    return run


# ------------------------------------------------------------------------------------------------------ assessment
def test_assessments_appear_with_all_their_columns(root: Path, opened):
    found = opened(root, (results_file(root, perfect()), results_file(root, results_of(), "empty_tiny-test.csv")))
    assert found.assessment(0) is None
    assert found.method_names == ("method", "empty")
    found.start()

    def complete() -> bool:
        ready = [found.assessment(method) for method in (0, 1)]
        return not found.jobs and all(a is not None and not np.isnan(a.vsd).any() for a in ready)

    wait_until(found, complete)
    first, second = found.assessment(0), found.assessment(1)
    assert first is not None
    assert second is not None
    np.testing.assert_allclose(first.mssd, 0, atol=1e-12)
    assert np.isinf(second.mssd).all()
    assert not np.isnan(first.visible_fraction).any()
    assert found.assessment(2) is None
    assert found.problems == ()


def test_without_results_the_annotations_are_the_rows(root: Path, opened):
    found = opened(root)
    found.start()
    wait_until(found, lambda: found.assessment(0) is not None and not found.jobs)
    assert len(found.assessment(0)) == 4
    assert found.estimate_of(0, SECOND_ROW) is None


def test_methods_of_one_name_are_told_apart(root: Path, opened):
    files = [results_file(root, perfect(), name) for name in ("m_tiny-test.csv", "m_tiny-test_old.csv")]
    assert opened(root, tuple(files)).method_names == ("m (m_tiny-test)", "m (m_tiny-test_old)")


def test_estimates_are_found_by_row(root: Path, opened):
    near, extra = moved(SECOND_POSE, x=0.001), moved(SECOND_POSE, x=0.002)
    found = opened(root, (results_file(root, results_of(claim(SECOND, 1, near), claim(BARE, 2, extra))),))
    assert found.estimate_of(0, SECOND_ROW) is None  # not assessed yet
    found.start()
    wait_until(found, lambda: found.assessment(0) is not None)
    np.testing.assert_allclose(found.estimate_of(0, SECOND_ROW).camera_from_model, near)
    np.testing.assert_allclose(found.estimate_of(0, RowKey(*BARE, 2, -1, 1)).camera_from_model, extra)
    for row in (RowKey(*BARE, 2, -1, 99), RowKey(*BARE, 2, -1, -1), RowKey(9, 9, 9, 9, -1), RowKey(*FIRST, 1, 0, -1)):
        assert found.estimate_of(0, row) is None
    assert found.estimate_of(7, SECOND_ROW) is None
    assert find_row(found.assessment(0), SECOND_ROW) is not None


def test_what_cannot_be_assessed_is_named_once_and_the_rest_is_there(root: Path, opened):
    (root / "models" / "obj_000002.ply").write_text("no mesh")
    files = [results_file(root, perfect(), name) for name in ("a_tiny-test.csv", "b_tiny-test.csv")]
    found = opened(root, tuple(files))
    found.start()
    wait_until(found, lambda: found.assessment(1) is not None and not found.jobs)
    (problem,) = found.problems
    assert "obj_000002.ply" in problem
    assert found.assessment(1).obj_id.tolist() == [1, 1, 1]


def test_a_listener_that_fails_does_not_keep_others_from_hearing(root: Path, opened, caplog: pytest.LogCaptureFixture):
    found = opened(root)
    heard = []

    def fail() -> None:
        raise RuntimeError

    stops = [found.listen(fail), found.listen(lambda: heard.append(1)), found.listen(fail)]
    with caplog.at_level("CRITICAL", "inspector.workspace"):
        found.changed()
    assert heard == [1]
    for stop in stops:
        stop()
    found.changed()
    assert heard == [1]


def test_work_is_shown_while_it_lasts(root: Path, opened):
    found = opened(root)
    seen = []
    found.listen(lambda: seen.append(dict(found.jobs)))
    with found.job("counting") as progress:
        for share in (0.0, 0.5, 0.501, 1.0):
            progress(share)
    assert {"counting": 0.5} in seen
    assert len([jobs for jobs in seen if jobs]) <= 3  # not for every little step
    assert found.jobs == {}
    with pytest.raises(ZeroDivisionError), found.job("failing"):
        raise ZeroDivisionError
    assert found.jobs == {}


# ---------------------------------------------------------------------------------------------------------- images
def test_images_are_kept_but_not_all_of_them(root: Path, opened):
    folder = root / "test" / "000001"
    (folder / "scene_camera.json").write_text(
        "{" + ",".join(f'"{i}": {{"cam_K": [80,0,33,0,81,22,0,0,1], "depth_scale": 0.1}}' for i in range(40)) + "}"
    )
    for im_id in range(2, 40):
        for kind in ("rgb", "depth"):
            shutil.copy(folder / kind / "000000.png", folder / kind / f"{im_id:06d}.png")
    found = opened(root)
    first = found.images.get(FIRST)
    assert found.images.get(FIRST) is first
    for im_id in range(2, 2 + IMAGES_KEPT - 1):
        found.images.get(FIRST._replace(im_id=im_id))
        assert found.images.get(FIRST) is first  # used all the time: stays
    for im_id in range(20, 40):
        found.images.get(FIRST._replace(im_id=im_id))
    assert found.images.get(FIRST) is not first
    assert len(found.images) == IMAGES_KEPT


@pytest.mark.parametrize("channel", ["rgb", "depth"])
def test_a_channel_that_cannot_be_read_is_named_and_the_other_is_there(root: Path, opened, channel: str):
    path = root / "test" / "000001" / channel / "000000.png"
    path.write_bytes(path.read_bytes()[:300])
    found = opened(root)
    image, (problem,) = found.images.get(FIRST)
    assert str(path) in problem
    assert "\n" not in problem
    assert getattr(image, channel) is None
    assert getattr(image, {"rgb": "depth", "depth": "rgb"}[channel]) is not None
    assert found.images.get(SECOND).problems == ()


def test_depth_of_another_size_is_named_and_left_out(root: Path, opened):
    path = root / "test" / "000001" / "depth" / "000000.png"
    cv2.imwrite(str(path), np.full((20, 30), 4000, np.uint16))
    image, (problem,) = opened(root).images.get(FIRST)
    assert image.depth is None
    assert "30 x 20" in problem
    assert image.rgb is not None


# ------------------------------------------------------------------------------------------------------------ runs
def test_a_run_opens_with_its_dataset_and_its_own_results(root: Path, tmp_path: Path, opened):
    record(open_dataset(root), tmp_path / "run", perfect())
    found = opened(tmp_path / "run", (results_file(root, results_of(), "other_tiny-test.csv"),))
    assert found.method_names == ("perfect", "other")
    assert found.dataset.root == root
    assert len(found.methods[0].results) == 4


def test_a_growing_run_is_followed(root: Path, tmp_path: Path, opened):
    dataset = open_dataset(root)
    with Run.create(tmp_path / "run", dataset=dataset, method="growing") as run:
        found = opened(tmp_path / "run")
        found.start()
        wait_until(found, lambda: found.assessment(0) is not None and not found.jobs)
        assert np.isinf(found.assessment(0).mssd).all()
        assert found.recordings.reader(SECOND) is None
        before = frame_of(found, Selection(row=SECOND_ROW))
        assert before is not None
        assert before.estimate is None

        with run.recorder(SECOND) as recorder:
            recorder.text("log", "fitted")
        run.add(SECOND, [claim(SECOND, 1, SECOND_POSE)])
        wait_until(found, lambda: np.isfinite(found.assessment(0).mssd).any() and not found.jobs)
        assert found.recordings.reader(SECOND) is not None
        after = frame_of(found, Selection(row=SECOND_ROW))
        assert after is not None
        assert after.estimate is not None
        assert after != before, "a browser that looks at this row would keep the old picture"


def test_following_a_run_survives_a_results_file_that_cannot_be_read_for_a_moment(
    root: Path, tmp_path: Path, opened, monkeypatch: pytest.MonkeyPatch
):
    failed = threading.Event()

    def read_at_second_try(path: Path) -> Results:
        if not failed.is_set():
            failed.set()
            raise FormatError(f"{path}: cut in half")
        return read_results(path)

    with Run.create(tmp_path / "run", dataset=open_dataset(root), method="growing") as run:
        found = opened(tmp_path / "run")
        monkeypatch.setattr(workspace_module, "read_results", read_at_second_try)
        found.start()
        wait_until(found, lambda: found.assessment(0) is not None and not found.jobs)
        run.add(FIRST, [])
        assert failed.wait(PATIENCE)
        run.add(SECOND, [claim(SECOND, 1, SECOND_POSE)])
        wait_until(found, lambda: np.isfinite(found.assessment(0).mssd).any())
    assert any("cut in half" in problem for problem in found.problems)


def test_following_a_run_survives_a_fault_of_ours(
    root: Path, tmp_path: Path, opened, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
):
    failed = threading.Event()
    assess = workspace_module.assess

    def assess_at_second_try(*arguments, **options):
        if len(arguments[1]) == 0 or failed.is_set():
            return assess(*arguments, **options)
        failed.set()
        raise ZeroDivisionError

    monkeypatch.setattr(workspace_module, "assess", assess_at_second_try)
    with Run.create(tmp_path / "run", dataset=open_dataset(root), method="growing") as run:
        found = opened(tmp_path / "run")
        found.start()
        wait_until(found, lambda: found.assessment(0) is not None and not found.jobs)
        with caplog.at_level("CRITICAL", "inspector.workspace"):
            run.add(FIRST, [claim(FIRST, 1, SECOND_POSE)])
            assert failed.wait(PATIENCE)
            run.add(SECOND, [claim(SECOND, 1, SECOND_POSE)])
            wait_until(found, lambda: np.isfinite(found.assessment(0).mssd).any())


def test_recordings_are_read_once_and_again_when_they_are_written_anew(root: Path, tmp_path: Path, opened):
    run = record(open_dataset(root), tmp_path / "run", perfect())
    found = opened(tmp_path / "run")
    reader = found.recordings.reader(FIRST)
    assert reader is found.recordings.reader(FIRST)
    assert "image/rgb" in reader.kinds()
    assert found.recordings.reader(BARE) is None
    run.recording_path(FIRST).touch()
    assert found.recordings.reader(FIRST) is not reader
    assert len(found.recordings) <= RECORDINGS_KEPT


@pytest.mark.parametrize("damage", ["truncated", "flipped bytes", "empty"])
def test_a_damaged_recording_gives_one_clear_line(root: Path, tmp_path: Path, opened, damage: str):
    run = record(open_dataset(root), tmp_path / "run", perfect())
    path = run.recording_path(FIRST)
    content = bytearray(path.read_bytes())
    if damage == "flipped bytes":
        content[len(content) // 2] ^= 0xFF
    path.write_bytes(content[: {"truncated": len(content) // 2, "empty": 0}.get(damage, len(content))])
    found = opened(tmp_path / "run")
    with pytest.raises(InputError, match=path.name) as error:
        found.recordings.reader(FIRST)
    assert "\n" not in str(error.value)
    assert found.recordings.reader(SECOND) is not None

    found.start()
    wait_until(found, lambda: found.assessment(0) is not None and not found.jobs)
    selection = Selection(row=RowKey(*FIRST, 1, 0, -1), display=Display(recorded="vsd/0/cost"))
    frame = frame_of(found, selection)
    assert frame is not None
    drawing = draw(frame, selection)
    assert {"image", "ground_truth", "estimate"} <= set(drawing.nodes)  # the rest of the picture is there
    assert any(path.name in warning for warning in drawing.warnings)


# -------------------------------------------------------------------------------------------------------- bad input
def test_a_run_whose_dataset_went_away_says_so(root: Path, tmp_path: Path):
    record(open_dataset(root), tmp_path / "run", perfect())
    root.rename(tmp_path / "elsewhere")
    with pytest.raises(MissingFileError, match=r"run\.json: its dataset .*tiny is not there; put it back or correct"):
        open_workspace(tmp_path / "run")


@pytest.mark.parametrize(("name", "message"), [("absent.csv", "absent.csv"), ("cut.csv", "cut.csv")])
def test_results_that_cannot_be_read_are_named(root: Path, name: str, message: str):
    (root / "cut.csv").write_text("scene_id,im_id,obj_id,score,R,t,time\n1,0,1,0.5,1 0 0 0 1 0 0 0,0 0 400,-1\n")
    with pytest.raises(InputError, match=message) as error:
        open_workspace(root, (root / name,))
    assert "\n" not in str(error.value)


def test_a_folder_that_is_not_there_is_named(tmp_path: Path):
    with pytest.raises(InputError, match="nowhere"):
        open_workspace(tmp_path / "nowhere")


def test_stopping_before_starting_and_twice_is_harmless(root: Path):
    found = Workspace(open_dataset(root), (Method("m", perfect(), root / "m.csv"),))
    found.stop()
    found.stop()
