"""Training: it learns, goes on exactly, shows itself, and names bad input."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from epos_cases import CAMERA, labelled, pose, wedge
from tiny_dataset import FIRST, make_dataset

import pipeline.epos.training.train as training
from pipeline.bop.dataset import open_dataset
from pipeline.epos.checkpoint import TrainedNetwork, TrainedObject, load_network, model_bounds
from pipeline.epos.config import EposSettings
from pipeline.epos.correspondences import establish
from pipeline.epos.estimator import EposEstimator
from pipeline.epos.fragments import fragments_of
from pipeline.epos.networks.config import NetworkConfig
from pipeline.epos.networks.network import EposNetwork
from pipeline.epos.prediction import see
from pipeline.epos.targets import KnownObject, make_targets
from pipeline.epos.training.config import OptimizationConfig, PastedConfig, TrainConfig
from pipeline.epos.training.images import DatasetImages, PastedImages, labelled_image
from pipeline.epos.training.samples import Sample, SampleSet, batch_of, batches, random_window
from pipeline.epos.training.train import Progress, make_optimizer, rate_at, train, training_step
from pipeline.exceptions import InputError
from pipeline.geometry import project, transform_points
from pipeline.recording import NullRecorder, RecordingReader
from pipeline.scene import Image, ImageKey, Target

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    return make_dataset(tmp_path_factory.mktemp("data") / "tiny")


def config_of(tiny, out, **changes):
    usual = {"split": "test", "pasted_share": 0.0, "fragments": 4, "crop": (32, 32), "batch": 2, "steps": 4}
    usual |= {"workers": 0, "checkpoint_every": 2, "device": "cpu", "sample_images": 0}
    return TrainConfig(tiny, out, **{**usual, **changes})


def weights_of(path):
    return load_network(path).network.state_dict()


def test_one_image_is_learned():
    torch.manual_seed(0)
    model, camera_from_model = wedge(), pose(0.0, 0.0, 0.17)
    fragments, image = fragments_of(model, 8), labelled([(wedge(), camera_from_model)])
    batch = batch_of([Sample(image.rgb, make_targets(image, [KnownObject(model, fragments)]))])
    network = EposNetwork(NetworkConfig(dropout=0.0), [8]).train()
    config = TrainConfig(Path(), Path(), steps=130, optimization=OptimizationConfig(4e-3, 10))
    optimizer = make_optimizer(network, config.optimization)
    losses = [training_step(network, optimizer, batch, config, rate_at(i, config)) for i in range(config.steps)]
    assert losses[-1][0] < 0.15 * losses[0][0], (losses[0], losses[-1])

    network.eval()
    matches = establish(see(network, image.rgb).about(0, 1, 0.1), fragments)
    best = matches.at(np.flatnonzero(matches.confidence > 0.5))
    errors = np.linalg.norm(
        project(CAMERA.K, transform_points(camera_from_model, best.points_in_model)) - best.pixels, axis=1
    )
    assert len(best) > 50
    assert np.median(errors) < 2.0, np.percentile(errors, [25, 50, 75, 95])
    trained = TrainedNetwork(network, (TrainedObject(1, fragments, model_bounds(model)),))
    key = ImageKey(1, 0)
    found = EposEstimator(trained, EposSettings()).estimate(
        Image(key, CAMERA, image.rgb, None), [Target(*key, 1, 1)], NullRecorder()
    )
    shift = transform_points(found[0].camera_from_model, model.vertices) - transform_points(
        camera_from_model, model.vertices
    )
    assert np.linalg.norm(shift, axis=1).max() < 0.1 * model.diameter


def test_going_on_is_the_same_to_the_bit(tiny, tmp_path):
    whole = train(config_of(tiny, tmp_path / "whole"))

    def stop(progress: Progress):
        if progress.step == 3:  # between two checkpoints
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(config_of(tiny, tmp_path / "parts"), stop)
    seen: list[Progress] = []
    parts = train(config_of(tiny, tmp_path / "parts"), seen.append)
    assert [progress.step for progress in seen] == [4]
    one, other = weights_of(whole), weights_of(parts)
    assert all(torch.equal(one[name], other[name]) for name in one)
    losses = [torch.load(path / "state.pt", weights_only=True)["losses"] for path in (whole.parent, parts.parent)]
    assert torch.equal(*losses)
    assert len(losses[0]) == 4


def test_killed_in_a_step_goes_on_from_the_checkpoint(tiny, tmp_path, monkeypatch):
    whole = train(config_of(tiny, tmp_path / "whole"))
    calls = iter(range(100))

    def dies(*args):
        if next(calls) == 3:
            for parameter in args[0].parameters():
                parameter.data.add_(1)  # half done
            raise SystemExit
        return training_step(*args)

    monkeypatch.setattr(training, "training_step", dies)
    with pytest.raises(SystemExit):
        train(config_of(tiny, tmp_path / "killed"))
    monkeypatch.undo()
    again = train(config_of(tiny, tmp_path / "killed"))
    one, other = weights_of(whole), weights_of(again)
    assert all(torch.equal(one[name], other[name]) for name in one)


def test_finished_training_is_not_repeated(tiny, tmp_path):
    path = train(config_of(tiny, tmp_path / "out", steps=1))
    written = path.read_bytes()

    def never(_):
        raise AssertionError("a step was made")

    assert train(config_of(tiny, tmp_path / "out", steps=1), never) == path
    assert path.read_bytes() == written


def test_progress_is_recorded(tiny, tmp_path):
    train(config_of(tiny, tmp_path / "out", sample_images=3, record_every=2))
    reader = RecordingReader.open(tmp_path / "out" / "recordings" / "000001_000000.rrd")
    losses = torch.load(tmp_path / "out" / "state.pt", weights_only=True)["losses"].numpy()
    for column, name in enumerate(("total", "objects", "fragments", "coordinates")):
        series = reader.read(f"epos/training/{name}")
        np.testing.assert_array_equal(series.values, losses[:, column])
        np.testing.assert_array_equal(series.steps, [1, 2, 3, 4])
    assert {"image/rgb", "epos/object_probability", "epos/fragments/1", "epos/fragments/2"} <= set(reader.kinds())
    assert len(reader.ground_truth()) == 3


def test_recording_does_not_change_training(tiny, tmp_path):
    one = weights_of(train(config_of(tiny, tmp_path / "a", steps=2)))
    other = weights_of(train(config_of(tiny, tmp_path / "b", steps=2, sample_images=2, record_every=1)))
    assert all(torch.equal(one[name], other[name]) for name in one)


def test_windows_of_one_image_are_other_places_of_it(tiny):
    dataset, made = open_dataset(tiny), []

    class Counted(DatasetImages):
        def image(self, rng):
            made.append(len(made))
            return super().image(rng)

    source = Counted.of(dataset)
    objects = tuple(KnownObject(m, fragments_of(m, 4)) for m in (dataset.model(1), dataset.model(2)))
    samples = SampleSet((source,), (1.0,), objects, (32, 32), None, seed=5, windows=3)
    found = [samples[i] for i in range(6)]
    assert len(made) == 2
    assert not np.array_equal(found[0].rgb, found[1].rgb)
    again = samples[1]  # whatever was asked for before
    np.testing.assert_array_equal(again.rgb, found[1].rgb)
    np.testing.assert_array_equal(again.targets.coordinates, found[1].targets.coordinates)


def test_worker_processes_make_the_same_batches(tiny):
    dataset = open_dataset(tiny)
    objects = tuple(KnownObject(m, fragments_of(m, 4)) for m in (dataset.model(1), dataset.model(2)))
    samples = SampleSet((DatasetImages.of(dataset),), (1.0,), objects, (40, 32), None, seed=5)
    one, other = (list(batches(samples, 2, 3, 5, workers, CPU)) for workers in (0, 1))
    for a, b in zip(one, other, strict=True):
        assert torch.equal(a.images, b.images)
        assert all(torch.equal(x, y) for x, y in zip(a.targets, b.targets, strict=True))
    tall = replace(samples, crop=(40, 64))
    with pytest.raises(InputError, match=r"^training image of 64 x 48 pixels: smaller than the crop of 40 x 64$"):
        list(batches(tall, 2, 0, 1, 1, CPU))


def test_targets_of_a_window_are_those_of_the_image():
    image = labelled([(wedge(), pose(0.0, 0.0, 0.2))])
    known = [KnownObject(wedge(), fragments_of(wedge(), 8))]
    whole, rng = make_targets(image, known), np.random.default_rng(0)
    compared = 0
    for _ in range(60):
        window = random_window(image, (64, 48), rng)
        x, y = np.rint(image.camera.K[:2, 2] - window.camera.K[:2, 2]).astype(int)
        np.testing.assert_array_equal(window.rgb, image.rgb[y : y + 48, x : x + 64])
        if x % 4 == 0 == y % 4:
            found, part = make_targets(window, known), (slice(y // 4, y // 4 + 12), slice(x // 4, x // 4 + 16))
            np.testing.assert_array_equal(found.objects, whole.objects[part])
            np.testing.assert_allclose(found.coordinates, whole.coordinates[part], atol=0.02)
            compared += 1
    assert compared


def test_images_made_on_the_fly_fit_their_targets():
    model = wedge()
    source = PastedImages([model], CAMERA, PastedConfig(objects=(2, 3), size=(0.4, 0.6)))
    image = source.image(np.random.default_rng(4))
    targets = make_targets(image, [KnownObject(model, fragments_of(model, 8))])
    middle = image.instance_ids.reshape(24, 4, 32, 4)[:, 1:3, :, 1:3].transpose(0, 2, 1, 3).reshape(24, 32, 4) >= 0
    clear = middle.all(axis=-1) | ~middle.any(axis=-1)  # OpenGL draws what the ray caster sees, up to outlines
    agree = (targets.objects > 0) == middle.any(axis=-1)
    assert targets.objects.any()
    assert agree[clear].mean() > 0.99
    np.testing.assert_array_equal(source.image(np.random.default_rng(4)).rgb, image.rgb)


def test_masks_that_are_missing_are_computed(tiny):
    image = labelled_image(open_dataset(tiny), FIRST)
    assert image.obj_ids == (1, 1, 2)
    assert set(np.unique(image.instance_ids)) == {-1, 0, 1, 2}


def test_weights_are_taken_over_and_frozen(tiny, tmp_path):
    first = train(config_of(tiny, tmp_path / "first", steps=1))
    second = train(
        config_of(tiny, tmp_path / "second", steps=1, start_from=first, freeze=("early",), fragments=6, seed=9)
    )
    one, other = weights_of(first), weights_of(second)
    early = [name for name in one if name.startswith("backbone.early")]
    assert early
    assert all(torch.equal(one[name], other[name]) for name in early)
    assert not torch.equal(one["pyramid.point.0.weight"], other["pyramid.point.0.weight"])
    assert other["fragment_heads.0.weight"].shape == (24, 128)
    with pytest.raises(InputError, match="has backbone light with group norm, not light with batch norm"):
        train(config_of(tiny, tmp_path / "third", start_from=first, network=NetworkConfig(norm="batch")))


def test_own_number_of_fragments(tiny, tmp_path):
    path = train(config_of(tiny, tmp_path / "out", steps=1, fragments_of={2: 7}))
    assert [len(known.fragments) for known in load_network(path).objects] == [4, 7]


def test_rate_warms_up_and_falls():
    config = TrainConfig(Path(), Path(), steps=1000, optimization=OptimizationConfig(1e-3, 100))
    rates = [rate_at(step, config) for step in range(1000)]
    assert rates[0] == pytest.approx(1e-5)
    assert np.argmax(rates) == 99
    assert 0 < rates[-1] < 3e-6


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"objects": (1, 8)}, "object 8 is not in tiny; available: 1, 2"),
        ({"objects": (1, 1)}, "one is named twice"),
        ({"split": None}, "has no training split; name a split, or make all images on the fly"),
        ({"split": "train"}, "train"),
        ({"crop": (640, 480)}, "training image of 64 x 48 pixels: smaller than the crop of 640 x 480"),
        ({"start_from": Path("nowhere.pt")}, "nowhere.pt: no such file"),
    ],
)
def test_bad_input_is_named(tiny, tmp_path, changes, message):
    with pytest.raises(InputError, match=message) as error:
        train(config_of(tiny, tmp_path / "out", **changes))
    assert "\n" not in str(error.value)


def test_folder_of_another_training_is_refused(tiny, tmp_path):
    train(config_of(tiny, tmp_path / "out", steps=1))
    with pytest.raises(InputError, match="holds a run with another config"):
        train(config_of(tiny, tmp_path / "out", steps=1, fragments=5))
    (tmp_path / "out" / "state.pt").write_bytes(b"torn")
    with pytest.raises(InputError, match=r"state.pt: is no readable network of EPOS \(4 bytes\)"):
        train(config_of(tiny, tmp_path / "out", steps=1))


def test_loss_that_is_not_finite_ends_training(tiny, tmp_path, monkeypatch):
    monkeypatch.setattr(
        training, "epos_loss", lambda *args: type(real(*args))(*(term * torch.nan for term in real(*args)))
    )
    real = __import__("pipeline.epos.training.loss", fromlist=["epos_loss"]).epos_loss
    with pytest.raises(InputError, match="the loss is not finite at step 1"):
        train(config_of(tiny, tmp_path / "out"))


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"batch": 0}, "batch is 0"),
        ({"pasted_share": 1.5}, "pasted_share is 1.5"),
        ({"crop": (16, 64)}, "crop is 16 x 64"),
    ],
)
def test_settings_without_meaning_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        TrainConfig(Path(), Path(), **changes)
