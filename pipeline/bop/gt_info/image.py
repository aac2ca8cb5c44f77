"""Making the ground-truth information of one image: what a worker does. Reads files, writes none."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Bool, Float

from pipeline.bop.coco.annotations import CocoImage, CocoInstance, coco_instance
from pipeline.bop.dataset import Dataset
from pipeline.bop.gt_info.plan import Kind
from pipeline.bop.gt_info.views import GtInfo, InstanceView, view_instances
from pipeline.bop.images import read_depth, read_mask
from pipeline.bop.models import read_model
from pipeline.exceptions import FormatError
from pipeline.scene import Camera, GroundTruth, ImageKey, Model


@dataclass(frozen=True, eq=False)
class Recipe:
    """What all images of a run have in common."""

    kinds: frozenset[Kind]
    delta: float
    """Tolerance of the visibility test, metres."""
    models: Mapping[int, Path]
    """Model files by object id."""


@dataclass(frozen=True, eq=False)
class ImageTask:
    """One image to be looked at."""

    scene: int
    """Number of the scene in the plan."""
    im_id: int
    file_name: str
    """Of the image, from the scene's folder."""
    camera: Camera
    truths: tuple[GroundTruth, ...]
    depth_path: Path | None
    depth_scale_mm: float
    masks: tuple[tuple[Path, Path] | None, ...]
    """Full and visible mask of each annotation, where they exist and shall stay."""


@dataclass(frozen=True)
class ImageRecord:
    """What is kept of an image until the files of its scene can be written."""

    im_id: int
    infos: tuple[GtInfo, ...]
    coco: CocoImage | None
    """Only when asked for."""

    @staticmethod
    def from_json(content: dict[str, Any]) -> "ImageRecord":
        """The record that was written as JSON."""
        infos = tuple(GtInfo(**_with_tuples(entry)) for entry in content["infos"])
        coco = content["coco"]
        if coco is not None:
            instances = tuple(CocoInstance(**_with_tuples(entry)) for entry in coco.pop("instances"))
            coco = CocoImage(**coco, instances=instances)
        return ImageRecord(content["im_id"], infos, coco)


@dataclass(frozen=True, eq=False)
class MadeImage:
    """All that is made of an image; masks are PNG files, in the order of the annotations, or absent when not asked for."""

    scene: int
    """Number of the scene in the plan."""
    record: ImageRecord
    masks: tuple[bytes, ...]
    visible_masks: tuple[bytes, ...]


def image_task(
    dataset: Dataset, key: ImageKey, folder: Path, scene: int, masks: tuple[tuple[Path, Path] | None, ...]
) -> ImageTask:
    """Put together what a worker needs of an image of the scene in `folder`."""
    depth_path = dataset.depth_path(key)
    shown = dataset.rgb_path(key) or depth_path
    return ImageTask(
        scene=scene,
        im_id=key.im_id,
        file_name=shown.relative_to(folder).as_posix() if shown else f"rgb/{key.im_id:06d}.png",
        camera=dataset.camera(key),
        truths=dataset.ground_truth(key),
        depth_path=depth_path,
        depth_scale_mm=dataset.depth_scale_mm(key),
        masks=masks,
    )


def make_image(recipe: Recipe, task: ImageTask) -> MadeImage:
    """Render the annotated instances of an image and describe what of them is visible.

    Raises FormatError or MissingFileError for a damaged model or depth image.
    """
    pairs = [(_model(recipe.models[truth.obj_id], truth.obj_id), truth.camera_from_model) for truth in task.truths]
    views = view_instances(pairs, task.camera, _depth(task), recipe.delta)
    coco = _coco_image(recipe, task, views) if recipe.kinds & {"coco", "coco-modal"} else None
    record = ImageRecord(task.im_id, tuple(view.info for view in views), coco)
    if "masks" not in recipe.kinds:
        return MadeImage(task.scene, record, (), ())
    masks, visible_masks = (view.mask for view in views), (view.visible_mask for view in views)
    return MadeImage(task.scene, record, tuple(map(_png, masks)), tuple(map(_png, visible_masks)))


@lru_cache(maxsize=128)
def _model(path: Path, obj_id: int) -> Model:
    return read_model(path, obj_id, {"diameter": 1.0}, appearance=False)  # a silhouette does not depend on it


def _depth(task: ImageTask) -> Float[np.ndarray, "h w"] | None:
    if task.depth_path is None:
        return None
    depth = read_depth(task.depth_path, task.depth_scale_mm)
    _check_size(task, task.depth_path, depth)
    return depth


def _check_size(task: ImageTask, path: Path, pixels: np.ndarray) -> None:
    (height, width), camera = pixels.shape, task.camera
    if (width, height) != (camera.width, camera.height):
        raise FormatError(f"{path}: has {width} x {height} pixels, its image {camera.width} x {camera.height}; mend it")


def _coco_image(recipe: Recipe, task: ImageTask, views: list[InstanceView]) -> CocoImage:
    """Masks and visible fractions that exist already and are not made anew are taken, so that all files agree."""
    instances = []
    for truth, view, paths in zip(task.truths, views, task.masks, strict=True):
        known = None if "info" in recipe.kinds else truth.visible_fraction
        fraction = view.info.visib_fract if known is None else known
        mask, visible_mask = _masks(task, view, paths)
        instances.append(coco_instance(truth.obj_id, fraction, mask, visible_mask))
    return CocoImage(task.im_id, task.file_name, task.camera.width, task.camera.height, tuple(instances))


def _masks(
    task: ImageTask, view: InstanceView, paths: tuple[Path, Path] | None
) -> tuple[Bool[np.ndarray, "h w"], Bool[np.ndarray, "h w"]]:
    if paths is None:
        return view.mask, view.visible_mask
    full, visible = map(read_mask, paths)
    _check_size(task, paths[0], full)
    _check_size(task, paths[1], visible)
    return full, visible


def _png(mask: Bool[np.ndarray, "h w"]) -> bytes:
    # Of all settings tried among the fastest, and nearly the smallest files for masks.
    settings = (
        cv2.IMWRITE_PNG_STRATEGY,
        cv2.IMWRITE_PNG_STRATEGY_RLE,
        cv2.IMWRITE_PNG_FILTER,
        cv2.IMWRITE_PNG_FILTER_NONE,
    )
    return cv2.imencode(".png", mask.astype(np.uint8) * 255, settings)[1].tobytes()


def _with_tuples(entry: dict[str, Any]) -> dict[str, Any]:
    """Lists of JSON become tuples again."""
    return {name: tuple(value) if isinstance(value, list) else value for name, value in entry.items()}
