"""PEARL: several poses at once by assigning correspondences to them and refitting (thesis sec. multi_instance_fitting)."""

import numpy as np
from jaxtyping import Float

from pipeline.epos.fitting.progressive_x.gc_ransac import Pose, View
from pipeline.epos.fitting.progressive_x.labelling import expand, pair_weight

_OUTLIER_COST, _WORST_COST = 1.0, 2.0
"""Of the label "outlier", and of an error far beyond tau_r, where one of tau_r costs 1."""


_MOST_ROUNDS = 10


def consolidate(view: View, poses: list[Pose]) -> tuple[list[Pose], list[int], list[float]]:
    """Alternate between assigning correspondences to poses and refitting the poses, until the energy falls no more.

    Args:
        view: the correspondences.
        poses: at least one.

    Returns:
        The poses that have correspondences, their positions in `poses`, and the energy of each round.

    """
    kept, energies = list(range(len(poses))), []
    labels = np.full(len(view.problem.points), len(poses))
    weight = pair_weight(view.neighbours, float(view.config.spatial_coherence))
    for _ in range(_MOST_ROUNDS):
        energy = expand(view.neighbours, _costs(view, poses), labels, weight)
        if energies and energy >= energies[-1] - 1e-6:
            break
        energies.append(energy)
        used = [k for k in range(len(poses)) if np.any(labels == k)]
        labels = np.searchsorted([*used, len(poses)], labels)
        refitted = [view.refined(labels == i) for i in range(len(used))]
        poses = [poses[k] if new is None else new for k, new in zip(used, refitted, strict=True)]
        kept = [kept[k] for k in used]
        if not poses:
            break
    return poses, kept, energies


def _costs(view: View, poses: list[Pose]) -> Float[np.ndarray, "labels n"]:
    """Cost of each pose, and at last of being an outlier, at each correspondence."""
    square = np.stack([view.square_errors(pose) for pose in poses]) / view.tau**2
    return np.vstack([np.minimum(square, _WORST_COST), np.full((1, square.shape[1]), _OUTLIER_COST)])
