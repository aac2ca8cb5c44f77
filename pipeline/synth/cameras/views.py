"""A chosen view, and the annotations that it gives."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int32

from pipeline.geometry import inverse, transform
from pipeline.rendering import SceneRendering, render_scene
from pipeline.scene import Camera, GroundTruth, Model
from pipeline.synth.cameras.visibility import silhouette_pixels
from pipeline.synth.worlds.world import World


@dataclass(frozen=True, eq=False)
class View:
    """What a camera sees of a world with objects; all poses are as the dataset's files will tell them."""

    camera: Camera
    """With `world_from_camera`."""
    focus: int
    """Position, in the list of objects, of the one that the camera points at."""
    visible_fraction: float
    """Of the focused object, 0..1; what is outside the image is hidden."""
    tries: int
    """Cameras that were sampled, this one counted."""
    camera_from_models: tuple[Float[np.ndarray, "4 4"], ...]
    """Of each object."""
    rendering: SceneRendering
    """Exact geometry of the objects, in their order, and of the world after them."""

    @property
    def world_from_camera(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the camera."""
        assert self.camera.world_from_camera is not None
        return self.camera.world_from_camera

    @property
    def camera_from_world(self) -> Float[np.ndarray, "4 4"]:
        """Inverse pose of the camera."""
        return inverse(self.world_from_camera)

    @property
    def object_ids(self) -> Int32[np.ndarray, "h w"]:
        """Position of the object that each pixel shows, -1 for the world and for nothing."""
        ids = self.rendering.instance_ids
        return np.where(ids == len(self.camera_from_models), np.int32(-1), ids)


@dataclass(frozen=True, eq=False)
class ViewAnnotations:
    """The annotated objects of a view: those whose silhouette lies in the image, at least in part."""

    objects: tuple[int, ...]
    """Position of each in the list of objects."""
    ground_truth: tuple[GroundTruth, ...]
    masks: tuple[Bool[np.ndarray, "h w"], ...]
    """Full silhouettes, as if nothing stood before them, inside the image."""
    visible_masks: tuple[Bool[np.ndarray, "h w"], ...]


def render_view(
    world: World,
    models: Sequence[Model],
    world_from_models: Sequence[Float[np.ndarray, "4 4"]],
    camera: Camera,
    focus: int,
    tries: int = 1,
) -> View:
    """Render what a camera with `world_from_camera` sees; the pose is rounded first, see `rounded_pose`."""
    assert camera.world_from_camera is not None
    camera_from_world = rounded_pose(inverse(camera.world_from_camera))
    camera = replace(camera, world_from_camera=inverse(camera_from_world))
    poses = tuple(rounded_pose(camera_from_world @ pose) for pose in world_from_models)
    things = [*zip(models, poses, strict=True), (world.model, camera_from_world)]
    rendering = render_scene(things, camera, pixel_center=0.0)
    count = silhouette_pixels(things[focus], camera, rendering.renderings[focus])
    visible = int(np.count_nonzero(rendering.instance_ids == focus))
    return View(camera, focus, visible / count if count else 0.0, tries, poses, rendering)


def annotate_view(view: View, models: Sequence[Model]) -> ViewAnnotations:
    """Describe every object of a view whose silhouette has a pixel in the image, hidden or not.

    Visible fractions and masks are exact, by the ids of what the rays met. `models` are those of the view, or the first
    of them: the rest are not annotated then.
    """
    alone = view.rendering.renderings
    seen = tuple(i for i in range(len(models)) if alone[i].mask_crop.any())
    visible_masks = tuple(view.rendering.instance_ids == i for i in seen)
    truths = tuple(_ground_truth(view, models[i], i, k, visible_masks[k]) for k, i in enumerate(seen))
    return ViewAnnotations(seen, truths, tuple(alone[i].mask for i in seen), visible_masks)


def _ground_truth(view: View, model: Model, position: int, index: int, visible: Bool[np.ndarray, "h w"]) -> GroundTruth:
    pose = view.camera_from_models[position]
    count = silhouette_pixels((model, pose), view.camera, view.rendering.renderings[position])
    pixels = int(np.count_nonzero(visible))
    return GroundTruth(model.obj_id, pose, index, visible_fraction=pixels / count, visible_pixels=pixels)


def rounded_pose(pose: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "4 4"]:
    """The pose as it is stored: rotation to 10 decimals, translation to a nanometre, so that files stay short.

    Masks and depth are rendered from what is stored.
    """
    return transform(np.round(pose[:3, :3], 10), np.round(pose[:3, 3], 9))
