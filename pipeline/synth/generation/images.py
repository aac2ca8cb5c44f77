"""A synthetic image with its annotations, and what is kept of it until the files of its scene are written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float, Float32, UInt8

from pipeline.bop.coco.annotations import CocoImage, coco_instance
from pipeline.bop.gt_info.image import ImageRecord
from pipeline.bop.gt_info.views import InstanceView, exact_instances
from pipeline.bop.writer import camera_entry, ground_truth_entry
from pipeline.rendering import SceneRendering
from pipeline.scene import Camera, GroundTruth, Model

PIXEL_CENTER = 0.0
"""Pixel (c, r) shows what lies at the image point (c, r): colour, depth and masks agree to the pixel."""


@dataclass(frozen=True, eq=False)
class SyntheticImage:
    """What one image shows, and what is known of it."""

    camera: Camera
    rgb: UInt8[np.ndarray, "h w 3"]
    depth: Float32[np.ndarray, "h w"]
    """As measured: metres, 0 where not."""
    objects: Sequence[tuple[Model, Float[np.ndarray, "4 4"]]]
    """Models and `camera_from_model` of those to be annotated, whether in the image or not."""
    rendering: SceneRendering
    """Exact geometry of these objects, in their order, and after them of whatever else there is."""
    seconds: Mapping[str, float]
    """What the stages took."""

    def annotated(self) -> tuple[tuple[GroundTruth, ...], tuple[InstanceView, ...]]:
        """Ground truth of the objects whose silhouette has a pixel in the image, and how each is seen."""
        views = exact_instances(self.objects, self.camera, self.rendering, self.depth, PIXEL_CENTER)
        seen = [i for i, view in enumerate(views) if view.rendering.mask_crop.any()]
        truths = [
            GroundTruth(self.objects[i][0].obj_id, self.objects[i][1], k, views[i].info.visib_fract)
            for k, i in enumerate(seen)
        ]
        return tuple(truths), tuple(views[i] for i in seen)


@runtime_checkable
class ImageSet(Protocol):
    """Images that are made at one go, because they share what is costly to set up."""

    def image(self, index: int) -> SyntheticImage:
        """The image of that position in the set; the same one whenever it is asked for."""
        ...


@dataclass(frozen=True)
class SyntheticRecord:
    """What the scene's JSON files say of an image."""

    im_id: int
    camera: dict[str, Any]
    """Entry of scene_camera.json."""
    ground_truth: list[dict[str, Any]]
    """Entries of scene_gt.json."""
    information: ImageRecord
    """For scene_gt_info.json and scene_gt_coco.json."""
    seconds: dict[str, float]

    @staticmethod
    def of(
        im_id: int,
        image: SyntheticImage,
        truths: Sequence[GroundTruth],
        views: Sequence[InstanceView],
        file_name: str,
        depth_scale_mm: float,
    ) -> SyntheticRecord:
        """The record of an image whose colours are in the file of that name (path from the scene's folder)."""
        instances = tuple(
            coco_instance(truth.obj_id, view.info.visib_fract, view.mask, view.visible_mask)
            for truth, view in zip(truths, views, strict=True)
        )
        coco = CocoImage(im_id, file_name, image.camera.width, image.camera.height, instances)
        return SyntheticRecord(
            im_id,
            camera_entry(image.camera, depth_scale_mm),
            [ground_truth_entry(truth) for truth in truths],
            ImageRecord(im_id, tuple(view.info for view in views), coco),
            {name: round(value, 4) for name, value in image.seconds.items()},
        )

    @staticmethod
    def from_json(content: dict[str, Any]) -> SyntheticRecord:
        """The record that was written as JSON."""
        content["information"] = ImageRecord.from_json(content["information"])
        return SyntheticRecord(**content)
