"""Running a method over a dataset: what is finished stays finished, what fails is kept with its reason."""

import os
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from tiny_dataset import ANNOTATED, CAMERA, FIRST, SECOND, claim, make_dataset, moved, perfect, results_of
from worker_functions import Annotated, without_network

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.results import read_results
from pipeline.bop.vsd import vsd_of_poses
from pipeline.exceptions import InputError
from pipeline.lazy_estimator import LazyEstimator
from pipeline.parallel import HERE, Workers, open_workers
from pipeline.recording import ColorImage, DepthMap, Heatmap, Mask, RecordingReader, StageRecorder
from pipeline.replay import TAU, Replay
from pipeline.run import Run
from pipeline.running import run_estimator
from pipeline.scene import Image, ImageKey, PoseEstimate, Target


class Copying:
    """Gives the annotated poses, and fails as it is told."""

    def __init__(self, dataset: Dataset, failing: tuple[ImageKey, ...] = (), error: Exception | None = None) -> None:
        self._dataset = dataset
        self._failing = failing
        self._error = error or InputError("the network file is absent; download it")
        self.asked: list[ImageKey] = []

    def estimate(self, image: Image, targets: Sequence[Target], recorder: StageRecorder) -> list[PoseEstimate]:
        self.asked.append(image.key)
        if image.key in self._failing:
            raise self._error
        return [claim(image.key, gt.obj_id, gt.camera_from_model) for gt in self._dataset.ground_truth(image.key)]


@pytest.fixture
def dataset(tmp_path: Path) -> Dataset:
    return open_dataset(make_dataset(tmp_path / "tiny"))


def start(dataset: Dataset, tmp_path: Path) -> Run:
    return Run.create(tmp_path / "run", dataset=dataset, method="copying")


def test_all_targets_are_estimated(dataset: Dataset, tmp_path: Path):
    with start(dataset, tmp_path) as run:
        shares: list[float] = []
        assert run_estimator(Copying(dataset), dataset, run, progress=shares.append) == 0
        assert run.finished_images() == (FIRST, SECOND)
        assert [image.failure for image in run.finished()] == [None, None]
        assert run.timings()["total"] > 0
    results = read_results(run.results_path)
    assert results.obj_id.tolist() == [1, 1, 2, 1]
    np.testing.assert_allclose(results.estimate(3).camera_from_model, ANNOTATED[SECOND][0][1])
    assert shares == [0.0, 0.5, 1.0]


def test_images_and_poses_are_recorded(dataset: Dataset, tmp_path: Path):
    with start(dataset, tmp_path) as run:
        run_estimator(Copying(dataset), dataset, run)
    reader = RecordingReader.open(run.recording_path(FIRST))
    assert reader.verified
    np.testing.assert_array_equal(reader.read("image/rgb", ColorImage).rgb, dataset.rgb(FIRST))
    np.testing.assert_allclose(reader.read("image/depth", DepthMap).depth, dataset.depth(FIRST), atol=1e-4)
    assert {"ground_truth", "estimates"} <= {path.split("/")[0] for path in reader.kinds()}


def test_recording_can_be_left_out(dataset: Dataset, tmp_path: Path):
    with start(dataset, tmp_path) as run:
        run_estimator(Copying(dataset), dataset, run, record=False)
        assert run.finished_images() == (FIRST, SECOND)
    assert not list(run.recordings.glob("*.rrd"))


def test_what_is_finished_is_not_done_again(dataset: Dataset, tmp_path: Path):
    with pytest.raises(KeyboardInterrupt), start(dataset, tmp_path) as run:
        run_estimator(Copying(dataset, (SECOND,), KeyboardInterrupt()), dataset, run)  # type: ignore[arg-type]
    again = Copying(dataset)
    with start(dataset, tmp_path) as run:
        assert run.finished_images() == (FIRST,)
        assert run_estimator(again, dataset, run) == 0
        assert run.finished_images() == (FIRST, SECOND)
        once_more = Copying(dataset)
        assert run_estimator(once_more, dataset, run) == 0
    assert again.asked == [SECOND]
    assert once_more.asked == []
    assert len(read_results(run.results_path)) == 4


def test_a_failure_is_kept_with_its_reason_and_the_others_go_on(dataset: Dataset, tmp_path: Path):
    with start(dataset, tmp_path) as run:
        assert run_estimator(Copying(dataset, (FIRST,)), dataset, run) == 1
        first, second = run.finished()
    assert first.key == FIRST
    assert first.failure == "the network file is absent; download it"
    assert second.failure is None
    assert read_results(run.results_path).im_id.tolist() == [1]
    with start(dataset, tmp_path) as run:
        again = Copying(dataset)
        assert run_estimator(again, dataset, run) == 0
    assert again.asked == []


def test_an_image_that_cannot_be_read_is_a_failure_of_that_image(tmp_path: Path):
    root = make_dataset(tmp_path / "tiny")
    (root / "test" / "000001" / "depth" / "000000.png").write_bytes(b"no image")
    dataset = open_dataset(root)
    with start(dataset, tmp_path) as run:
        assert run_estimator(Copying(dataset), dataset, run) == 1
        failures = {image.key: image.failure for image in run.finished()}
    assert failures[SECOND] is None
    assert "000000.png" in str(failures[FIRST])


def test_a_pose_that_is_not_finite_is_a_failure_of_its_image(dataset: Dataset, tmp_path: Path):
    bad = moved(ANNOTATED[FIRST][0][1], x=np.nan)
    results = results_of(claim(FIRST, 1, bad), claim(SECOND, 1, ANNOTATED[SECOND][0][1]))
    with start(dataset, tmp_path) as run:
        assert run_estimator(Replay(dataset, results), dataset, run) == 1
        failures = {image.key: image.failure for image in run.finished()}
    assert "not finite" in str(failures[FIRST])
    assert failures[SECOND] is None


def test_our_own_faults_are_not_taken_for_failures_of_the_method(dataset: Dataset, tmp_path: Path):
    with start(dataset, tmp_path) as run, pytest.raises(ZeroDivisionError):
        run_estimator(Copying(dataset, (FIRST,), ZeroDivisionError()), dataset, run)


# --------------------------------------------------------------------------------------------- several processes
@pytest.fixture(scope="module")
def two() -> Iterator[Workers]:
    """Two other processes."""
    with open_workers(2) as workers:
        yield workers


def annotated(dataset: Dataset, marks: Path, **options: int) -> LazyEstimator:
    marks.mkdir(exist_ok=True)
    return LazyEstimator(partial(Annotated, dataset.root, marks, **options))


def asked(marks: Path, key: ImageKey) -> int:
    """How often an image was given to the estimator."""
    path = marks / f"image-{key.im_id}"
    return len(path.read_text().splitlines()) if path.exists() else 0


def test_other_processes_find_and_record_the_same(two: Workers, dataset: Dataset, tmp_path: Path):
    with start(dataset, tmp_path) as run:
        shares: list[float] = []
        estimator = annotated(dataset, tmp_path / "marks")
        assert run_estimator(estimator, dataset, run, progress=shares.append, workers=two) == 0
        assert set(run.finished_images()) == {FIRST, SECOND}
    assert shares == [0.0, 0.5, 1.0]
    results = read_results(run.results_path)
    for key in (FIRST, SECOND):
        found = [estimate.camera_from_model for estimate in results.estimates(key)]
        np.testing.assert_allclose(found, [pose for _, pose in ANNOTATED[key]])
        reader = RecordingReader.open(run.recording_path(key))
        assert reader.verified
        np.testing.assert_array_equal(reader.read("image/rgb", ColorImage).rgb, dataset.rgb(key))
        assert "estimates/0" in reader.kinds()
    assert not (tmp_path / "marks" / f"made-{os.getpid()}").exists()


def test_an_estimator_is_made_once_in_each_process(two: Workers, tmp_path: Path):
    demo = open_dataset(Path(__file__).resolve().parents[2] / "assets" / "demo")
    marks = tmp_path / "marks"
    with Run.create(tmp_path / "run", dataset=demo, method="annotated") as run:
        run_estimator(annotated(demo, marks), demo, run, record=False, workers=two)
        assert len(run.finished_images()) == 24
    made = [path.read_text() for path in marks.glob("made-*")]
    assert made in (["made\n"], ["made\n"] * 2)


def test_an_estimator_that_cannot_be_made_ends_the_run(two: Workers, dataset: Dataset, tmp_path: Path):
    missing = LazyEstimator(partial(without_network, dataset.root))
    with start(dataset, tmp_path) as run:
        for workers in (HERE, two):
            with pytest.raises(InputError, match="the network file is absent; download it"):
                run_estimator(missing, dataset, run, workers=workers)
        assert run.finished_images() == ()


def test_images_of_a_killed_process_are_done_again(two: Workers, dataset: Dataset, tmp_path: Path):
    with start(dataset, tmp_path) as run:
        estimator = annotated(dataset, tmp_path / "marks", dies_once=FIRST.im_id)
        assert run_estimator(estimator, dataset, run, workers=two) == 0
        assert {image.key: image.failure for image in run.finished()} == {FIRST: None, SECOND: None}
    assert asked(tmp_path / "marks", FIRST) == 2
    assert len(read_results(run.results_path)) == 4
    assert not list(run.recordings.glob(".*"))


def test_images_that_fail_or_kill_are_kept_as_failures_and_the_others_go_on(
    two: Workers, dataset: Dataset, tmp_path: Path
):
    options = {"fails": SECOND.im_id, "dies": FIRST.im_id}
    with start(dataset, tmp_path) as run:
        assert run_estimator(annotated(dataset, tmp_path / "marks", **options), dataset, run, workers=two) == 2
        failures = {image.key: image.failure for image in run.finished()}
    assert failures[SECOND] == "image 1 is too dark; light it"
    assert str(failures[FIRST]).startswith("scene 1, image 0: its worker process ended (signal 9, Killed), 3 times")
    with start(dataset, tmp_path) as run:
        assert run_estimator(annotated(dataset, tmp_path / "marks"), dataset, run, workers=two) == 0
    assert asked(tmp_path / "marks", SECOND) == 1


def test_an_interrupted_run_of_several_processes_goes_on(two: Workers, dataset: Dataset, tmp_path: Path):
    def interrupt(share: float) -> None:
        if share:
            raise KeyboardInterrupt

    estimator = annotated(dataset, tmp_path / "marks")
    with pytest.raises(KeyboardInterrupt), start(dataset, tmp_path) as run:
        run_estimator(estimator, dataset, run, progress=interrupt, workers=two)
    with start(dataset, tmp_path) as run:
        (first,) = run.finished_images()
        assert run_estimator(estimator, dataset, run, workers=two) == 0
        assert len(run.finished_images()) == 2
    assert asked(tmp_path / "marks", first) == 1
    assert len(read_results(run.results_path)) == 4


def test_what_killed_processes_were_writing_is_removed(dataset: Dataset, tmp_path: Path):
    with start(dataset, tmp_path) as run:
        names = [".000001_000000.rrd.123-0a1b2c3d", ".000001_000000.rrd.123-0a1b2c3d.sha256", ".layout.rbl.123"]
        for name in (*names, ".keep"):
            (run.recordings / name).touch()
        run_estimator(Copying(dataset), dataset, run)
        assert [path.name for path in run.recordings.glob(".*")] == [".keep"]


# -------------------------------------------------------------------------------------------------------- replay
def test_replay_gives_what_was_submitted(dataset: Dataset, tmp_path: Path):
    submitted = perfect()
    with start(dataset, tmp_path) as run:
        assert run_estimator(Replay(dataset, submitted), dataset, run) == 0
    read = read_results(run.results_path)
    np.testing.assert_array_equal(read.rotation, submitted.rotation)
    np.testing.assert_array_equal(read.translation_mm, submitted.translation_mm)


def test_replay_records_the_maps_of_vsd(dataset: Dataset, tmp_path: Path):
    truth = ANNOTATED[SECOND][0][1]
    found = moved(truth, x=0.004, z=0.012)
    with start(dataset, tmp_path) as run:
        run_estimator(Replay(dataset, results_of(claim(SECOND, 1, found))), dataset, run)
    depth, model = dataset.depth(SECOND), dataset.model(1)
    assert depth is not None
    share = TAU / model.diameter
    expected = vsd_of_poses(model, CAMERA, found, truth, depth, [share], dataset.facts.vsd_delta)
    reader = RecordingReader.open(run.recording_path(SECOND))
    for name in ("visible_estimate", "visible_gt"):
        np.testing.assert_array_equal(reader.read(f"vsd/0/{name}", Mask).mask, expected.expand(getattr(expected, name)))
    difference = reader.read("vsd/0/distance_difference", Heatmap)
    np.testing.assert_array_equal(difference.values, expected.expand(expected.difference.astype(np.float32), np.nan))
    assert difference.unit == "m"
    cost = reader.read("vsd/0/cost", Heatmap).values
    assert np.nanmean(cost) == pytest.approx(expected.values[0])
    assert 0 < expected.values[0] < 1


def test_replay_records_no_vsd_without_depth_or_without_an_estimate(tmp_path: Path):
    dataset = open_dataset(make_dataset(tmp_path / "flat", depth=False))
    with Run.create(tmp_path / "a", dataset=dataset, method="m") as run:
        assert run_estimator(Replay(dataset, perfect()), dataset, run) == 0
    assert not [path for path in RecordingReader.open(run.recording_path(FIRST)).kinds() if path.startswith("vsd")]
    dataset = open_dataset(make_dataset(tmp_path / "tiny"))
    with Run.create(tmp_path / "b", dataset=dataset, method="m") as run:
        run_estimator(Replay(dataset, results_of(claim(FIRST, 1, ANNOTATED[FIRST][1][1]))), dataset, run)
    recorded = {path.split("/")[1] for path in RecordingReader.open(run.recording_path(FIRST)).kinds() if "vsd" in path}
    assert recorded == {"1"}


def test_replay_of_lmo_on_the_image_with_depth(lmo: Path, tmp_path: Path):
    dataset = open_dataset(lmo)
    results = read_results(lmo / "results" / "megapose_lmo-test.csv")
    key = ImageKey(2, 3)
    targets = [target for target in dataset.targets() if target.image == key]
    with Run.create(tmp_path / "run", dataset=dataset, method="megapose") as run:
        image = dataset.image(key)
        with run.recorder(key, image.camera) as recorder:
            found = Replay(dataset, results).estimate(image, targets, recorder)
        run.add(key, found)
    assert 0 < len(found) <= len(targets)
    recorded = [path for path in RecordingReader.open(run.recording_path(key)).kinds() if path.startswith("vsd/")]
    assert len(recorded) >= 4 * 5
