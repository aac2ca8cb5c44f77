"""A backbone of inverted residuals (as in MobileNetV2) with output stride 8, small enough for two CPU cores."""

from typing import ClassVar

from jaxtyping import Float
from torch import Tensor, nn

from pipeline.epos.networks.blocks import BackboneFeatures, conv, conv_norm_relu, normalization
from pipeline.epos.networks.config import Norm


class InvertedResidual(nn.Module):
    """Widen, look about depthwise, narrow; the input is added where the shape stays."""

    def __init__(
        self, inputs: int, outputs: int, norm: Norm, *, stride: int = 1, rate: int = 1, widen: int = 4
    ) -> None:
        super().__init__()
        wide = widen * inputs
        self.added = stride == 1 and inputs == outputs
        self.layers = nn.Sequential(
            conv_norm_relu(inputs, wide, norm),
            conv(wide, wide, 3, stride, rate, wide),
            normalization(wide, norm),
            nn.ReLU(inplace=True),
            conv(wide, outputs),
            normalization(outputs, norm),
        )

    def forward(self, x: Float[Tensor, "b c h w"]) -> Float[Tensor, "b d i j"]:
        """Features at the size divided by the stride."""
        return x + self.layers(x) if self.added else self.layers(x)


class LightBackbone(nn.Module):
    """Three flows, named as those of Xception so that they can be frozen alike."""

    low_channels = 32
    high_channels = 160
    pyramid_channels = 128
    decoder_channels = 128
    low_projection = 32
    flows: ClassVar = ("early", "middle")
    """Names of the parts that can be frozen, in order."""

    def __init__(self, norm: Norm) -> None:
        super().__init__()
        self.early = nn.Sequential(
            conv_norm_relu(3, 24, norm, kernel=3, stride=2),
            InvertedResidual(24, 32, norm, stride=2, widen=3),
            InvertedResidual(32, 32, norm, widen=3),
        )
        self.middle = nn.Sequential(
            InvertedResidual(32, 64, norm, stride=2),
            *(InvertedResidual(64, 64, norm) for _ in range(2)),
            InvertedResidual(64, 96, norm),
            *(InvertedResidual(96, 96, norm, rate=2) for _ in range(3)),
        )
        self.exit = nn.Sequential(
            InvertedResidual(96, 160, norm, rate=2),
            *(InvertedResidual(160, 160, norm, rate=4) for _ in range(2)),
        )

    def forward(self, images: Float[Tensor, "b 3 h w"]) -> BackboneFeatures:
        """Features of images whose sides are multiples of 8."""
        low = self.early(images)
        return BackboneFeatures(low, self.exit(self.middle(low)))
