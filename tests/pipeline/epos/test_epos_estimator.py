"""The estimator: right maps give right poses; what it records; what it makes of bad input. And the files of networks."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import torch
from epos_cases import CAMERA, bar, cone, labelled, pose, wedge
from tiny_dataset import make_dataset

from pipeline.bop.dataset import open_dataset
from pipeline.bop.errors import mspd
from pipeline.epos.checkpoint import (
    TrainedNetwork,
    TrainedObject,
    load_network,
    model_bounds,
    save_network,
    write_tensors,
)
from pipeline.epos.config import CorrespondenceConfig, EposSettings
from pipeline.epos.estimator import EposEstimator
from pipeline.epos.fragments import fragments_of
from pipeline.epos.networks.config import NetworkConfig
from pipeline.epos.networks.network import EposNetwork
from pipeline.epos.oracle import OracleSeen, exact
from pipeline.epos.prediction import see
from pipeline.epos.targets import KnownObject, make_targets
from pipeline.estimator import Estimator
from pipeline.exceptions import InputError, UnknownIdError
from pipeline.recording import NullRecorder, RecordingReader
from pipeline.recording import Recorder as FileRecorder
from pipeline.scene import Camera, Image, ImageKey, Target

KEY = ImageKey(1, 2)
WIDE = Camera(np.array([[400.0, 0, 159.0], [0, 401.0, 120.0], [0, 0, 1]]), width=320, height=240)


def trained_on(*models, n=16):
    torch.manual_seed(0)
    network = EposNetwork(NetworkConfig(), [n] * len(models)).eval()
    objects = tuple(TrainedObject(m.obj_id, fragments_of(m, n), model_bounds(m)) for m in models)
    return TrainedNetwork(network, objects)


@dataclass(frozen=True)
class Knowing:
    """Knows what the image shows, as a perfect network would."""

    objects: tuple[TrainedObject, ...]
    seen: OracleSeen

    def see(self, *_):
        return self.seen


@pytest.mark.parametrize(
    ("model", "poses"),
    [
        (wedge(), [pose(0.0, 0.0, 0.25)]),
        (bar(), [pose(0.0, 0.01, 0.25)]),
        (cone(), [pose(0.01, 0.0, 0.2)]),
        (
            bar(),
            [pose(-0.06, -0.02, 0.3), pose(0.05, 0.02, 0.33, (2.5, 0.4, 1.0)), pose(0.0, 0.05, 0.35, (0.1, 2.2, -1.0))],
        ),
    ],
    ids=["no symmetry", "two-fold", "continuous", "three instances"],
)
def test_right_maps_give_right_poses(model, poses):
    objects = trained_on(model, n=64).objects
    image = labelled([(model, p) for p in poses], WIDE)
    known = KnownObject(model, objects[0].fragments)
    targets = make_targets(image, [known])
    seen = OracleSeen(np.zeros((60, 80, 2), np.float32), (exact(targets, 0, known),), targets)
    estimator = EposEstimator(Knowing(objects, seen), EposSettings())
    target = Target(*KEY, model.obj_id, len(poses))
    found = estimator.estimate(Image(KEY, WIDE, image.rgb, None), [target], NullRecorder())
    errors = [min(mspd(model, WIDE.K, e.camera_from_model, p).value for e in found) for p in poses]
    assert len(found) == len(poses)
    assert max(errors) < 1.0, errors


def image_of(rgb=None, camera=CAMERA):
    return Image(KEY, camera, np.zeros((96, 128, 3), np.uint8) if rgb is None else rgb, None)


def biased(trained, *values):
    torch.nn.init.zeros_(trained.network.object_head.weight)
    trained.network.object_head.bias.data = torch.tensor(values)
    return EposEstimator(trained, EposSettings())


def test_no_likely_pixel_gives_no_poses():
    estimator = biased(trained_on(wedge(), bar()), 20.0, 0.0, 0.0)
    assert isinstance(estimator, Estimator)
    assert estimator.estimate(image_of(), [Target(*KEY, 1, 1), Target(*KEY, 2, 3)], NullRecorder()) == []
    assert all(seconds > 0 for seconds in estimator.seconds.values())


def test_all_correspondences_in_one_point_give_no_poses():
    trained = trained_on(wedge(), n=1)
    estimator = EposEstimator(trained, EposSettings(correspondences=CorrespondenceConfig(regression=False)))
    torch.nn.init.zeros_(trained.network.object_head.weight)
    trained.network.object_head.bias.data = torch.tensor([0.0, 5.0])
    assert estimator.estimate(image_of(), [Target(*KEY, 1, 1)], NullRecorder()) == []


def test_everything_is_recorded(tmp_path):
    estimator = biased(trained_on(wedge()), 0.0, 1.0)
    with FileRecorder(tmp_path / "x.rrd", "id", KEY, CAMERA) as recorder:
        estimator.estimate(image_of(), [Target(*KEY, 1, 1)], recorder)
    reader = RecordingReader.open(tmp_path / "x.rrd")
    expected = {
        "object_probability",
        *(f"{name}/1" for name in ("fragments", "fragment_model", "correspondences", "hypotheses", "fitting")),
    }
    assert {f"epos/{name}" for name in expected} <= set(reader.kinds())
    fragments, matches = reader.read("epos/fragments/1"), reader.read("epos/correspondences/1")
    assert fragments.values.shape == (24 * 32, 16)
    k, f = 40, int(fragments.values[40].argmax())
    row = np.flatnonzero((matches.pixels == fragments.cells[k] * 4 + 1.5).all(axis=1) & (matches.fragment_ids == f))
    np.testing.assert_allclose(matches.points_in_model[row[0]], fragments.points_in_model[k, f], atol=1e-4)
    assert reader.read("epos/object_probability").labels == ("background", "1")
    np.testing.assert_array_equal(reader.read("epos/fragment_model/1").columns["size"], fragments_of(wedge(), 16).sizes)


def test_bad_images_and_targets_are_named():
    estimator = biased(trained_on(wedge()), 20.0, 0.0)
    with pytest.raises(InputError, match="scene 1, image 2: has no colour or gray image; EPOS needs one"):
        estimator.estimate(replace(image_of(), rgb=None), [Target(*KEY, 1, 1)], NullRecorder())
    with pytest.raises(
        UnknownIdError, match="object 9 is not in the objects that the network was trained on; available: 1"
    ):
        estimator.estimate(image_of(), [Target(*KEY, 9, 1)], NullRecorder())
    with pytest.raises(InputError, match="smaller than the network's stride"):
        estimator.estimate(image_of(np.zeros((4, 4, 3), np.uint8)), [Target(*KEY, 1, 1)], NullRecorder())


def test_network_is_read_back_as_it_was_written(tmp_path):
    trained, rgb = trained_on(wedge(), bar()), labelled([(wedge(), pose(0, 0, 0.2))]).rgb
    save_network(tmp_path / "network.pt", replace(trained, origin="somehow"))
    again = load_network(tmp_path / "network.pt")
    for one, other in zip(trained.objects, again.objects, strict=True):
        np.testing.assert_array_equal(one.fragments.centers, other.fragments.centers)
        np.testing.assert_array_equal(one.fragments.sizes, other.fragments.sizes)
    assert (again.obj_ids, again.origin) == ((1, 2), "somehow")
    one, other = (see(t.network, rgb).object_probability for t in (trained, again))
    np.testing.assert_array_equal(one, other)
    assert (tmp_path / "network.pt").stat().st_size < 15e6
    assert [path.name for path in tmp_path.iterdir()] == ["network.pt"]


def flipped(content):
    """One bit of the weights changed."""
    middle = len(content) // 2
    return content[:middle] + bytes([content[middle] ^ 1]) + content[middle + 1 :]


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (lambda path: path.write_bytes(b""), "is no readable network of EPOS"),
        (lambda path: path.write_bytes(path.read_bytes()[:5000]), "is no readable network of EPOS"),
        (lambda path: path.write_bytes(flipped(path.read_bytes())), "in it is damaged"),
        (lambda path: torch.save({"weights": {}}, path), "holds no network of EPOS"),
        (lambda path: torch.save(EposNetwork, path), "is no readable network of EPOS"),  # code is not run
        (
            lambda path: write_tensors(path, {"config": "{}", "objects": [], "weights": {}}),
            "its parts do not fit together",
        ),
        (lambda path: path.unlink(), "no such file"),
    ],
)
def test_damaged_file_is_named(tmp_path, damage, message):
    path = tmp_path / "network.pt"
    save_network(path, trained_on(wedge(), n=2))
    damage(path)
    with pytest.raises(InputError, match=message) as error:
        load_network(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_checkpoint_of_other_objects_is_refused(tmp_path):
    dataset = open_dataset(make_dataset(tmp_path / "tiny"))
    own, path = [dataset.model(obj_id, "display") for obj_id in (1, 2)], tmp_path / "network.pt"
    save_network(path, trained_on(*own, n=4))
    assert [
        o.obj_id for o in EposEstimator.of_dataset(dataset, EposSettings(path, device="cpu")).predictor.objects
    ] == [1, 2]
    save_network(path, trained_on(wedge(obj_id=1), n=4))
    with pytest.raises(InputError, match=r"object 1: its model \(60.0 x 40.0 x 20.0 mm\) is not the one"):
        EposEstimator.of_dataset(dataset, EposSettings(path))
    save_network(path, trained_on(wedge(obj_id=31), n=4))
    with pytest.raises(InputError, match="was trained on objects 31, none of which tiny has"):
        EposEstimator.of_dataset(dataset, EposSettings(path))
