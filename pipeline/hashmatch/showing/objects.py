"""What a matching was made with: settings, objects, their templates, and the distances at which they fit a level."""

import json
from dataclasses import fields
from typing import Any

import numpy as np
from jaxtyping import Integer

from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.detector import Detector, Matching
from pipeline.hashmatch.template_store import size_ranges
from pipeline.recording import StageRecorder

VERSION = 1
"""Of what is recorded of HashMatch."""

_OF_THE_MACHINE = ("cache", "threads")
"""Settings on which nothing that is found depends."""


def show_objects(detector: Detector, matching: Matching, recorder: StageRecorder) -> None:
    """Record settings, objects and the distances at which T1 can pass."""
    settings = {
        "version": VERSION,
        "config": _plain(detector.config),
        "edgel_threshold_m": float(detector.edgel_threshold),
        "edgels_needed": float(matching.edgels_needed),
        "focal_px": float(detector.objects[0].focal_px),
    }
    recorder.text("hashmatch/settings", json.dumps(settings, default=str))
    recorder.table("hashmatch/objects", _object_columns(detector))
    recorder.table("hashmatch/sizes", _size_columns(detector, matching))
    uncolored = [own.obj_id for own in detector.objects if not own.colored]
    if uncolored:
        recorder.text("log", f"objects without colour, for which test T5 is off: {', '.join(map(str, uncolored))}")


def show_templates(
    detector: Detector, matching: Matching, numbers: Integer[np.ndarray, "t"], recorder: StageRecorder
) -> None:
    """Record the orientations of templates that were detected or are among `numbers` (numbered through all objects).

    Their pictures are rendered from the model when they are looked at.
    """
    from scipy.spatial.transform import Rotation

    found, firsts = matching.detections, detector.tables.firsts
    used = np.union1d(numbers, found.templates + firsts[found.objects]).astype(np.int64)
    position = detector.tables.objects[used]
    local = used - firsts[position]
    rotations = np.zeros((len(used), 3, 3), np.float32)
    for own in np.unique(position):
        rotations[position == own] = detector.objects[own].rotations[local[position == own]]
    quaternions = Rotation.from_matrix(rotations).as_quat() if len(used) else np.zeros((0, 4))
    ids = np.array([own.obj_id for own in detector.objects])
    recorder.table("hashmatch/templates", {
        "object": ids[position].astype(np.int16),
        "template": local.astype(np.int32),
        "quaternion_xyzw": quaternions.astype(np.float32),
    })  # fmt: skip


def _plain(config: HashMatchConfig) -> dict[str, Any]:
    return {field.name: getattr(config, field.name) for field in fields(config) if field.name not in _OF_THE_MACHINE}


def _object_columns(detector: Detector) -> dict[str, np.ndarray]:
    objects = detector.objects
    return {
        "object": np.array([own.obj_id for own in objects], np.int32),
        "templates": np.array([len(own) for own in objects], np.int32),
        "diameter": np.array([own.diameter for own in objects]),
        "distance": np.array([own.distance for own in objects]),
        "centroid": np.array([own.centroid for own in objects], np.float64).reshape(-1, 3),
        "colored": np.array([own.colored for own in objects], bool),
    }


def _size_columns(detector: Detector, matching: Matching) -> dict[str, np.ndarray]:
    factor, count = detector.config.scale_factor, len(detector.objects)
    levels = [matched.level.index for matched in matching.levels]
    ranges = [size_ranges(detector.points, matched.scale, factor) for matched in matching.levels]
    nearest, farthest = np.array(ranges, np.float32).reshape(-1, 2).T
    return {
        "level": np.repeat(np.array(levels, np.int32), count),
        "object": np.tile(np.array([own.obj_id for own in detector.objects], np.int32), len(levels)),
        "nearest": nearest,
        "farthest": farthest,
    }
