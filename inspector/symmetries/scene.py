"""The 3D picture of a candidate: the model, its turned self, the axis, and distances as colours."""

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import viser
from jaxtyping import Float, UInt8

from inspector.symmetries.meshes import ShownModel, colored
from pipeline.geometry import inverse, transform_points
from pipeline.symmetry_search.groups import Axis
from pipeline.symmetry_search.surface import Surface

Rgb = tuple[int, int, int]
Mode = Literal["overlay", "blink", "distance"]
MODEL_COLOR, TURNED_COLOR = (206, 210, 216), (255, 136, 24)
STANDING_COLORS: dict[str, Rgb] = {
    "accepted": (64, 192, 87),
    "refused": (250, 82, 82),
    "follows": (64, 192, 87),
    "open": (116, 192, 252),
}
SCALE_STOPS = ((236, 238, 241), (120, 190, 235), (250, 205, 60), (245, 120, 40), (205, 30, 45))
"""Colours of distances 0, epsilon / 2, epsilon, 1.5 epsilon, and 2 epsilon or more."""
AXIS_REACH = 0.68
"""Scene units from the middle to an end of the drawn axis."""
MARK = 0.055
"""Scene units: radius of the figure at an end of the axis."""


@dataclass(frozen=True)
class Look:
    """How candidates are shown, in all browsers alike."""

    mode: Mode = "overlay"
    colors: bool = False
    """The model's own colours, where it has any."""
    angle: float = 180.0
    """Degrees that the model is turned about the axis."""
    playing: bool = False
    """Whether it goes on turning."""
    dark: bool = True


class SymmetryScene:
    """Keeps the nodes of the scene that all browsers share."""

    def __init__(self, scene: viser.SceneApi) -> None:
        self._scene = scene
        self._lock = threading.RLock()
        self._handles: dict[str, Any] = {}
        self._about: dict[str, object] = {}

    def show_models(self, shown: ShownModel, turn: Float[np.ndarray, "4 4"], look: Look, visible: bool = True) -> None:
        """Show a model and its turned self; what has been sent is not sent again."""
        own = shown.own_look if look.colors and look.mode != "distance" else None
        with self._lock:
            turned_opacity = 0.55 if look.mode == "overlay" else None
            self._mesh("model", shown, own, MODEL_COLOR, None)
            self._mesh("turned", shown, own if look.mode == "blink" else None, TURNED_COLOR, turned_opacity)
            self._remove("heat")
            self.place(shown, turn)
            self._handles["model"].visible = visible
            self._handles["turned"].visible = visible and look.mode == "overlay"

    def place(self, shown: ShownModel, turn: Float[np.ndarray, "4 4"]) -> None:
        """Move the turned self, and nothing else."""
        with self._lock:
            turned = self._handles.get("turned")
            if turned is not None:
                quaternion, position = shown.pose(turn)
                turned.wxyz = quaternion
                turned.position = position

    def show_distances(
        self, shown: ShownModel, surface: Surface, turn: Float[np.ndarray, "4 4"], epsilon: float
    ) -> None:
        """Show the model with the distance of each of its points to its turned self as a colour."""
        back = transform_points(inverse(turn), shown.in_model(shown.fine_vertices)) - surface.center
        colors = distance_colors(surface.distances(back), epsilon)
        mesh = colored(shown.fine_vertices, shown.fine_faces, colors)
        with self._lock:
            self._handles["heat"] = self._scene.add_mesh_trimesh("/heat", mesh, cast_shadow=False, receive_shadow=False)
            self._about["heat"] = None
            for name in ("model", "turned"):
                if name in self._handles:
                    self._handles[name].visible = False

    def show_axes(self, shown: ShownModel, axis: Axis | None, fold: int, color: Rgb, others: Sequence[Axis]) -> None:
        """Draw the axis of the candidate with a figure that says its fold, and thinly those of the accepted set."""
        with self._lock:
            self._lines("axis", _axis_lines(shown, axis, fold) if axis is not None else None, color, 3.5)
            thin = [_axis_lines(shown, other, 1)[:1] for other in others]
            self._lines("others", np.concatenate(thin) if thin else None, STANDING_COLORS["accepted"], 1.5)

    def blink(self, on: bool) -> None:
        """Show the model (True) or its turned self alone."""
        with self._lock:
            for name, wanted in (("model", on), ("turned", not on)):
                if name in self._handles:
                    self._handles[name].visible = wanted

    def clear(self) -> None:
        """Show nothing."""
        with self._lock:
            for name in list(self._handles):
                self._remove(name)

    def _mesh(self, name: str, shown: ShownModel, own: Any, color: Rgb, opacity: float | None) -> None:
        about = (shown, own is not None, color, opacity)
        if self._about.get(name) == about:
            return
        self._about[name] = about
        if own is not None:
            self._handles[name] = self._scene.add_mesh_trimesh(f"/{name}", own, cast_shadow=False, receive_shadow=False)
            return
        self._handles[name] = self._scene.add_mesh_simple(
            f"/{name}",
            (shown.vertices if opacity is None else shown.grown_vertices).astype(np.float32),
            shown.faces.astype(np.uint32),
            color=color,
            opacity=opacity,
            side="double",
            cast_shadow=False,
            receive_shadow=False,
        )

    def _lines(self, name: str, segments: np.ndarray | None, color: Rgb, width: float) -> None:
        if segments is None or not len(segments):
            self._remove(name)
            return
        about = (segments.tobytes(), color, width)
        if self._about.get(name) != about:
            self._about[name] = about
            self._handles[name] = self._scene.add_line_segments(
                f"/{name}", segments.astype(np.float32), color, thickness=width, thickness_units="screen"
            )

    def _remove(self, name: str) -> None:
        handle = self._handles.pop(name, None)
        self._about.pop(name, None)
        if handle is not None:
            handle.remove()


def distance_colors(distances: Float[np.ndarray, "n"], epsilon: float) -> UInt8[np.ndarray, "n 3"]:
    """Colours of distances (metres); the scale ends at two epsilon."""
    stops = np.linspace(0, 2 * epsilon, len(SCALE_STOPS))
    channels = [np.interp(distances, stops, channel) for channel in np.array(SCALE_STOPS, float).T]
    return np.stack(channels, axis=1).astype(np.uint8)


def _axis_lines(shown: ShownModel, axis: Axis, fold: int) -> Float[np.ndarray, "n 2 3"]:
    """The axis, and at its ends a figure with as many corners as the fold has turns (a lens for 2, a circle for any)."""
    direction = axis.direction
    through = shown.in_scene(axis.through)
    through = through - direction * (direction @ through)
    ends = through + np.outer([-AXIS_REACH, AXIS_REACH], direction)
    lines = [ends[None]]
    first = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    first /= np.linalg.norm(first)
    second = np.cross(direction, first)
    for end in ends:
        corners = np.array([end + MARK * (a * first + b * second) for a, b in _figure(fold)])
        if len(corners):
            lines.append(np.stack([corners, np.roll(corners, -1, axis=0)], axis=1))
    return np.concatenate(lines)


def _figure(fold: int) -> Float[np.ndarray, "k 2"]:
    """Corners of the figure that crystallographers draw for an axis, within the unit circle."""
    if fold == 1:
        return np.empty((0, 2))
    if fold == 2:
        half = np.linspace(-1, 1, 9)[:-1]
        return np.concatenate([np.c_[half, 0.5 * (1 - half**2)], np.c_[-half, -0.5 * (1 - half**2)]])
    angles = 2 * np.pi * np.arange(fold or 40) / (fold or 40)
    return np.stack([np.cos(angles), np.sin(angles)], axis=1)
