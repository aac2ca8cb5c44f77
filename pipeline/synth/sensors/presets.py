"""Sensors that datasets were captured with: how they measure depth, and their intrinsics.

What is published is cited. Where nothing is (shares of missing pixels at edges and grazing angles, the window over
which noise is alike), the values are ours, chosen to look like the sensors' real images.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from pipeline.exceptions import UnknownIdError
from pipeline.scene import Camera
from pipeline.synth.sensors.depth_sensor import DepthSensor

DISPARITY_STEP = 1 / 8 / (580.0 * 0.075)
"""1 / metres. PrimeSense's sensors measure disparity in eighths of a pixel, with a focal length of about 580 px and a
baseline of 75 mm (Khoshelham and Oude Elberink, Sensors 2012): 0.0029 / m, which LM-O and IC-BIN images show too."""

KINECT_V1 = DepthSensor(
    # Nguyen, Izadi and Lovell, "Modeling Kinect Sensor Noise", 3DIMPVT 2012: 1.2 mm + 1.9 mm (d - 0.4)^2 face-on,
    # plus 0.1 mm d^-0.5 (t / (pi/2 - t))^2, and 0.8 px across.
    noise=(0.0012 + 0.0019 * 0.16, -0.0019 * 0.8, 0.0019),
    slanted_noise=(0.0001, -0.5),
    grain_px=2.0,
    jitter_px=0.8,
    edge_missing=0.25,
    grazing_deg=(70.0, 86.0),
    eyes=(0.05, -0.025),
    inverse_depth_step=DISPARITY_STEP,
    depth_step=0.001,
    sensing_range=(0.5, 5.0),
)
"""Microsoft Kinect of 2010, structured light: the sensor of LM and LM-O. Depth is registered to the colour camera, which
sits between the projector and the infrared camera, 75 mm apart."""

CARMINE = replace(KINECT_V1, a=1.0247, b=-0.00519, sensing_range=(0.35, 1.4))
"""Primesense Carmine 1.09, structured light: correction and range as measured for T-LESS (thesis sec.
tless_depth_correction, tless_acquisition_setup); the rest as of the Kinect of 2010, which has PrimeSense's chip."""

KINECT_V2 = DepthSensor(
    a=1.0266,
    b=-0.02688,
    # Fankhauser et al., "Kinect v2 for Mobile Robot Navigation", ICAR 2015: 1.5 mm - 0.5 mm d + 0.3 mm d^2 face-on,
    # plus 0.1 mm d^1.5 (t / (pi/2 - t))^2.
    noise=(0.0015, -0.0005, 0.0003),
    slanted_noise=(0.0001, 1.5),
    grain_px=0.7,
    edge_missing=0.4,
    edge_mixed=0.4,
    grazing_deg=(76.0, 88.0),
    depth_step=0.001,
    sensing_range=(0.5, 4.5),
)
"""Microsoft Kinect v2, time of flight: correction and range as measured for T-LESS (same sections)."""

SENSORS: Mapping[str, DepthSensor] = {
    "exact": DepthSensor(),
    "carmine": CARMINE,
    "kinect_v1": KINECT_V1,
    "kinect_v2": KINECT_V2,
}
"""By name. Carmine and Kinect v2 have the linear error that the thesis measured; `.corrected` is without it."""


class _Intrinsics(NamedTuple):
    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float


_INTRINSICS: Mapping[str, _Intrinsics] = {
    "carmine": _Intrinsics(640, 480, 570.342, 570.342, 319.5, 239.5),
    "carmine_tless": _Intrinsics(720, 540, 1075.651, 1073.903, 359.5, 269.5),
    "kinect_v1": _Intrinsics(640, 480, 572.4114, 573.57043, 325.2611, 242.04899),
    "kinect_v2": _Intrinsics(512, 424, 365.456, 365.456, 254.878, 205.395),
}
CAMERAS = tuple(_INTRINSICS)
"""Names of the intrinsics: "carmine" has the nominal ones of PrimeSense's driver; "carmine_tless" the size of the test
images of T-LESS (thesis sec. tless_train_test_images), the focal length published with them, and the principal point,
which there depends on the crop, in the middle; "kinect_v1" those of LM and LM-O; "kinect_v2" typical ones of its depth
camera, to whose image colour is registered. The thesis gives no intrinsics."""


def depth_sensor(name: str) -> DepthSensor:
    """A sensor by its name. Raises `UnknownIdError`, which lists the names."""
    if name not in SENSORS:
        raise UnknownIdError("depth sensor", name, "the presets", SENSORS)
    return SENSORS[name]


def sensor_camera(name: str) -> Camera:
    """Intrinsics by name, a new camera each time. Raises `UnknownIdError`, which lists the names."""
    if name not in _INTRINSICS:
        raise UnknownIdError("camera", name, "the presets", _INTRINSICS)
    width, height, fx, fy, cx, cy = _INTRINSICS[name]
    return Camera(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), width, height)
