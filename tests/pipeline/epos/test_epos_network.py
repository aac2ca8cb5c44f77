"""Networks: shapes, sparse output against dense, memory, damage."""

import numpy as np
import pytest
import torch
from torch.utils._python_dispatch import TorchDispatchMode

from pipeline.epos.networks.config import NetworkConfig
from pipeline.epos.networks.network import EposNetwork, chosen_device
from pipeline.epos.prediction import SeenImage, see
from pipeline.epos.training.config import LossConfig
from pipeline.epos.training.loss import TargetTensors, epos_loss
from pipeline.exceptions import InputError

torch.set_num_threads(1)
RGB = np.random.default_rng(0).integers(0, 255, (96, 128, 3), dtype=np.uint8)


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    made = EposNetwork(NetworkConfig(), (16, 8)).eval()
    torch.nn.init.normal_(made.fragment_heads[0].weight, std=0.1)
    return made


class LargestTensor(TorchDispatchMode):
    """Notes the elements of the largest tensor that any operation gives."""

    elements = 0

    def __torch_dispatch__(self, function, types, args=(), kwargs=None):
        result = function(*args, **(kwargs or {}))
        for tensor in result if isinstance(result, tuple | list) else [result]:
            if isinstance(tensor, torch.Tensor):
                self.elements = max(self.elements, tensor.numel())
        return result


def test_thesis_network_has_its_shapes():
    network = EposNetwork(NetworkConfig("xception65", norm="batch"), [64] * 30).eval()
    assert network.output_channels == 4 * 30 * 64 + 30 + 1
    with torch.inference_mode():
        features = network.backbone(torch.zeros(1, 3, 64, 96))
        assert features.low.shape == (1, 256, 16, 24)
        assert features.high.shape == (1, 2048, 8, 12)
        assert network.features(torch.zeros(1, 64, 96, 3, dtype=torch.uint8)).shape == (1, 16, 24, 256)
    rates = [layer.dilation[0] for layer in network.pyramid.modules() if isinstance(layer, torch.nn.Conv2d)]
    assert set(rates) == {1, 12, 24, 36}


@pytest.mark.parametrize("norm", ["group", "batch"])
def test_light_network_trains(norm):
    network = EposNetwork(NetworkConfig(norm=norm), (4, 4))
    network.features(torch.zeros(2, 32, 40, 3, dtype=torch.uint8)).sum().backward()
    unused = [name for name, p in network.named_parameters() if p.grad is None and "head" not in name]
    assert not unused


@pytest.mark.parametrize(("height", "width"), [(96, 128), (45, 67), (8, 8), (15, 9)])
def test_output_is_at_the_whole_cells(network, height, width):
    seen = see(network, RGB[:height, :width])
    assert seen.object_probability.shape == (height // 4, width // 4, 3)
    np.testing.assert_allclose(seen.object_probability.sum(axis=-1), 1, atol=1e-5)


def test_output_where_it_counts_is_the_dense_output(network):
    seen = see(network, RGB)
    threshold = float(np.median(seen.object_probability[..., 1]))
    sparse = seen.about(0, 7, threshold)
    with torch.inference_mode():
        dense = network.fragment_heads[0](seen.features)
        probability = dense[..., :16].softmax(dim=-1).numpy()
        coordinates = dense[..., 16:].unflatten(-1, (16, 3)).numpy()
    rows, columns = np.nonzero(seen.object_probability[..., 1] > threshold)
    assert 0 < len(rows) < 24 * 32
    np.testing.assert_array_equal(sparse.cells, np.stack([columns, rows], axis=1))
    np.testing.assert_allclose(sparse.fragment_probability, probability[rows, columns], atol=1e-6)
    np.testing.assert_allclose(sparse.coordinates, coordinates[rows, columns], atol=1e-5)
    assert (sparse.obj_id, sparse.grid) == (7, (24, 32))


def test_memory_of_heads_is_bounded_in_use_and_training():
    network = EposNetwork(NetworkConfig(), [64] * 30).eval()
    features = torch.randn(1, 40, 60, 128)
    objects = torch.zeros(1, 40, 60, dtype=torch.int64)
    objects[0, :10, :10], objects[0, 20:30, :20] = 3, 9
    targets = TargetTensors(objects, torch.zeros_like(objects), torch.zeros(1, 40, 60, 3))
    dense = 40 * 60 * 30 * 64 * 4
    with LargestTensor() as largest:
        epos_loss(network, features, targets, LossConfig()).total.backward()
    assert largest.elements == features.numel() < dense / 50  # at most the features themselves
    probability = np.full((40, 60, 31), 1 / 31, np.float32)
    seen = SeenImage(network, features[0], probability, 0)
    with LargestTensor() as largest:
        for position in range(30):
            seen.about(position, position, 0.0)  # the worst: every object everywhere
    assert largest.elements <= 40 * 60 * 4 * 64 == dense / 30


def test_reduced_precision_is_close(network):
    exact, rough = see(network, RGB), see(network, RGB, "bfloat16")
    np.testing.assert_allclose(rough.object_probability, exact.object_probability, atol=0.05)
    assert rough.object_probability.dtype == np.float32


def test_image_smaller_than_the_stride_is_refused(network):
    with pytest.raises(InputError, match=r"image of 5 x 96 pixels: smaller than the network's stride of 8 px") as error:
        see(network, RGB[:, :5])
    assert "\n" not in str(error.value)


def test_output_that_is_not_finite_is_left_out_or_refused(network):
    seen = see(network, RGB)
    broken = seen.features.clone()
    broken[0, 0] = torch.nan
    partly = SeenImage(network, broken, seen.object_probability, 0).about(0, 1, 0.0)
    assert len(partly.cells) == 24 * 32 - 1
    assert not (partly.cells == 0).all(axis=1).any()
    torch.manual_seed(0)
    diverged = EposNetwork(NetworkConfig(), (4,)).eval()
    torch.nn.init.constant_(diverged.object_head.bias, torch.nan)
    with pytest.raises(InputError, match="no output of the network is a finite number"):
        see(diverged, RGB)


def test_frozen_flows_stay_as_they_are():
    network = EposNetwork(NetworkConfig(norm="batch"), (4,))
    network.freeze(("early",))
    before = {name: tensor.clone() for name, tensor in network.state_dict().items()}
    network.train()
    network.features(torch.from_numpy(RGB[None, :64, :64])).sum().backward()
    assert not any(p.requires_grad for p in network.backbone.early.parameters())
    assert all(p.grad is not None for p in network.backbone.middle.parameters())
    moved = {name for name, tensor in network.state_dict().items() if not torch.equal(tensor, before[name])}
    assert any(name.startswith("backbone.middle") for name in moved)  # running statistics
    assert not any(name.startswith("backbone.early") for name in moved)


def test_bad_settings_are_named():
    with pytest.raises(InputError, match=r"atrous_rates are \(12, 0, 36\); expected three numbers from 1 on"):
        NetworkConfig(atrous_rates=(12, 0, 36))
    with pytest.raises(InputError, match=r"dropout is 1.0; expected 0 to less than 1"):
        NetworkConfig(dropout=1.0)
    if not torch.cuda.is_available():
        with pytest.raises(InputError, match="no CUDA device"):
            chosen_device("cuda")
