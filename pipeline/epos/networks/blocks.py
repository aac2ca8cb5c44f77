"""Convolutions with normalization, as both backbones and the decoder use them."""

from typing import NamedTuple

from jaxtyping import Float
from torch import Tensor, nn

from pipeline.epos.networks.config import Norm

_GROUP_CHANNELS = 8
"""Channels that are normalized together."""


class BackboneFeatures(NamedTuple):
    """What a backbone sees in images."""

    low: Float[Tensor, "b c h w"]
    """At a quarter of the image's size, for outlines."""
    high: Float[Tensor, "b d i j"]
    """At an eighth of the image's size, for context."""


def conv(inputs: int, outputs: int, kernel: int = 1, stride: int = 1, rate: int = 1, groups: int = 1) -> nn.Conv2d:
    """A convolution that keeps the size (divided by the stride), without bias: a normalization follows."""
    padding = rate * (kernel // 2)
    return nn.Conv2d(inputs, outputs, kernel, stride, padding, rate, groups, bias=False)


def normalization(channels: int, norm: Norm) -> nn.Module:
    """Normalization of feature maps."""
    if norm == "batch":
        return nn.BatchNorm2d(channels)
    return nn.GroupNorm(max(channels // _GROUP_CHANNELS, 1), channels)


def conv_norm_relu(inputs: int, outputs: int, norm: Norm, kernel: int = 1, stride: int = 1) -> nn.Sequential:
    """Dense convolution, normalization, ReLU."""
    return nn.Sequential(conv(inputs, outputs, kernel, stride), normalization(outputs, norm), nn.ReLU(inplace=True))


def separable(
    inputs: int, outputs: int, norm: Norm, *, stride: int = 1, rate: int = 1, relu: bool = True
) -> nn.Sequential:
    """Depthwise 3x3 and pointwise convolution, each normalized; with ReLU after each, or with none."""
    layers: list[nn.Module] = []
    for layer, channels in ((conv(inputs, inputs, 3, stride, rate, inputs), inputs), (conv(inputs, outputs), outputs)):
        layers += [layer, normalization(channels, norm)]
        if relu:
            layers.append(nn.ReLU(inplace=True))
    return nn.Sequential(*layers)
