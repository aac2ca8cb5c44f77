"""What the network says about an image: objects at each cell, fragments only at cells where an object is likely.

An object is asked about at a time, so that what is held at once is k x 4n numbers, k being the cells where it is likely;
never all 4mn channels of all cells.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
import torch
from jaxtyping import Float, Float32, Int, UInt8
from torch import Tensor

from pipeline.epos.config import Precision
from pipeline.epos.networks.network import STRIDE, EposNetwork
from pipeline.exceptions import InputError


@dataclass(frozen=True, eq=False)
class ObjectPrediction:
    """What the network says about one object, at the k cells where it is likely."""

    obj_id: int
    grid: tuple[int, int]
    """Rows and columns of cells of the image."""
    cells: Int[np.ndarray, "k 2"]
    """(column, row), row by row."""
    object_probability: Float32[np.ndarray, "k"]
    """a_o."""
    fragment_probability: Float32[np.ndarray, "k n"]
    """b_of."""
    coordinates: Float32[np.ndarray, "k n 3"]
    """r_of, 3D fragment coordinates."""


@runtime_checkable
class Seen(Protocol):
    """An image in the eyes of whoever knows the objects."""

    @property
    def object_probability(self) -> Float32[np.ndarray, "h w m"]:
        """a: background, then the objects in the order in which they are known."""
        ...

    @property
    def damaged_cells(self) -> int:
        """Cells about which nothing finite was said; they count as background."""
        ...

    def about(self, position: int, obj_id: int, min_probability: float) -> ObjectPrediction:
        """Fragments of the object at a position, at cells with a_o > `min_probability` (tau_a)."""
        ...


@dataclass(frozen=True, eq=False)
class SeenImage:
    """The image in the network's eyes; see `Seen`."""

    network: EposNetwork
    features: Float[Tensor, "h w d"]
    """Of each cell, where the network is."""
    object_probability: Float32[np.ndarray, "h w m"]
    damaged_cells: int

    @torch.inference_mode()
    def about(self, position: int, obj_id: int, min_probability: float) -> ObjectPrediction:
        """See `Seen`; cells where the output is not finite are left out."""
        a = self.object_probability[..., position + 1]
        rows, columns = np.nonzero(a > min_probability)
        features = self.features[torch.from_numpy(rows), torch.from_numpy(columns)].float()
        output = self.network.fragment_output(position, features)
        probability = output.logits.softmax(dim=-1).cpu().numpy()
        coordinates = output.coordinates.cpu().numpy()
        good = np.isfinite(probability).all(axis=1) & np.isfinite(coordinates).all(axis=(1, 2))
        cells = np.stack([columns, rows], axis=1)[good]
        return ObjectPrediction(obj_id, a.shape, cells, a[rows, columns][good], probability[good], coordinates[good])


@torch.inference_mode()
def see(network: EposNetwork, rgb: UInt8[np.ndarray, "h w 3"], precision: Precision = "float32") -> SeenImage:
    """Run the network on an image, all but the heads of the fragments.

    Raises:
        InputError: the image is smaller than the network's stride, or no output is finite.

    """
    if min(rgb.shape[:2]) < STRIDE:
        raise InputError(
            f"image of {rgb.shape[1]} x {rgb.shape[0]} pixels: smaller than the network's stride of {STRIDE} px; "
            "give a larger image"
        )
    device = network.object_head.weight.device
    with reduced_precision(device, precision):
        features = network.features(torch.from_numpy(np.ascontiguousarray(rgb)[None]).to(device))[0]
    probability = network.object_logits(features.float()).softmax(dim=-1).cpu().numpy()
    damaged = ~np.isfinite(probability).all(axis=-1)
    if damaged.all():
        raise InputError(
            "EPOS: no output of the network is a finite number; train it again, or give another checkpoint"
        )
    probability[damaged] = np.eye(probability.shape[-1], dtype=np.float32)[0]
    return SeenImage(network, features, probability, int(damaged.sum()))


@contextmanager
def reduced_precision(device: torch.device, precision: Precision) -> Iterator[None]:
    """Convolutions inside are computed in this precision; float32 leaves everything as it is."""
    with torch.autocast(device.type, torch.bfloat16, enabled=precision == "bfloat16"):
        yield
