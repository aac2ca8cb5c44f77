"""How well rendered poses explain the measured depth: the objective of the particle swarm.

Scores rendered against measured depth and normals, truncated at a tolerance, as Zabulis et al. 2015 do; surface that the
camera should see but looks through is evidence against a pose, surface that something nearer hides hardly is. So is an
outline across which the measured surface goes on: a flat side fits anywhere on a table, but ends nowhere there.
"""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Bool, Float

from pipeline.hashmatch.compiling import compiled
from pipeline.hashmatch.pyramid import Base
from pipeline.ray_casting import Box, Hits, cast
from pipeline.scene import Camera, Model

HIDDEN = 0.5
"""Weight of surface behind what was measured, by that of surface in sight."""

UNKNOWN = 0.25
"""Weight of surface where nothing was measured."""

ENDLESS = 0.4
"""Share of the score that is lost where the measured surface goes on across the whole outline."""

_RAYS_AT_ONCE = 400_000


@dataclass(frozen=True, eq=False)
class DepthFit:
    """Scores poses of one model in one image, at every `step`-th pixel."""

    model: Model
    base: Base
    camera: Camera
    """Sees the chosen pixels only."""
    step: int
    depth: Float[np.ndarray, "h w"]
    normals: Float[np.ndarray, "h w 3"]
    """Camera frame."""
    taken: Bool[np.ndarray, "h w"]
    """Pixels that another instance explains: no surface fits there, but some may be hidden behind."""
    tolerance: float
    """Metres."""

    def box(self, centroid: Float[np.ndarray, "3"], radius: float) -> Box:
        """The chosen pixels that see a sphere (camera frame, metres)."""
        K = self.camera.K
        z = max(centroid[2], 1.5 * radius)
        middle = K[:2, :2].diagonal() * centroid[:2] / z + K[:2, 2]
        reach = K[:2, :2].diagonal() * radius / (z - radius / 2)
        size = np.array([self.camera.width, self.camera.height])
        x0, y0 = np.clip(np.floor(middle - reach), 0, size).astype(int).tolist()
        x1, y1 = np.clip(np.ceil(middle + reach) + 1, 0, size).astype(int).tolist()
        return Box(x0, y0, max(x0, x1), max(y0, y1))

    def scores(
        self, poses: Float[np.ndarray, "n 4 4"], boxes: list[Box], endless: float = ENDLESS
    ) -> Float[np.ndarray, "n"]:
        """Share of the surface in sight that fits, 0..1, for each pose within its box; one batch of rays for all."""
        found = np.zeros(len(poses))
        per_batch = max(1, _RAYS_AT_ONCE // max(1, max((box.area for box in boxes), default=1)))
        for first in range(0, len(poses), per_batch):
            batch = slice(first, first + per_batch)
            hits = cast(self.model, self.camera, poses[batch], boxes[batch], 0.0)
            found[batch] = self.scores_of(hits, poses[batch], boxes[batch], endless)
        return found

    def scores_of(
        self, hits: list[Hits], poses: Float[np.ndarray, "n 4 4"], boxes: list[Box], endless: float = ENDLESS
    ) -> Float[np.ndarray, "n"]:
        """The same for poses that are rendered already."""
        found = np.zeros(len(poses))
        for i, (hit, pose, box) in enumerate(zip(hits, poses, boxes, strict=True)):
            if box.area:
                rows, columns = box.slices
                found[i] = _score(
                    hit.depth, hit.normals, np.ascontiguousarray(pose[:3, :3]),
                    self.depth[rows, columns], self.normals[rows, columns], self.taken[rows, columns],
                    self.tolerance, HIDDEN, UNKNOWN, endless,
                )  # fmt: skip
        return found


def depth_fit(
    model: Model, base: Base, step: int, tolerance: float, taken: Bool[np.ndarray, "H W"] | None = None
) -> DepthFit:
    """Prepare the comparison at every `step`-th pixel of an image; `taken` are pixels that others explain."""
    K = base.image.camera.K.copy()
    K[:2] /= step
    depth = np.ascontiguousarray(base.depth[::step, ::step])
    height, width = depth.shape
    normals = _in_camera(np.ascontiguousarray(base.normals[::step, ::step]), K)
    claimed = np.zeros(depth.shape, bool) if taken is None else np.ascontiguousarray(taken[::step, ::step])
    return DepthFit(model, base, Camera(K, width, height), step, depth, normals, claimed, tolerance)


def step_for(pixels: float, rays: int) -> int:
    """Every how many-th pixel gives a number of rays, out of an area in pixels."""
    return max(1, round(float(np.sqrt(pixels / rays))))


def _in_camera(normals: np.ndarray, K: np.ndarray) -> np.ndarray:
    """Normals relative to the viewing rays, turned into the camera frame."""
    height, width = normals.shape[:2]
    x = (np.arange(width) - K[0, 2]) / K[0, 0]
    y = (np.arange(height) - K[1, 2]) / K[1, 1]
    rays = np.stack(np.broadcast_arrays(x[None, :], y[:, None], 1.0), axis=-1)
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    # R_a n, as in `rotation_to_ray`: the smallest rotation of the axis to the ray
    middle = rays + np.array([0, 0, 1])
    along = (normals * middle).sum(axis=-1, keepdims=True) / middle[..., 2:]
    return (normals - along * middle + 2 * normals[..., 2:] * rays).astype(np.float32)


@compiled
@no_type_check
def _score(
    rendered, rendered_normals, rotation, measured, measured_normals, taken, tolerance, hidden, unknown, endless
):
    fitting, weight, outline, going_on = 0.0, 0.0, 0, 0
    height, width = rendered.shape
    for v in range(rendered.shape[0]):
        for u in range(rendered.shape[1]):
            r, m = rendered[v, u], measured[v, u]
            if not np.isfinite(r):
                continue
            if m <= 0:
                weight += unknown
                continue
            difference = (m - r) / tolerance
            if difference < -1:
                weight += hidden
                continue
            weight += 1
            if difference > 1 or taken[v, u]:
                continue
            alike = 0.0
            for k in range(3):
                turned = 0.0
                for j in range(3):
                    turned += rotation[k, j] * rendered_normals[v, u, j]
                alike += turned * measured_normals[v, u, k]
            fitting += (1 - difference * difference) * (0.4 + 0.6 * alike * alike)
            for dv, du in ((0, 1), (1, 0), (0, -1), (-1, 0)):
                y, x = v + dv, u + du
                if 0 <= y < height and 0 <= x < width and not np.isfinite(rendered[y, x]) and measured[y, x] > 0:
                    outline += 1
                    going_on += abs(measured[y, x] - m) < 0.6 * tolerance
    if weight == 0:
        return 0.0
    return fitting / weight * (1 - endless * going_on / max(outline, 1))
