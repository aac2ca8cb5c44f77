"""What a person has chosen to see of EPOS; a part of the selection, so it stands in the address."""

from dataclasses import dataclass, replace
from typing import Literal

EposLayer = Literal["off", "object", "objects", "fragments", "coordinates", "points", "confidence"]
EposLinks = Literal["off", "inliers", "outliers", "all"]
EposLinkColor = Literal["residual", "confidence"]

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
    links: EposLinks = "off"
    """Which correspondences are drawn."""
    color: EposLinkColor = "residual"
    """What the colours of correspondences say."""
    tau_a: float | None = None
    """Probability of the object that a cell needs; None for that of the run."""
    tau_b: float | None = None
    """Probability of a fragment, relative to the likeliest of the cell; None for that of the run."""
    tau_r: float | None = None
    """Re-projection error of an inlier, pixels; None for that of the run."""
    hypothesis: int | None = None
    """Hypothesis of the search that is shown, from 0; None for the estimate of the row."""

    @property
    def has_pixel(self) -> bool:
        """Whether a pixel of the image was clicked."""
        return self.pixel != NO_PIXEL

    @property
    def drawn(self) -> bool:
        """Whether anything of EPOS is drawn, so that the picture takes clicks."""
        pointed_at = self.has_pixel or self.fragment is not None or self.hypothesis is not None
        return self.layer != "off" or self.links != "off" or pointed_at

    def elsewhere(self, same_image: bool) -> "EposChoice":
        """What stays of the choice for another row: a pixel means something only in its image."""
        return replace(self, fragment=None, hypothesis=None, pixel=self.pixel if same_image else NO_PIXEL)
