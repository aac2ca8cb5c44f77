"""What a person has chosen to see of EPOS; a part of the selection, so it stands in the address."""

from dataclasses import dataclass
from typing import Literal

EposLayer = Literal["off", "objects", "fragments", "coordinates", "correspondences"]

NO_PIXEL = (-1.0, -1.0)


@dataclass(frozen=True)
class EposChoice:
    """Which quantities of EPOS are drawn, and with which thresholds."""

    layer: EposLayer = "off"
    """What is drawn over the image."""
    pixel: tuple[float, float] = NO_PIXEL
    """Pixel of the image (u, v) that was clicked; NO_PIXEL for none."""
    fragment: int | None = None
    """Fragment of the object that was chosen on the model."""
