"""Where a camera may stand about the point that it looks at (thesis sec. synth_composition)."""

from collections.abc import Iterator
from dataclasses import dataclass
from math import isfinite
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.geometry import transform
from pipeline.synth.cameras.errors import CameraSettingsError

Range = tuple[float, float]
"""Lower and upper limit."""

FULL_TURN = 360.0


@dataclass(frozen=True)
class CameraRanges:
    """Limits within which cameras are sampled uniformly, each (low, high); equal limits fix the value.

    Angles belong to the direction from the focus to the camera, in a frame whose z axis points up. The defaults are
    those of the T-LESS test images (thesis sec. tless_train_test_images and table of dataset parameters).
    Raises CameraSettingsError for limits that no camera can keep.
    """

    azimuth_deg: Range = (0.0, 360.0)
    """About z, from x towards y; at most a full turn, from any start (-30 to 30 is fine)."""
    elevation_deg: Range = (15.0, 75.0)
    """Above the horizontal plane, -90 to 90."""
    distance: Range = (0.65, 0.94)
    """Metres from the focus to the camera centre."""
    roll_deg: Range = (-180.0, 180.0)
    """In-plane rotation: the camera's x axis turns by it towards its y axis; 0 keeps what is up above the focus."""

    def __post_init__(self) -> None:
        """Check the limits."""
        for name, (low, high) in self._limits():
            shown = f"{name} {low:g} to {high:g}"
            if not (isfinite(low) and isfinite(high)):
                raise CameraSettingsError(f"{shown}: not finite; give two numbers, low and high")
            if low > high:
                raise CameraSettingsError(f"{shown}: the lower limit is above the upper; swap them")
            if name in ("azimuth_deg", "roll_deg") and high - low > FULL_TURN:
                raise CameraSettingsError(f"{shown}: more than a full turn; take at most 360 between low and high")
            if name == "elevation_deg" and not (low >= -90 and high <= 90):
                raise CameraSettingsError(f"{shown}: outside -90 to 90; an elevation is an angle above the horizon")
            if name == "distance" and low <= 0:
                raise CameraSettingsError(f"{shown}: not above 0; give the distance from the object in metres")

    def _limits(self) -> Iterator[tuple[str, Range]]:
        yield "azimuth_deg", self.azimuth_deg
        yield "elevation_deg", self.elevation_deg
        yield "distance", self.distance
        yield "roll_deg", self.roll_deg


class Viewpoint(NamedTuple):
    """A camera that looks straight at a point, by its four numbers; single values or arrays of them."""

    azimuth_deg: float | Float[np.ndarray, "*n"]
    elevation_deg: float | Float[np.ndarray, "*n"]
    distance: float | Float[np.ndarray, "*n"]
    """Metres."""
    roll_deg: float | Float[np.ndarray, "*n"]


def sample_view(
    ranges: CameraRanges, focus_point: Float[np.ndarray, "3"], rng: np.random.Generator
) -> Float[np.ndarray, "4 4"]:
    """Sample `world_from_camera` of a camera whose optical axis meets the focus point (world frame, metres).

    Azimuth, elevation, distance and in-plane rotation are uniform in their ranges and independent of each other.
    """
    azimuth, elevation, distance, roll = (rng.uniform(*limits) for _, limits in ranges._limits())
    return world_from_camera(Viewpoint(azimuth, elevation, distance, roll), focus_point)


def world_from_camera(viewpoint: Viewpoint, focus_point: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """Pose of the camera that looks at the focus point from a (single) viewpoint; defined straight from above too."""
    rotation = _upright(np.radians(viewpoint.azimuth_deg), np.radians(viewpoint.elevation_deg))
    cosine, sine = np.cos(np.radians(viewpoint.roll_deg)), np.sin(np.radians(viewpoint.roll_deg))
    rolled = rotation @ np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]])
    return transform(rolled, focus_point - viewpoint.distance * rotation[:, 2])


def viewpoints_of(world_from_cameras: Float[np.ndarray, "n 4 4"], focus_points: Float[np.ndarray, "n 3"]) -> Viewpoint:
    """Viewpoints of cameras about focus points, the inverse of `world_from_camera`; azimuth 0..360, roll -180..180.

    A camera need not look straight at its focus: its roll is then the nearest in-plane rotation of one that does.
    """
    offset = world_from_cameras[:, :3, 3] - focus_points
    distance = np.linalg.norm(offset, axis=1)
    azimuth = np.arctan2(offset[:, 1], offset[:, 0])
    elevation = np.arcsin(np.clip(offset[:, 2] / distance, -1.0, 1.0))
    turn = np.swapaxes(_upright(azimuth, elevation), -1, -2) @ world_from_cameras[:, :3, :3]
    roll = np.arctan2(turn[:, 1, 0] - turn[:, 0, 1], turn[:, 0, 0] + turn[:, 1, 1])
    return Viewpoint(np.degrees(azimuth) % FULL_TURN, np.degrees(elevation), distance, np.degrees(roll))


def _upright(azimuth: np.ndarray | float, elevation: np.ndarray | float) -> Float[np.ndarray, "*n 3 3"]:
    """Axes of cameras (columns x right, y down, z to the focus) without in-plane rotation; angles in radians."""
    zero = np.zeros_like(azimuth)
    right = np.stack([-np.sin(azimuth), np.cos(azimuth), zero], axis=-1)
    down = np.stack(
        [np.sin(elevation) * np.cos(azimuth), np.sin(elevation) * np.sin(azimuth), -np.cos(elevation)], axis=-1
    )
    ahead = np.stack(
        [-np.cos(elevation) * np.cos(azimuth), -np.cos(elevation) * np.sin(azimuth), -np.sin(elevation)], axis=-1
    )
    return np.stack([right, down, ahead], axis=-1)
