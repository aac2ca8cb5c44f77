"""What a network looks like."""

from dataclasses import dataclass
from typing import Literal, get_args

from pipeline.exceptions import InputError

Backbone = Literal["light", "xception65"]
Norm = Literal["group", "batch"]

_CHOICES = {"backbone": get_args(Backbone), "norm": get_args(Norm)}


@dataclass(frozen=True)
class NetworkConfig:
    """Architecture (thesis sec. epos_experiments: DeepLabv3+ with Xception-65 at output stride 8)."""

    backbone: Backbone = "light"
    """xception65: that of the thesis, 38 million parameters. light: inverted residuals, for two CPU cores."""
    norm: Norm = "group"
    """group: the same in training and use, whatever the batch. batch: as in the thesis, for batches of 8 and more."""
    atrous_rates: tuple[int, int, int] = (12, 24, 36)
    """Rates of the spatial pyramid pooling, in steps of 8 px."""
    dropout: float = 0.1
    """Share of pyramid features dropped in training."""

    def __post_init__(self) -> None:
        for name, choices in _CHOICES.items():
            if getattr(self, name) not in choices:
                raise InputError(f"network: {name} is {getattr(self, name)!r}; available: {', '.join(choices)}")
        if len(self.atrous_rates) != 3 or min(self.atrous_rates) < 1:
            raise InputError(f"network: atrous_rates are {self.atrous_rates}; expected three numbers from 1 on")
        if not 0.0 <= self.dropout < 1.0:
            raise InputError(f"network: dropout is {self.dropout}; expected 0 to less than 1")
