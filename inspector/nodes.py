"""What a picture is made of, and what a picture is.

All coordinates are those of the image's camera (OpenCV: x right, y down, z forward), in metres.
"""

from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, UInt8

from inspector.layers import ColorScale
from pipeline.scene import Camera, ImageKey


@dataclass(frozen=True)
class Picture:
    """An image on the plane at depth `z` that the camera sees exactly as its image."""

    token: Hashable
    """Equal tokens mean equal pixels: they are neither made nor sent again."""
    pixels: Callable[[], UInt8[np.ndarray, "h w c"]]
    """RGB, or RGBA with straight alpha; of any resolution."""
    camera: Camera
    z: float
    edges: tuple[float, float, float, float] | None = None
    """Left, top, right and bottom edge in image pixels, where it covers a part of the image only."""


@dataclass(frozen=True)
class Mesh:
    """A triangle mesh of one colour."""

    token: Hashable
    vertices: Callable[[], Float[np.ndarray, "v 3"]]
    faces: Int[np.ndarray, "f 3"]
    color: tuple[int, int, int]
    opacity: float
    wireframe: bool = False


@dataclass(frozen=True)
class ColoredMesh:
    """A triangle mesh with a colour per vertex."""

    token: Hashable
    vertices: Callable[[], Float[np.ndarray, "v 3"]]
    faces: Int[np.ndarray, "f 3"]
    colors: Callable[[], UInt8[np.ndarray, "v 3"]]


@dataclass(frozen=True)
class Cloud:
    """Coloured points."""

    token: Hashable
    points: Callable[[], tuple[Float[np.ndarray, "n 3"], UInt8[np.ndarray, "n 3"]]]
    """Positions and colours."""
    size: float
    """Metres."""


@dataclass(frozen=True)
class Lines:
    """Line segments of one colour, or of one each."""

    token: Hashable
    segments: Float[np.ndarray, "n 2 3"]
    color: tuple[int, int, int] | UInt8[np.ndarray, "n 3"]
    """With a colour each, the token has to tell colours apart, too."""
    width: float = 2.0
    """Screen pixels."""


@dataclass(frozen=True)
class Viewpoint:
    """The camera of another image; a click on it goes there."""

    token: Hashable
    image: ImageKey
    camera: Camera
    camera_from_other: Float[np.ndarray, "4 4"]
    scale: float
    """Metres; size of the drawn frustum."""


Node = Picture | Mesh | ColoredMesh | Cloud | Lines | Viewpoint


class Drawing(NamedTuple):
    """Nodes for the canvas, and what the colours of the layers mean."""

    nodes: dict[str, Node]
    scales: tuple[ColorScale, ...] = ()
    warnings: tuple[str, ...] = ()
    notes: tuple[tuple[str, tuple[int, int, int] | None], ...] = ()
    """Lines for the legend: a text, and the colour that it explains."""

    def with_more(self, other: "Drawing") -> "Drawing":
        """Both together; of nodes with one name the other's counts."""
        return Drawing(
            self.nodes | other.nodes,
            self.scales + other.scales,
            self.warnings + other.warnings,
            self.notes + other.notes,
        )


NOTHING = Drawing({})
"""An empty drawing."""
