"""Parameters of EPOS at test time (thesis sec. epos_experiments, Method Parameters)."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pipeline.epos.fitting.config import FittingConfig
from pipeline.exceptions import InputError

Device = Literal["auto", "cpu", "cuda"]
Precision = Literal["float32", "bfloat16"]


@dataclass(frozen=True)
class CorrespondenceConfig:
    """Which correspondences are established (thesis sec. epos_establish_coords)."""

    min_object_probability: float = 0.1
    """tau_a: cells where an object is less likely are not looked at for it."""
    min_fragment_probability: float = 0.5
    """tau_b: relative to the most likely fragment of the cell."""
    regression: bool = True
    """Points predicted on the fragments; False for the fragments' centres, as in the thesis's ablation."""

    def __post_init__(self) -> None:
        for name in ("min_object_probability", "min_fragment_probability"):
            if not 0.0 <= getattr(self, name) < 1.0:
                raise InputError(f"EPOS: {name} is {getattr(self, name)}; expected 0 to less than 1")


@dataclass(frozen=True)
class EposSettings:
    """Find known objects in colour images by EPOS: surface fragments, correspondences, robust fitting."""

    checkpoint: Path | None = None
    """File of the network, as training writes it (`network.pt`); by default the one that comes with the program."""
    objects: tuple[int, ...] = ()
    """Only these objects; by default all that are looked for."""
    correspondences: CorrespondenceConfig = field(default_factory=CorrespondenceConfig)
    fitting: FittingConfig = field(default_factory=FittingConfig)
    count_instances: bool = False
    """Find out how many instances there are (6D detection) in place of looking for as many as the targets say."""
    device: Device = "auto"
    """Where the network runs; auto: CUDA where there is one."""
    precision: Precision = "float32"
    """Of the network's convolutions."""
    seed: int = 0
    """Of the search for poses."""
