"""The loss of the thesis (sec. epos_network_training, eq. epos_loss)."""

from typing import NamedTuple

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import cross_entropy, huber_loss

from pipeline.epos.networks.network import EposNetwork
from pipeline.epos.training.config import LossConfig


class TargetTensors(NamedTuple):
    """Targets of a batch; fields as those of `Targets`."""

    objects: Int[Tensor, "b h w"]
    fragments: Int[Tensor, "b h w"]
    coordinates: Float[Tensor, "b h w 3"]


class Loss(NamedTuple):
    """The loss and its terms, each weighted and averaged over all cells."""

    total: Float[Tensor, ""]
    objects: Float[Tensor, ""]
    fragments: Float[Tensor, ""]
    coordinates: Float[Tensor, ""]


def epos_loss(
    network: EposNetwork, features: Float[Tensor, "b h w d"], targets: TargetTensors, config: LossConfig
) -> Loss:
    """Loss L, averaged over all cells of a batch.

    The fragments' head of an object is evaluated at the cells that show it, and nowhere else: elsewhere the
    ground-truth a_o is 0. H is the sum over the three coordinates.
    """
    cells = targets.objects.numel()
    objects = cross_entropy(network.object_logits(features).flatten(0, 2), targets.objects.flatten())
    fragments, coordinates = features.new_zeros((), dtype=torch.float32), features.new_zeros((), dtype=torch.float32)
    for label in torch.unique(targets.objects).tolist():
        if label == 0:
            continue
        shown = targets.objects == label
        output = network.fragment_output(label - 1, features[shown])
        truth = targets.fragments[shown]
        fragments = fragments + cross_entropy(output.logits, truth, reduction="sum")
        predicted = output.coordinates[torch.arange(len(truth), device=truth.device), truth]
        coordinates = coordinates + huber_loss(
            predicted, targets.coordinates[shown], reduction="sum", delta=config.huber_delta
        )
    fragments = config.fragment_weight * fragments / cells
    coordinates = config.coordinate_weight * coordinates / cells
    return Loss(objects + fragments + coordinates, objects, fragments, coordinates)
