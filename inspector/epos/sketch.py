"""A drawing as it grows: nodes, scales and notes, and where in the picture pixels and points of the model's copy are."""

from functools import cached_property

import numpy as np
from jaxtyping import Float, UInt8

from inspector.epos.placing import copy_from
from inspector.epos.row import EposRow
from inspector.layers import ColorScale
from inspector.nodes import Cloud, Drawing, Lines, Node
from inspector.planes import marks
from inspector.selection import Selection
from pipeline import geometry

Color = tuple[int, int, int]
WHITE: Color = (255, 255, 255)
DARK: Color = (20, 20, 20)
BEHIND = 1.003
"""Factor of the depth at which the dark edges of marks stand, so that they do not hide the marks."""


class Sketch:
    """Collects what is added to the picture of one row."""

    def __init__(self, row: EposRow, selection: Selection) -> None:
        """Begin an empty drawing."""
        self.row = row
        self.selection = selection
        self.nodes: dict[str, Node] = {}
        self.scales: list[ColorScale] = []
        self.notes: list[tuple[str, Color | None]] = []
        self.warnings: list[str] = []

    def finished(self) -> Drawing:
        """What was drawn so far."""
        return Drawing(self.nodes, tuple(self.scales), tuple(self.warnings), tuple(self.notes))

    @property
    def in_3d(self) -> bool:
        """Whether the scene is seen, and not the image."""
        return self.selection.view == "scene"

    @cached_property
    def copy(self) -> Float[np.ndarray, "4 4"] | None:
        """camera_from_model, with a scale, of the model's copy beside the image; None where there is none."""
        return copy_from(self.row, self.selection) if self.in_3d else None

    @cached_property
    def copy_size(self) -> float:
        """Diameter of the copy, metres."""
        assert self.copy is not None
        assert self.row.model is not None
        return float(np.cbrt(abs(np.linalg.det(self.copy[:3, :3])))) * self.row.model.diameter

    def at(self, pixels: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 3"]:
        """Points at which pixels of the image are seen."""
        return marks(self.row.frame, self.selection, pixels)

    def to_copy(
        self, pixels: Float[np.ndarray, "n 2"], points_in_model: Float[np.ndarray, "n 3"]
    ) -> Float[np.ndarray, "n 2 3"]:
        """Segments from pixels to points of the copy."""
        assert self.copy is not None
        return np.stack([self.at(pixels), geometry.transform_points(self.copy, points_in_model)], axis=1)

    def lines(
        self, name: str, segments: Float[np.ndarray, "n 2 3"], color: Color | UInt8[np.ndarray, "n 3"], width: float
    ) -> None:
        """Add segments, `width` screen pixels wide."""
        if len(segments):
            look = color if isinstance(color, tuple) else color.tobytes()
            self.nodes[f"epos/{name}"] = Lines((segments.tobytes(), look), segments, color, width)

    def framed(self, name: str, pixels: Float[np.ndarray, "n 2 2"], color: Color, width: float) -> None:
        """Add segments between pixels with dark edges, so that they are seen on anything."""
        segments = self.at(pixels)
        self.lines(f"{name}_edge", BEHIND * segments, DARK, width + 2.5)
        self.lines(name, segments, color, width)

    def points(self, name: str, points: Float[np.ndarray, "n 3"], color: UInt8[np.ndarray, "n 3"], size: float) -> None:
        """Add points of a size in metres."""
        if len(points):
            colors = np.ascontiguousarray(color)
            token = (points.tobytes(), colors.tobytes())
            self.nodes[f"epos/{name}"] = Cloud(token, lambda: (points, colors), size)


def square(center: Float[np.ndarray, "2"], half: float) -> Float[np.ndarray, "4 2 2"]:
    """The sides of a square."""
    return _closed(center + half * np.array([[-1.0, -1], [1, -1], [1, 1], [-1, 1]]))


def circle(center: Float[np.ndarray, "2"], radius: float, sides: int = 24) -> Float[np.ndarray, "s 2 2"]:
    """The sides of a regular polygon."""
    angles = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    return _closed(center + radius * np.stack([np.cos(angles), np.sin(angles)], axis=1))


def _closed(ring: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2 2"]:
    return np.stack([ring, np.roll(ring, -1, axis=0)], axis=1)
