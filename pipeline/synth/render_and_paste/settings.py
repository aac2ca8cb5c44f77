"""What images are made of: how many objects, where, in what light, before what, and how they are changed at last."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, Protocol, runtime_checkable

from pipeline.exceptions import InputError
from pipeline.synth.augmentation import Augmentation
from pipeline.synth.render_and_paste.lights import LightRanges

Range = tuple[float, float]


class PasteSettingsError(InputError):
    """A setting that no image can be made with."""


@runtime_checkable
class ViewRanges(Protocol):
    """Ranges that views of an object are drawn from, uniformly, such as `pipeline.synth.cameras.CameraRanges`."""

    @property
    def azimuth_deg(self) -> Range:
        """Of the direction from the object to the camera, about the model's z axis."""
        ...

    @property
    def elevation_deg(self) -> Range:
        """Of the direction from the object to the camera, above the model's xy plane."""
        ...

    @property
    def distance(self) -> Range:
        """From the middle of the object to the camera, metres."""
        ...

    @property
    def roll_deg(self) -> Range:
        """In-plane rotation."""
        ...


@dataclass(frozen=True)
class PasteSettings:
    """How images are made; the same settings and generator state make the same image."""

    objects: tuple[int, int] = (4, 12)
    """Objects in an image, drawn uniformly; models may repeat. Not used where poses are given."""
    views: ViewRanges | None = None
    """From where objects are seen; None turns them uniformly, at distances that make them as large as `size` says."""
    size: Range = (0.12, 0.55)
    """How large the diameter of an object is seen, drawn log-uniformly: as a share of the image's shorter side.

    Not used with `views`.
    """
    truncated: float = 0.15
    """Share of objects that reach beyond the image, by up to half; the others are whole in it, if they fit."""
    min_visible: float = 0.2
    """An object of which others leave less to see is left out, unless too few objects would remain."""
    backgrounds: Path | None = None
    """Folder of photographs, searched with its subfolders; None makes up backgrounds."""
    crop: Literal["random", "center"] = "random"
    """Which part of a photograph is taken, scaled so that it just covers the image."""
    repaint: Literal["none", "uncolored", "all"] = "none"
    """Which models get a random plain colour: none, those without vertex colours and texture, or all."""
    lights: LightRanges = field(default_factory=LightRanges)
    edge_blur: float = 0.6
    """Standard deviation, pixels, of the blur along outlines that stands for the smooth edges of photographs.

    It changes pixels that touch an outline only; 0 gives images whose every pixel shows exactly one thing.
    """
    augmentation: Augmentation | None = field(default_factory=Augmentation)

    def __post_init__(self) -> None:
        low, high = self.objects
        if not 0 <= low <= high:
            raise PasteSettingsError(f"objects from {low} to {high}; give two numbers from 0 on, low before high")
        small, large = self.size
        if not 0.0 < small <= large < float("inf"):
            raise PasteSettingsError(f"size from {small} to {large}; give shares above 0, low before high")
        for name in ("truncated", "min_visible"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise PasteSettingsError(f"{name} {getattr(self, name)} is outside 0..1; give a share")
        if not 0.0 <= self.edge_blur <= 5.0:
            raise PasteSettingsError(f"edge_blur {self.edge_blur} is outside 0..5 pixels; 0 leaves edges hard")
