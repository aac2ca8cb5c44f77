"""The loss against a slow reference, term by term as in the thesis."""

import numpy as np
import pytest
import torch

from pipeline.epos.networks.config import NetworkConfig
from pipeline.epos.networks.network import EposNetwork
from pipeline.epos.training.config import LossConfig
from pipeline.epos.training.loss import TargetTensors, epos_loss
from pipeline.exceptions import InputError

COUNTS = (5, 3, 4)


@pytest.fixture(scope="module")
def case():
    torch.manual_seed(0)
    network = EposNetwork(NetworkConfig(), COUNTS)
    for head in network.fragment_heads:
        torch.nn.init.normal_(head.weight, std=0.3)
    generator = torch.Generator().manual_seed(1)
    features = torch.randn(2, 3, 4, 128, generator=generator)
    objects = torch.randint(0, 3, (2, 3, 4), generator=generator)  # the third object is nowhere
    fragments = torch.randint(0, 3, (2, 3, 4), generator=generator) * (objects > 0)
    coordinates = torch.randn(2, 3, 4, 3, generator=generator) * (objects > 0)[..., None]
    return network, features, TargetTensors(objects, fragments, coordinates)


def slow_loss(network, features, targets, config):
    def cross_entropy(logits, label):
        return -(logits[label] - np.log(np.exp(logits).sum()))

    terms = np.zeros(3)
    for index in np.ndindex(*targets.objects.shape):
        x = features[index]
        label = int(targets.objects[index])
        terms[0] += cross_entropy(network.object_head(x).detach().double().numpy(), label)
        if label == 0:
            continue
        n = COUNTS[label - 1]
        output = network.fragment_heads[label - 1](x).detach().double().numpy()
        fragment = int(targets.fragments[index])
        terms[1] += cross_entropy(output[:n], fragment)
        error = output[n:].reshape(n, 3)[fragment] - targets.coordinates[index].double().numpy()
        delta = config.huber_delta
        for e in np.abs(error):
            terms[2] += 0.5 * e**2 if e <= delta else delta * (e - 0.5 * delta)
    terms /= targets.objects.numel()
    return terms * [1, config.fragment_weight, config.coordinate_weight]


@pytest.mark.parametrize("config", [LossConfig(), LossConfig(0.5, 3.0, 0.2)])
def test_loss_is_that_of_the_thesis(case, config):
    loss = epos_loss(*case, config)
    expected = slow_loss(*case, config)
    found = torch.stack([loss.objects, loss.fragments, loss.coordinates]).detach().numpy()
    np.testing.assert_allclose(found, expected, rtol=1e-5)
    assert loss.total.item() == pytest.approx(expected.sum(), rel=1e-5)


def test_heads_of_absent_objects_are_not_evaluated(case):
    network, features, targets = case
    network.zero_grad(set_to_none=True)
    epos_loss(network, features, targets, LossConfig()).total.backward()
    assert network.fragment_heads[0].weight.grad is not None
    assert network.fragment_heads[2].weight.grad is None


def test_background_alone_has_a_loss(case):
    network, features, targets = case
    nothing = TargetTensors(*(torch.zeros_like(tensor) for tensor in targets))
    loss = epos_loss(network, features, nothing, LossConfig())
    assert loss.total == loss.objects > 0


def test_bad_weights_are_refused():
    with pytest.raises(InputError, match="coordinate_weight is -1"):
        LossConfig(coordinate_weight=-1)
    with pytest.raises(InputError, match="huber_delta is 0"):
        LossConfig(huber_delta=0)
