"""Putting drawn objects before each other and before a background; the image with its annotations."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int32, UInt8

from pipeline.rendering import Rendering, SceneRendering
from pipeline.scene import Camera, GroundTruth
from pipeline.synth.render_and_paste.rasterizer import Drawing
from pipeline.synth.render_and_paste.shaders import BRIGHTEST

SHOULDER = 0.75
"""Linear light above which highlights are compressed, so that they do not burn out at once."""


@dataclass(frozen=True, eq=False)
class PastedImage:
    """A training image and what it shows, exact to the pixel: pixel (c, r) tells of the point (c, r) of the image.

    Masks and depth are those of the drawing itself. Blur and noise of the augmentation, and the smoothed outlines, mix
    colours of neighbouring pixels, as any camera does, but move nothing.
    """

    rgb: UInt8[np.ndarray, "h w 3"]
    camera: Camera
    rendering: SceneRendering
    """Depth, the instance that each pixel shows, and each object alone."""
    ground_truth: tuple[GroundTruth, ...]
    """One per instance, in the order of the instance ids, with visible fraction, pixels and box."""
    seconds: Mapping[str, float] = field(default_factory=dict)
    """Time of each stage: poses, drawing, background, pasting, annotating, augmentation."""

    @property
    def depth(self) -> Float32[np.ndarray, "h w"]:
        """Metres along z, 0 where the background is seen."""
        return self.rendering.depth

    @property
    def instance_ids(self) -> Int32[np.ndarray, "h w"]:
        """Position in `ground_truth` of the object that each pixel shows, -1 for the background."""
        return self.rendering.instance_ids

    @property
    def masks(self) -> tuple[Bool[np.ndarray, "h w"], ...]:
        """Silhouette of each object inside the image, as if nothing stood before it (new arrays each time)."""
        return tuple(alone.mask for alone in self.rendering.renderings)

    @property
    def visible_masks(self) -> tuple[Bool[np.ndarray, "h w"], ...]:
        """What is seen of each object (new arrays each time)."""
        return tuple(self.rendering.instance_ids == i for i in range(len(self.ground_truth)))


def merge(drawings: Sequence[Drawing], camera: Camera) -> SceneRendering:
    """Put the nearest object before the others at each pixel."""
    shape = (camera.height, camera.width)
    depth = np.zeros(shape, np.float32)
    ids = np.full(shape, -1, np.int32)
    for i, drawing in enumerate(drawings):
        behind = depth[drawing.box.slices]  # a view: written through below
        nearer = (drawing.depth > 0) & ((behind == 0) | (drawing.depth < behind))
        behind[nearer] = drawing.depth[nearer]
        ids[drawing.box.slices][nearer] = i
    return SceneRendering(depth, ids, tuple(Rendering(d.box, d.depth, shape) for d in drawings))


def paste(
    background: UInt8[np.ndarray, "h w 3"], drawings: Sequence[Drawing], scene: SceneRendering, edge_blur: float
) -> UInt8[np.ndarray, "h w 3"]:
    """Paint the objects over a copy of the background; `edge_blur` pixels smooth the outlines."""
    rgb = background.copy()
    for i, drawing in enumerate(drawings):
        seen = scene.instance_ids[drawing.box.slices] == i
        rgb[drawing.box.slices][seen] = _tone_curve()[drawing.light[seen][:, :3]]
    if edge_blur and drawings:
        blurred = cv2.GaussianBlur(rgb, (0, 0), edge_blur)
        cv2.copyTo(blurred, _outlines(scene.instance_ids), rgb)
    return rgb


def _outlines(ids: Int32[np.ndarray, "h w"]) -> UInt8[np.ndarray, "h w"]:
    """Pixels beside one (left, right, above, below) that shows another thing, as 255."""
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    some = (ids + 1).astype(np.uint16)
    return (cv2.morphologyEx(some, cv2.MORPH_GRADIENT, cross) > 0).astype(np.uint8) * np.uint8(255)


@cache
def _tone_curve() -> UInt8[np.ndarray, "65536"]:
    """8-bit sRGB (gamma 2.2) of each 16-bit value of linear light."""
    linear: Float[np.ndarray, 65536] = np.arange(65536) * (BRIGHTEST / 65535.0)
    room = 1.0 - SHOULDER
    bent = SHOULDER + room * (1.0 - np.exp(-np.maximum(linear - SHOULDER, 0.0) / room))
    return np.rint(np.where(linear < SHOULDER, linear, bent) ** (1 / 2.2) * 255).astype(np.uint8)
