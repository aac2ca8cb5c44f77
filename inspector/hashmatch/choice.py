"""What a person has chosen to see of HashMatch; a part of the selection, so it stands in the address."""

from dataclasses import dataclass
from typing import Literal
from urllib.parse import urlencode

from pipeline.scene import ImageKey

Stage = Literal["off", "windows", "objectness", "hashing", "verification", "nms"]
Part = Literal["trace", "window", "swarm"]

NO_PIXEL = (-1.0, -1.0)
FOLLOWED = -1


@dataclass(frozen=True)
class HashMatchChoice:
    """Which stage of the cascade is drawn, which window is looked into, and which swarm."""

    stage: Stage = "off"
    """Whose heatmap of candidates is drawn over the image."""
    level: int | None = None
    """Level of the pyramid; None for the sum over all."""
    part: Part = "trace"
    """Of the tab: why an instance was found or lost, the window, or the refinement."""
    scene_id: int | None = None
    """Scene of the image that window and estimate are of; in other images they are not shown."""
    im_id: int | None = None
    """That image."""
    pixel: tuple[float, float] = NO_PIXEL
    """Where the window is, pixels (u, v) of the image; NO_PIXEL for none."""
    detection: int | None = None
    """Row of the detection whose window it is; it goes before `pixel`."""
    template: int | None = None
    """Position among the window's templates; None for the one that came farthest, FOLLOWED for the one that the trace of
    the row's instance is about."""
    test: int = 0
    """Number of the test whose points are shown; 0 for the one that failed, or T2."""
    instance: int | None = None
    """Number of the estimate whose refinement is shown; None for that of the row."""
    iteration: int | None = None
    """Of the swarm; None for the last."""

    @property
    def has_window(self) -> bool:
        """Whether a window is chosen, of whichever image."""
        return self.detection is not None or self.pixel != NO_PIXEL

    def is_of(self, key: ImageKey) -> bool:
        """Whether window and estimate are of this image."""
        return (self.scene_id, self.im_id) == key


def query(key: ImageKey | None = None, **fields: object) -> str:
    """The part of an address that changes fields of the choice; with `key` they are about that image."""
    about = {} if key is None else {"scene_id": key.scene_id, "im_id": key.im_id}
    return urlencode(
        {f"hashmatch.{name}": _text(value) for name, value in (about | fields).items()},
        safe=",",
    )


def window_query(
    key: ImageKey, *, pixel: tuple[float, float] = NO_PIXEL, detection: int | None = None, **more: object
) -> str:
    """The part of an address that chooses a window, by place or by detection, and its best template."""
    chosen = {"pixel": pixel, "detection": detection, "template": None, "test": 0}
    return query(key, **(chosen | more))


def _text(value: object) -> str:
    if isinstance(value, tuple):
        return ",".join(f"{part:.6g}" for part in value)
    return "none" if value is None else str(value)
