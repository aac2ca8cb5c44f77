"""Calibrating cameras: intrinsics, poses from marker boards, and markers of any dictionary (thesis sec. tless_calibration).

camera = calibrate(sorted(folder.glob("*.png")), Checkerboard(9, 6, 0.025))
camera.K, camera.distortion, camera.rms_px
poses = sensor_poses(dataset, keys, boards)         # poses.rms_px over all corners
"""

from annotate.calibration.dictionary import (
    MarkerDictionary,
    any_dictionary,
    named_dictionary,
    read_dictionary,
    write_dictionary,
)
from annotate.calibration.intrinsics import CalibratedImage, Calibration, calibrate, calibrate_views, undistorted
from annotate.calibration.learned_board import LearnedBoard, learn_boards
from annotate.calibration.learned_dictionary import LearnedDictionary, learn_dictionary
from annotate.calibration.markers import detect_markers
from annotate.calibration.patterns import CharucoBoard, Checkerboard, Pattern, PatternView
from annotate.calibration.sensor_poses import SensorPoses, sensor_poses

__all__ = [
    "CalibratedImage",
    "Calibration",
    "CharucoBoard",
    "Checkerboard",
    "LearnedBoard",
    "LearnedDictionary",
    "MarkerDictionary",
    "Pattern",
    "PatternView",
    "SensorPoses",
    "any_dictionary",
    "calibrate",
    "calibrate_views",
    "detect_markers",
    "learn_boards",
    "learn_dictionary",
    "named_dictionary",
    "read_dictionary",
    "sensor_poses",
    "undistorted",
    "write_dictionary",
]
