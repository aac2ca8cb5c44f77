"""Xception-65 as DeepLabv3+ modified it, with output stride 8 (thesis sec. epos_experiments, Optimization).

Where the stride would exceed 8 the convolutions that follow are atrous instead.
"""

from typing import ClassVar, Literal

from jaxtyping import Float
from torch import Tensor, nn

from pipeline.epos.networks.blocks import BackboneFeatures, conv, conv_norm_relu, normalization, separable
from pipeline.epos.networks.config import Norm

Skip = Literal["conv", "sum", "none"]


class XceptionModule(nn.Module):
    """Three separable convolutions with a way around them."""

    def __init__(
        self, channels: tuple[int, int, int, int], norm: Norm, *, skip: Skip, stride: int = 1, rate: int = 1
    ) -> None:
        """Make the module.

        Args:
            channels: of the input and after each convolution.
            norm: kind of normalization.
            skip: what is added: a strided 1x1 convolution of the input, the input, or nothing. With nothing, ReLUs
                stand inside the separable convolutions, else before each.
            stride: of the last convolution.
            rate: of all convolutions.

        """
        super().__init__()
        self.skip_kind = skip
        inside = skip == "none"
        strides = (1, 1, stride)
        pairs = zip(channels, channels[1:], strides, strict=False)
        self.separables = nn.ModuleList(
            nn.Sequential(
                nn.Identity() if inside else nn.ReLU(),  # not in place: the input is needed again
                separable(inputs, outputs, norm, stride=step, rate=rate, relu=inside),
            )
            for inputs, outputs, step in pairs
        )
        self.skip: nn.Module = nn.Identity()
        if skip == "conv":
            self.skip = nn.Sequential(conv(channels[0], channels[3], 1, stride), normalization(channels[3], norm))

    def stages(self, x: Float[Tensor, "b c h w"]) -> tuple[Tensor, Tensor]:
        """Output, and what the second convolution gave: the last features before the stride."""
        second = self.separables[1](self.separables[0](x))
        y = self.separables[2](second)
        return (y if self.skip_kind == "none" else y + self.skip(x)), second

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b d i j"]:
        """Features at the size divided by the stride."""
        return self.stages(x)[0]


class EarlyFlow(nn.Module):
    """Entry flow: down to stride 8."""

    def __init__(self, norm: Norm) -> None:
        super().__init__()
        self.root = nn.Sequential(
            conv_norm_relu(3, 32, norm, kernel=3, stride=2),
            conv(32, 64, 3),
            normalization(64, norm),
            nn.ReLU(),
        )
        self.first = XceptionModule((64, 128, 128, 128), norm, skip="conv", stride=2)
        self.second = XceptionModule((128, 256, 256, 256), norm, skip="conv", stride=2)
        self.third = XceptionModule((256, 728, 728, 728), norm, skip="conv")  # its stride of 2 becomes a rate

    def forward(self, images: Float[Tensor, "b 3 h w"]) -> BackboneFeatures:
        """Features at strides 4 and 8."""
        second, low = self.second.stages(self.first(self.root(images)))
        return BackboneFeatures(low, self.third(second))


class Xception65(nn.Module):
    """Entry flow, 16 modules of the middle flow, exit flow."""

    low_channels = 256
    high_channels = 2048
    pyramid_channels = 256
    decoder_channels = 256
    low_projection = 48
    flows: ClassVar = ("early", "middle")
    """Names of the parts that can be frozen, in order."""

    def __init__(self, norm: Norm) -> None:
        super().__init__()
        self.early = EarlyFlow(norm)
        self.middle = nn.Sequential(
            *(XceptionModule((728, 728, 728, 728), norm, skip="sum", rate=2) for _ in range(16))
        )
        self.exit = nn.Sequential(
            XceptionModule((728, 728, 1024, 1024), norm, skip="conv", rate=2),  # its stride of 2 becomes a rate
            XceptionModule((1024, 1536, 1536, 2048), norm, skip="none", rate=4),
        )

    def forward(self, images: Float[Tensor, "b 3 h w"]) -> BackboneFeatures:
        """Features of images whose sides are multiples of 8."""
        early = self.early(images)
        return BackboneFeatures(early.low, self.exit(self.middle(early.high)))
