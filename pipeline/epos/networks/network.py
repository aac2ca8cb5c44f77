"""The network of EPOS: features at each cell, and heads for objects, fragments and 3D fragment coordinates."""

from collections.abc import Sequence
from typing import NamedTuple

import torch
from jaxtyping import Float, UInt8
from torch import Tensor, nn
from torch.nn.functional import pad

from pipeline.epos.grid import grid_shape
from pipeline.epos.networks.config import NetworkConfig
from pipeline.epos.networks.decoder import Decoder, Pyramid
from pipeline.epos.networks.light import LightBackbone
from pipeline.epos.networks.xception import Xception65
from pipeline.exceptions import InputError

STRIDE = 8
"""Sides of what the backbone is given are multiples of this."""

_BACKBONES = {"light": LightBackbone, "xception65": Xception65}


class FragmentOutput(NamedTuple):
    """What the network says about the fragments of one object at k cells."""

    logits: Float[Tensor, "k n"]
    """Softmax of these is b."""
    coordinates: Float[Tensor, "k n 3"]
    """3D fragment coordinates r."""


class EposNetwork(nn.Module):
    """Predicts a, b and r (thesis sec. epos_coord_pred): 4n channels per object, and m + 1.

    The heads are linear functions of the features at a cell, so they are evaluated only at the cells, and for the
    objects, where they count.
    """

    def __init__(self, config: NetworkConfig, fragment_counts: Sequence[int]) -> None:
        """Make a network with random weights for objects with so many fragments."""
        super().__init__()
        self._frozen: tuple[nn.Module, ...] = ()
        self.config = config
        self.fragment_counts = tuple(fragment_counts)
        self.backbone = _BACKBONES[config.backbone](config.norm)
        kind = self.backbone
        channels = kind.decoder_channels
        self.pyramid = Pyramid(kind.high_channels, kind.pyramid_channels, config)
        self.decoder = Decoder(kind.low_channels, kind.low_projection, kind.pyramid_channels, channels, config)
        self.object_head = nn.Linear(channels, len(self.fragment_counts) + 1)
        self.fragment_heads = nn.ModuleList(_fragment_head(channels, count) for count in self.fragment_counts)

    @property
    def output_channels(self) -> int:
        """4mn + m + 1, for objects with equally many fragments."""
        return 4 * sum(self.fragment_counts) + len(self.fragment_counts) + 1

    def features(self, images: UInt8[Tensor, "b h w 3"]) -> Float[Tensor, "b i j d"]:
        """Features at each whole cell of RGB images."""
        height, width = images.shape[1:3]
        seen = images.permute(0, 3, 1, 2).float() / 127.5 - 1.0
        seen = pad(seen, (0, -width % STRIDE, 0, -height % STRIDE), mode="replicate")
        features = self.backbone(seen)
        rows, columns = grid_shape(height, width)
        return self.decoder(self.pyramid(features.high), features)[:, :, :rows, :columns].permute(0, 2, 3, 1)

    def object_logits(self, features: Float[Tensor, "*k d"]) -> Float[Tensor, "*k m"]:
        """Softmax of these is a: background, then the objects."""
        return self.object_head(features).float()

    def fragment_output(self, position: int, features: Float[Tensor, "k d"]) -> FragmentOutput:
        """Fragments of the object at a position in the list, for the features of some cells."""
        count = self.fragment_counts[position]
        outputs = self.fragment_heads[position](features).float()
        return FragmentOutput(outputs[:, :count], outputs[:, count:].reshape(len(features), count, 3))

    def move(self, device: torch.device | str) -> "EposNetwork":
        """Go to a device, with weights laid out as images are: two thirds of the time on a CPU, and for tensor cores."""
        for parameter in self.to(device).parameters():
            if parameter.ndim == 4:
                parameter.data = parameter.data.contiguous(memory_format=torch.channels_last)
        return self

    def freeze(self, flows: Sequence[str]) -> None:
        """Leave parts of the backbone as they are: "early", "middle" (thesis sec. epos_experiments, Optimization)."""
        self._frozen = tuple(getattr(self.backbone, name) for name in flows)
        for flow in self._frozen:
            flow.requires_grad_(False)
        self.train(self.training)

    def train(self, mode: bool = True) -> "EposNetwork":
        """As for any module, but what is frozen also keeps its statistics of batch normalization."""
        super().train(mode)
        for flow in self._frozen:
            flow.eval()
        return self


def _fragment_head(channels: int, count: int) -> nn.Linear:
    """One row per b, three per r; these begin at 0, the fragments' centres, for lambda_2 makes large errors loud."""
    head = nn.Linear(channels, 4 * count)
    nn.init.zeros_(head.weight[count:])
    nn.init.zeros_(head.bias[count:])
    return head


def chosen_device(name: str) -> torch.device:
    """The device of a name; auto: CUDA where there is one."""
    if name == "cuda" and not torch.cuda.is_available():
        raise InputError("device cuda: there is no CUDA device, or torch was built without CUDA; give cpu or auto")
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    return torch.device(name)
