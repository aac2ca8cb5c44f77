"""What to train on, and how."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pipeline.epos.config import Device, Precision
from pipeline.epos.fragments import DEFAULT_COUNT
from pipeline.epos.networks.config import NetworkConfig
from pipeline.exceptions import InputError


@dataclass(frozen=True)
class PastedConfig:
    """Training images made on the fly: objects in uniformly random poses over backgrounds (render & paste)."""

    objects: tuple[int, int] = (4, 12)
    """Objects in an image."""
    size: tuple[float, float] = (0.12, 0.55)
    """Diameter of an object as a share of the image's shorter side, drawn log-uniformly."""
    backgrounds: Path | None = None
    """Folder of photographs; None makes up backgrounds."""


@dataclass(frozen=True)
class OptimizationConfig:
    """How the weights are found (AdamW; the rate falls to 0 as (1 - step / steps)^0.9, after a warm-up)."""

    learning_rate: float = 1e-3
    """Highest rate. The thesis has 1e-4, for a network that was trained on other images before."""
    warm_up_steps: int = 200
    """Steps in which the rate grows to that."""
    weight_decay: float = 1e-4
    max_gradient_norm: float = 10.0
    """Longer gradients are shortened to this."""


@dataclass(frozen=True)
class LossConfig:
    """Weights of the terms."""

    fragment_weight: float = 1.0
    """lambda_1."""
    coordinate_weight: float = 100.0
    """lambda_2."""
    huber_delta: float = 1.0
    """Error of a coordinate, in sizes of its fragment, from which its loss is linear. The thesis states none."""

    def __post_init__(self) -> None:
        for name in ("fragment_weight", "coordinate_weight"):
            if not 0.0 <= getattr(self, name) < float("inf"):
                raise InputError(f"loss: {name} is {getattr(self, name)}; expected a number from 0")
        if not 0.0 < self.huber_delta < float("inf"):
            raise InputError(f"loss: huber_delta is {self.huber_delta}; expected a number above 0")


@dataclass(frozen=True)
class TrainConfig:
    """Train the network of EPOS on the objects of a dataset."""

    dataset: Path
    """Folder of a BOP dataset: its models, its camera, and images of its training split if there is one."""
    out: Path
    """Folder for the network, what it takes to go on, and recordings; training again goes on where it stopped."""
    split: str | None = None
    """Split with training images; by default the first train*. A split for tests is never trained on unasked."""
    objects: tuple[int, ...] = ()
    """Ids of the objects to learn; all by default."""
    fragments: int = DEFAULT_COUNT
    """n, fragments of an object..."""
    fragments_of: Mapping[int, int] = field(default_factory=dict)
    """... and of single objects, by id."""
    pasted_share: float = 1.0
    """Share of training images that are made on the fly; the others are taken from the split."""
    pasted: PastedConfig = field(default_factory=PastedConfig)
    network: NetworkConfig = field(default_factory=NetworkConfig)
    loss: LossConfig = field(default_factory=LossConfig)
    optimization: OptimizationConfig = field(default_factory=OptimizationConfig)
    augment: bool = True
    """Change brightness, contrast, hue and saturation at random, add noise and blur."""
    crop: tuple[int, int] = (320, 240)
    """Width and height of the windows, cut from training images, that the network is shown, pixels."""
    batch: int = 4
    """Windows in a step. The thesis has 1 (whole images)."""
    windows: int = 1
    """Windows that are cut from one training image; to make an image takes about ten times as long as a window of it."""
    steps: int = 20_000
    """Steps in all; the thesis has 2 million."""
    freeze: tuple[Literal["early", "middle"], ...] = ()
    """Flows of the backbone that stay as they are; makes sense with `start_from`."""
    start_from: Path | None = None
    """A network of the same architecture whose backbone and decoder are taken to start with."""
    seed: int = 0
    """Of the first weights and of the images."""
    device: Device = "auto"
    """auto: CUDA where there is one."""
    precision: Precision = "float32"
    """Of the convolutions; bfloat16 is about twice as fast on a recent GPU."""
    workers: int = 1
    """Processes that make images; 0 makes them between the steps. The images are the same for any number."""
    checkpoint_every: int = 500
    """Steps after which it is all written to disk."""
    record_every: int = 1000
    """Steps after which losses and predictions for sample images are recorded."""
    sample_images: int = 2
    """Images of the dataset that predictions are recorded for; they are only looked at."""

    def __post_init__(self) -> None:
        positive = ("batch", "steps", "windows", "checkpoint_every", "record_every", "fragments")
        for name in positive:
            if getattr(self, name) < 1:
                raise InputError(f"training: {name} is {getattr(self, name)}; expected 1 or more")
        for name in ("workers", "sample_images", "seed"):
            if getattr(self, name) < 0:
                raise InputError(f"training: {name} is {getattr(self, name)}; expected 0 or more")
        if not 0.0 <= self.pasted_share <= 1.0:
            raise InputError(f"training: pasted_share is {self.pasted_share}; expected 0 to 1")
        if min(self.crop) < 32:
            raise InputError(f"training: crop is {self.crop[0]} x {self.crop[1]} pixels; expected 32 or more a side")

    @property
    def remembered(self) -> dict[str, object]:
        """What must be the same when training goes on: all but where it runs and how often it writes."""
        free = ("out", "workers", "checkpoint_every", "record_every", "sample_images", "device")
        return {name: value for name, value in vars(self).items() if name not in free}
