"""Correcting the systematic error of a depth sensor: d_c = a d + b (thesis sec. tless_depth_correction).

boards = scene_boards(dataset, keys)
found = estimate(board_samples(dataset, keys, boards).samples, near=0.53, far=0.92)
found.a, found.b, found.held_out.mean_abs
correct_to(CorrectionPlan(dataset.root, dataset.split, found.a, found.b), Path("corrected"))
"""

from annotate.depth.applying import Corrected, correct_raw
from annotate.depth.correct_dataset import Done, correct_in_place, correct_to
from annotate.depth.depth_folders import CorrectionPlan
from annotate.depth.estimate import DepthEstimate, estimate
from annotate.depth.fitting import Confidence, Fit
from annotate.depth.from_board import Collected, board_samples, scene_boards
from annotate.depth.from_poses import pose_samples
from annotate.depth.held_out import HeldOut
from annotate.depth.models import Correction
from annotate.depth.registration import Registration, check_registration, registration_shift
from annotate.depth.samples import DepthSamples
from annotate.depth.unknown_size import UnknownSizeEstimate, estimate_unknown_size, marker_samples

__all__ = [
    "Collected",
    "Confidence",
    "Corrected",
    "Correction",
    "CorrectionPlan",
    "DepthEstimate",
    "DepthSamples",
    "Done",
    "Fit",
    "HeldOut",
    "Registration",
    "UnknownSizeEstimate",
    "board_samples",
    "check_registration",
    "correct_in_place",
    "correct_raw",
    "correct_to",
    "estimate",
    "estimate_unknown_size",
    "marker_samples",
    "pose_samples",
    "registration_shift",
    "scene_boards",
]
