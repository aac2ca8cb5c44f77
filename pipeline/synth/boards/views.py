"""Cameras about a turntable: which way it is turned, and where the camera then is on the board."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from pipeline.exceptions import InputError
from pipeline.geometry import transform

CAMERA_SIDE_DEG = -90.0
"""Where the camera stands in the room, as azimuth about the turntable's axis: to the south, looking north."""
TLESS_TRAINING = (tuple(range(0, 360, 5)), tuple(range(5, 90, 10)))
"""Azimuths and elevations in degrees of T-LESS's training images, upper hemisphere (thesis sec. tless_train_test_images)."""
TLESS_TEST = (tuple(range(0, 360, 5)), tuple(range(15, 80, 10)))
"""Those of its test images."""


class TurntableView(NamedTuple):
    """One image of a turntable's sequence."""

    azimuth_deg: float
    """Of the camera about the board's z axis, from +x towards +y."""
    elevation_deg: float
    """Above the board's plane."""
    turn_deg: float
    """How far the turntable is turned in the room, counter-clockwise seen from above, 0..360."""
    board_from_camera: Float[np.ndarray, "4 4"]
    """Metres."""


def turntable_views(
    azimuths_deg: Sequence[float],
    elevations_deg: Sequence[float],
    distance: float,
    centre: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> list[TurntableView]:
    """All azimuths with all elevations, azimuth by azimuth; the camera looks at `centre` (board frame, metres).

    The camera stays where it is in the room but for its elevation; the turntable is turned to give the azimuth.
    `distance` is that to the centre, in metres. Raises `InputError` for elevations outside 0..90 degrees.
    """
    if distance <= 0 or any(not 0 <= elevation <= 90 for elevation in elevations_deg):
        raise InputError(
            f"turntable views at elevations {list(elevations_deg)} degrees and {distance} m: take 0 to 90 degrees and a"
            " distance above 0"
        )
    return [
        TurntableView(a, e, (CAMERA_SIDE_DEG - a) % 360.0, _orbiting(a, e, distance, np.array(centre)))
        for a in azimuths_deg
        for e in elevations_deg
    ]


def _orbiting(azimuth_deg: float, elevation_deg: float, distance: float, centre: np.ndarray) -> np.ndarray:
    """Board from a camera that looks at the centre, the board's z axis up in its image."""
    a, e = np.radians(azimuth_deg), np.radians(elevation_deg)
    outward = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    right = np.array([-np.sin(a), np.cos(a), 0.0])
    rotation = np.stack([right, np.cross(-outward, right), -outward], axis=1)
    return transform(rotation, centre + distance * outward)
