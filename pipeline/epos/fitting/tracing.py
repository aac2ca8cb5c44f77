"""From the logs of compiled searches to traces."""

import numpy as np
from jaxtyping import Float

from pipeline.epos.fitting.primitives.hypothesis_log import KEPT, Log
from pipeline.epos.fitting.results import HypothesisTrace

_STAGES = ("early", "sample", "optimized", "optimized")
"""By `Log.kind`."""


def with_origin(poses: Float[np.ndarray, "k 3 4"], centre: Float[np.ndarray, "3"]) -> Float[np.ndarray, "k 4 4"]:
    """Poses of points relative to a centre as 4x4 poses of the model."""
    camera_from_model = np.tile(np.eye(4), (len(poses), 1, 1))
    camera_from_model[:, :3] = poses
    camera_from_model[:, :3, 3] -= poses[:, :, :3] @ centre
    return camera_from_model


def logged(log: Log, centre: Float[np.ndarray, "3"], unit: float, proposal: int) -> HypothesisTrace:
    """What a search noted; `unit` is the logged quality that stands for 1."""
    count = int(log.size[0])
    kinds = log.kind[:count]
    return HypothesisTrace(
        camera_from_model=with_origin(log.pose[:count], centre),
        quality=log.quality[:count] / unit,
        triplets=log.triplet[:count].copy(),
        stage=tuple(_STAGES[kind] for kind in kinds),
        best=kinds == KEPT,
        proposals=np.full(count, proposal),
    )


def single(
    pose: Float[np.ndarray, "3 4"],
    centre: Float[np.ndarray, "3"],
    quality: float,
    stage: str,
    best: bool,
    proposal: int,
) -> HypothesisTrace:
    """One pose that came from no triplet."""
    placed, none = with_origin(pose[None], centre), np.full((1, 3), -1)
    return HypothesisTrace(placed, np.array([quality]), none, (stage,), np.array([best]), np.array([proposal]))
