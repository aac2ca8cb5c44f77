"""What a person has chosen to see of HashMatch; a part of the selection, so it stands in the address."""

from dataclasses import dataclass
from typing import Literal

Stage = Literal["off", "windows", "objectness", "hashing", "verification", "nms"]

NO_PIXEL = (-1.0, -1.0)


@dataclass(frozen=True)
class HashMatchChoice:
    """Which stage of the cascade is drawn, at which level of the pyramid, and which window is looked into."""

    stage: Stage = "off"
    """Whose heatmap of candidates is drawn over the image."""
    level: int | None = None
    """Level of the pyramid; None for the sum over all."""
    pixel: tuple[float, float] = NO_PIXEL
    """Centre of the window that was clicked (u, v), pixels of the image; NO_PIXEL for none."""
