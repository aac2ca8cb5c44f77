"""Poses are drawn to the measured surface along the normals of the rendered one.

A swarm finds the right valley, and takes long to reach its floor; some steps of point-to-plane alignment at the pixels
where rendering and measurement agree do it. They are also the cheap way to see what many rough poses could become.
Of all poses passed through, the one that scores best is kept.
"""

from typing import no_type_check

import numpy as np
from jaxtyping import Float

from pipeline.hashmatch.compiling import compiled
from pipeline.hashmatch.fit import ENDLESS, DepthFit
from pipeline.ray_casting import Box, Hits, cast

STEPS = 6

LEAST_PIXELS = 20
"""Poses that agree with the measurement at fewer pixels stay where they are."""

_POSES_AT_ONCE = 400


def polished(
    fit: DepthFit, poses: Float[np.ndarray, "n 4 4"], boxes: list[Box], steps: int = STEPS,
    endless: float = ENDLESS,
) -> tuple[Float[np.ndarray, "n 4 4"], Float[np.ndarray, "n"]]:  # fmt: skip
    """Improved poses and their scores; `endless` is the weight of the outline in these."""
    best, score = poses.copy(), np.full(len(poses), -1.0)
    for first in range(0, len(poses), _POSES_AT_ONCE):
        part = slice(first, first + _POSES_AT_ONCE)
        current = poses[part]
        for step in range(steps + 1):
            hits = cast(fit.model, fit.camera, current, boxes[part], 0.0)
            scores = fit.scores_of(hits, current, boxes[part], endless)
            better = scores > score[part]
            best[part][better], score[part][better] = current[better], scores[better]
            if step < steps:
                current = _moved(fit, current, boxes[part], hits)
    return best, score


def _moved(
    fit: DepthFit, poses: Float[np.ndarray, "n 4 4"], boxes: list[Box], hits: list[Hits]
) -> Float[np.ndarray, "n 4 4"]:
    """Each pose after the small motion that brings its surface nearest to the measured one."""
    from scipy.spatial.transform import Rotation

    systems, sides, middles = np.zeros((len(poses), 6, 6)), np.zeros((len(poses), 6)), np.zeros((len(poses), 3))
    for i, (pose, box, hit) in enumerate(zip(poses, boxes, hits, strict=True)):
        rows, columns = box.slices
        count = _add_pixels(
            hit.depth, hit.normals, np.ascontiguousarray(pose[:3, :3]), fit.camera.K, box.x0, box.y0,
            fit.depth[rows, columns], fit.taken[rows, columns], fit.tolerance, LEAST_PIXELS,
            systems[i], sides[i], middles[i],
        )  # fmt: skip
        systems[i] += np.diag([1e-4 * max(count, 1) * fit.model.diameter**2] * 3 + [1e-3 * max(count, 1)] * 3)
    motions = np.linalg.solve(systems, sides[..., None])[..., 0]
    turns = Rotation.from_rotvec(motions[:, :3]).as_matrix()
    moved = poses.copy()
    moved[:, :3, :3] = turns @ poses[:, :3, :3]
    moved[:, :3, 3] = np.einsum("nij,nj->ni", turns, poses[:, :3, 3] - middles) + middles + motions[:, 3:]
    return moved


@compiled
@no_type_check
def _add_pixels(
    rendered, rendered_normals, rotation, K, x0, y0, measured, taken, tolerance, least, system, side, middle
):
    """Add the normal equations of point-to-plane alignment, about the mean of the points; returns how many there are."""
    height, width = rendered.shape
    count = 0
    for v in range(height):
        for u in range(width):
            if measured[v, u] > 0 and not taken[v, u] and abs(measured[v, u] - rendered[v, u]) < tolerance:
                count += 1
                middle[0] += (u + x0 - K[0, 2]) / K[0, 0] * rendered[v, u]
                middle[1] += (v + y0 - K[1, 2]) / K[1, 1] * rendered[v, u]
                middle[2] += rendered[v, u]
    middle /= max(count, 1)
    if count < least:
        return count
    point, normal, row = np.empty(3), np.empty(3), np.empty(6)
    for v in range(height):
        for u in range(width):
            away = measured[v, u] - rendered[v, u]
            if not (measured[v, u] > 0 and not taken[v, u] and abs(away) < tolerance):
                continue
            x, y = (u + x0 - K[0, 2]) / K[0, 0], (v + y0 - K[1, 2]) / K[1, 1]
            point[0], point[1], point[2] = x * rendered[v, u], y * rendered[v, u], rendered[v, u]
            for k in range(3):
                normal[k] = 0.0
                for j in range(3):
                    normal[k] += rotation[k, j] * rendered_normals[v, u, j]
            along = away * (x * normal[0] + y * normal[1] + normal[2])
            weight = 1 / (1 + (along / (tolerance / 4)) ** 2)
            for k in range(3):
                a, b = (k + 1) % 3, (k + 2) % 3
                row[k] = (point[a] - middle[a]) * normal[b] - (point[b] - middle[b]) * normal[a]
                row[3 + k] = normal[k]
            for i in range(6):
                side[i] += weight * along * row[i]
                for j in range(6):
                    system[i, j] += weight * row[i] * row[j]
    return count
