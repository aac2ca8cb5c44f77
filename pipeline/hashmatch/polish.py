"""Last steps of refinement: rendered points are drawn to the measured surface along their normals.

A swarm finds the right valley, and takes long to reach its floor; some steps of point-to-plane alignment at the pixels
where rendering and measurement agree do it. A step that lowers the swarm's own score is not taken.
"""

import numpy as np
from jaxtyping import Float

from pipeline.hashmatch.fit import ENDLESS, DepthFit
from pipeline.ray_casting import Box, Hits, cast

STEPS = 6


def polished(
    fit: DepthFit, poses: Float[np.ndarray, "n 4 4"], boxes: list[Box], steps: int = STEPS,
    endless: float = ENDLESS,
) -> tuple[Float[np.ndarray, "n 4 4"], Float[np.ndarray, "n"]]:  # fmt: skip
    """Improved poses and their scores; `endless` is the weight of the outline in these."""
    best, score = poses.copy(), fit.scores(poses, boxes, endless)
    current = poses.copy()
    for _ in range(steps):
        hits = cast(fit.model, fit.camera, current, boxes, 0.0)
        current = np.array([
            _step(fit, pose, box, hit) for pose, box, hit in zip(current, boxes, hits, strict=True)
        ])  # fmt: skip
        scores = fit.scores(current, boxes, endless)
        better = scores > score
        best[better], score[better] = current[better], scores[better]
    return best, score


def _step(fit: DepthFit, pose: np.ndarray, box: Box, hit: Hits) -> Float[np.ndarray, "4 4"]:
    """Move a pose by the small motion that brings its surface nearest to the measured one."""
    from scipy.spatial.transform import Rotation

    rows, columns = box.slices
    measured = fit.depth[rows, columns]
    with np.errstate(invalid="ignore"):
        agree = (measured > 0) & ~fit.taken[rows, columns] & (np.abs(measured - hit.depth) < fit.tolerance)
    if agree.sum() < 20:
        return pose
    v, u = np.nonzero(agree)
    K = fit.camera.K
    rays = np.stack([(u + box.x0 - K[0, 2]) / K[0, 0], (v + box.y0 - K[1, 2]) / K[1, 1], np.ones(len(u))], axis=-1)
    points = rays * hit.depth[agree][:, None]
    normals = hit.normals[agree] @ pose[:3, :3].T
    away = ((rays * measured[agree][:, None] - points) * normals).sum(axis=1)
    middle = points.mean(axis=0)
    jacobian = np.hstack([np.cross(points - middle, normals), normals])
    weights = 1 / (1 + (away / (fit.tolerance / 4)) ** 2)
    damping = np.diag([1e-4 * len(u) * fit.model.diameter**2] * 3 + [1e-3 * len(u)] * 3)
    motion = np.linalg.solve((jacobian * weights[:, None]).T @ jacobian + damping, jacobian.T @ (weights * away))
    turn = Rotation.from_rotvec(motion[:3]).as_matrix()
    result = np.eye(4)
    result[:3, :3] = turn @ pose[:3, :3]
    result[:3, 3] = turn @ (pose[:3, 3] - middle) + middle + motion[3:]
    return result
