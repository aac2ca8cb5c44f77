"""Spatial pyramid pooling and the decoder of DeepLabv3+."""

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn.functional import interpolate

from pipeline.epos.networks.blocks import BackboneFeatures, conv_norm_relu, separable
from pipeline.epos.networks.config import NetworkConfig


class Pyramid(nn.Module):
    """Context at several ranges: a point, three atrous rates, and the whole image."""

    def __init__(self, inputs: int, outputs: int, config: NetworkConfig) -> None:
        super().__init__()
        norm = config.norm
        self.point = conv_norm_relu(inputs, outputs, norm)
        self.atrous = nn.ModuleList(separable(inputs, outputs, norm, rate=rate) for rate in config.atrous_rates)
        # A single value per channel and image has no statistics to be normalized with.
        self.whole = nn.Sequential(nn.AdaptiveAvgPool2d(1), nn.Conv2d(inputs, outputs, 1), nn.ReLU())
        self.joined = nn.Sequential(conv_norm_relu(5 * outputs, outputs, norm), nn.Dropout(config.dropout))

    def forward(self, high: Float[Tensor, "b c h w"]) -> Float[Tensor, "b d h w"]:
        """Features of the same size."""
        branches = [self.point(high), *(branch(high) for branch in self.atrous)]
        branches.append(self.whole(high).expand_as(branches[0]))
        return self.joined(torch.cat(branches, dim=1))


class Decoder(nn.Module):
    """Doubles the resolution by bilinear interpolation and joins the features of outlines."""

    def __init__(self, low_inputs: int, low_projection: int, inputs: int, outputs: int, config: NetworkConfig) -> None:
        super().__init__()
        self.low = conv_norm_relu(low_inputs, low_projection, config.norm)
        self.joined = nn.Sequential(
            separable(inputs + low_projection, outputs, config.norm),
            separable(outputs, outputs, config.norm),
        )

    def forward(self, context: Float[Tensor, "b c i j"], features: BackboneFeatures) -> Float[Tensor, "b d h w"]:
        """Features at each cell."""
        size = features.low.shape[-2:]
        doubled = interpolate(context, size=size, mode="bilinear", align_corners=False)
        return self.joined(torch.cat([doubled, self.low(features.low)], dim=1))
