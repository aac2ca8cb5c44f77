"""Running a method over a dataset: what is finished stays finished, what fails is kept with its reason."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from tiny_dataset import ANNOTATED, CAMERA, FIRST, SECOND, claim, make_dataset, moved, perfect, results_of

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.results import read_results
from pipeline.bop.vsd import vsd_of_poses
from pipeline.exceptions import InputError
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
