"""What speaks for and against a pose in the depth image, pixel by pixel: what poses are compared and chosen by."""

from dataclasses import dataclass
from typing import no_type_check

import numpy as np
from jaxtyping import Float, Integer, UInt8

from pipeline.hashmatch import channels
from pipeline.hashmatch.channels import NONE
from pipeline.hashmatch.compiling import compiled
from pipeline.hashmatch.fit import DepthFit
from pipeline.model_cache import per_model
from pipeline.ray_casting import cast
from pipeline.scene import Model

LEAST_GAIN = 0.25
"""What a pixel must fit better than to speak for a pose: flat surfaces fit a little wherever something flat is."""

HIDDEN_COST = 0.15
"""What a hidden pixel costs, where one that the camera looks through costs 1."""

ENDLESS = 0.3
"""Share of the gains that is lost where the measured surface goes on across the whole outline."""

OTHER_COLOR = 0.5
"""What a pixel of another hue than the model's counts, by that of one alike; and again one much darker or brighter."""

BRIGHTNESS = (0.7, 1.7)
"""Octaves between the values (HSV) of image and model: up to the first they are alike under any usual light, from the
second on they are not."""

QUALITY = 1.0
"""Power of the share of its surface that a pose explains, by which all that speaks for and against it is weighted."""

REACH = 0.008
"""Metres beyond the outline at which is looked whether the surface goes on; a quarter of it may be between."""


@dataclass(frozen=True, eq=False)
class Evidence:
    """Of one pose."""

    pixels: Integer[np.ndarray, "n"]
    """Pixels of the image whose measured depth the pose explains, numbered row by row."""
    gains: Float[np.ndarray, "n"]
    """How well, up to 1; negative where hardly."""
    cost: float
    """Of the pixels that should show the surface and do not, in pixels."""
    going_on: float = 0.0
    """Share of the outline across which the measured surface goes on."""
    share: float = 0.0
    """How much of the surface is explained, 0..1; what is hidden counts half."""

    @property
    def quality(self) -> float:
        """By which gains and cost are weighted where poses compete: a good fit goes before a large surface."""
        return self.share**QUALITY

    @property
    def net(self) -> float:
        """Gains less cost."""
        return float(self.gains.sum()) - self.cost


NOTHING = Evidence(np.zeros(0, np.int64), np.zeros(0, np.float32), 0.0)


def gather(fit: DepthFit, poses: Float[np.ndarray, "n 4 4"], color_tolerance: float = 24.0) -> list[Evidence]:
    """Evidence of poses at all pixels of a fit, which must be made with step 1; what others explain is not left out."""
    centroid = (fit.model.vertices.min(axis=0) + fit.model.vertices.max(axis=0)) / 2
    boxes = [fit.box(pose[:3, :3] @ centroid + pose[:3, 3], 0.55 * fit.model.diameter) for pose in poses]
    rgb, of_faces = fit.base.image.rgb, face_colors(fit.model)
    if rgb is None:
        rgb, of_faces = np.zeros((*fit.depth.shape, 3), np.uint8), np.full_like(of_faces, NONE)
    colors = hues_and_values(rgb)
    found = []
    for pose, box in zip(poses, boxes, strict=True):
        if not box.area:
            found.append(NOTHING)
            continue
        hit = cast(fit.model, fit.camera, pose[None], [box], 0.0)[0]
        rows, columns = box.slices
        pixels, gains, cost, going_on, share = _gather(
            hit.depth, hit.normals, np.ascontiguousarray(pose[:3, :3]), fit.camera.K, box.x0, box.y0,
            fit.depth[rows, columns], fit.normals[rows, columns], fit.tolerance,
            colors[rows, columns], of_faces, hit.face_ids, color_tolerance / 2,
            LEAST_GAIN, HIDDEN_COST, ENDLESS, OTHER_COLOR, *BRIGHTNESS, max(REACH, 3 * fit.tolerance),
        )  # fmt: skip
        v, u = np.divmod(pixels, box.x1 - box.x0)
        found.append(Evidence((v + box.y0) * fit.camera.width + u + box.x0, gains, cost, going_on, share))
    return found


@per_model
def face_colors(model: Model) -> UInt8[np.ndarray, "f 2"]:
    """Hue (steps of two degrees) and value of each face's middle, NONE for models without colour."""
    if model.texture is not None and model.texture_uv is not None:
        height, width = model.texture.shape[:2]
        uv = model.texture_uv[model.faces].mean(axis=1) % 1.0
        colors = model.texture[((1 - uv[:, 1]) * (height - 1)).astype(int), (uv[:, 0] * (width - 1)).astype(int)]
    elif model.colors is not None:
        colors = model.colors[model.faces].mean(axis=1).astype(np.uint8)
    else:
        return np.full((len(model.faces), 2), NONE, np.uint8)
    return hues_and_values(np.ascontiguousarray(colors[None, :, :3]))[0]


def hues_and_values(rgb: UInt8[np.ndarray, "h w 3"]) -> UInt8[np.ndarray, "h w 2"]:
    """The hue of `channels.hues`, and the value of HSV."""
    return np.stack([channels.hues(rgb), rgb.max(axis=2)], axis=-1)


@compiled
@no_type_check
def _gather(
    rendered, rendered_normals, rotation, K, x0, y0, measured, measured_normals, tolerance, colors, of_faces,
    face_ids, hue_tolerance, least, hidden, endless, other, alike_until, other_from, reach,
):  # fmt: skip
    height, width = rendered.shape
    pixels, gains = np.empty(height * width, np.int64), np.empty(height * width, np.float32)
    n, outline, going_on = 0, 0, 0
    cost, explained, surface = 0.0, 0.0, 0.0
    normal, point = np.empty(3), np.empty(3)
    for v in range(height):
        for u in range(width):
            r, m = np.float64(rendered[v, u]), np.float64(measured[v, u])
            if not np.isfinite(r) or m <= 0:
                continue
            difference = (m - r) / tolerance
            surface += 1 if difference > -1 else 0.5
            if difference < -1:
                cost += hidden if difference < -2 else hidden * (-1 - difference)
                continue
            if difference > 1:
                cost += 1 if difference > 2 else difference - 1
                continue
            alike = 0.0
            for k in range(3):
                normal[k] = 0.0
                for j in range(3):
                    normal[k] += rotation[k, j] * rendered_normals[v, u, j]
                alike += normal[k] * measured_normals[v, u, k]
            pixels[n] = v * width + u
            gain = (1 - difference * difference) * (0.4 + 0.6 * alike * alike)
            hue, value = of_faces[face_ids[v, u], 0], of_faces[face_ids[v, u], 1]
            if hue != 255:
                apart = abs(np.int64(hue) - np.int64(colors[v, u, 0]))
                gain *= 1.0 if min(apart, 180 - apart) <= hue_tolerance else other
                octaves = abs(np.log2((colors[v, u, 1] + 8.0) / (value + 8.0)))
                strange = min(max((octaves - alike_until) / (other_from - alike_until), 0.0), 1.0)
                gain *= 1 - strange * (1 - other)
            gains[n] = gain
            explained += gain
            n += 1
            away = max(1, round(reach * K[0, 0] / r))
            point[0], point[1], point[2] = (u + x0 - K[0, 2]) / K[0, 0] * r, (v + y0 - K[1, 2]) / K[1, 1] * r, r
            for dv, du in ((0, 1), (1, 0), (0, -1), (-1, 0)):
                if not (0 <= v + dv < height and 0 <= u + du < width) or np.isfinite(rendered[v + dv, u + du]):
                    continue
                y, x = v + away * dv, u + away * du
                if not (0 <= y < height and 0 <= x < width) or np.isfinite(rendered[y, x]) or measured[y, x] <= 0:
                    continue
                outline += 1
                z = np.float64(measured[y, x])
                beside = normal[0] * ((x + x0 - K[0, 2]) / K[0, 0] * z - point[0])
                beside += normal[1] * ((y + y0 - K[1, 2]) / K[1, 1] * z - point[1]) + normal[2] * (z - r)
                alike = 0.0
                for k in range(3):
                    alike += normal[k] * measured_normals[y, x, k]
                going_on += abs(beside) < reach / 4 and alike > 0.9
    share = going_on / max(outline, 1)
    for i in range(n):
        gains[i] = (gains[i] * (1 - endless * share) - least) / (1 - least)
    return pixels[:n], gains[:n], cost, share, explained / max(surface, 1.0)
