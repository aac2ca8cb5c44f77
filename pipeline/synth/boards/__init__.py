"""Marker boards on a turntable: the test bed of calibration, depth correction and annotation over many views."""

from pipeline.synth.boards.board_files import read_board, write_board, write_picture
from pipeline.synth.boards.board_world import EXPOSED_FOR_BOARD, BoardScene, board_scene, board_world
from pipeline.synth.boards.detection import BoardPose, Detections, NoBoardError, camera_pose, detect
from pipeline.synth.boards.layouts import framed_board, grid_board
from pipeline.synth.boards.marker_board import MarkerBoard
from pipeline.synth.boards.sequence import Turn, board_sequence
from pipeline.synth.boards.views import TLESS_TEST, TLESS_TRAINING, TurntableView, turntable_views

__all__ = [
    "EXPOSED_FOR_BOARD",
    "TLESS_TEST",
    "TLESS_TRAINING",
    "BoardPose",
    "BoardScene",
    "Detections",
    "MarkerBoard",
    "NoBoardError",
    "Turn",
    "TurntableView",
    "board_scene",
    "board_sequence",
    "board_world",
    "camera_pose",
    "detect",
    "framed_board",
    "grid_board",
    "read_board",
    "turntable_views",
    "write_board",
    "write_picture",
]
