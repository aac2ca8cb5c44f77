"""What the network should say of an image: object, fragment and 3D fragment coordinates of each cell.

Cells whose centre shows none of the objects are background (thesis sec. epos_network_training).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Float32, Int, Int32, UInt8

from pipeline.epos.fragments import Fragments
from pipeline.epos.grid import CELL_PX, grid_camera
from pipeline.rendering import Rendering, render_depths
from pipeline.scene import Camera, Model

BACKGROUND = -1
"""Instance id of pixels that show no annotated object."""


@dataclass(frozen=True, eq=False)
class LabelledImage:
    """An image that is known to the pixel."""

    rgb: UInt8[np.ndarray, "h w 3"]
    camera: Camera
    obj_ids: tuple[int, ...]
    """Object of each instance."""
    poses: Float[np.ndarray, "i 4 4"]
    """`camera_from_model` of each instance, metres."""
    instance_ids: Int32[np.ndarray, "h w"]
    """Instance that each pixel shows, -1 for what is none."""


@dataclass(frozen=True, eq=False)
class Targets:
    """The target of each cell of an image."""

    objects: Int[np.ndarray, "h w"]
    """0 for background, else 1 + position in the network's list of objects."""
    fragments: Int[np.ndarray, "h w"]
    """Fragment of that object; 0 in the background."""
    coordinates: Float32[np.ndarray, "h w 3"]
    """3D fragment coordinates; 0 in the background."""
    instances: Int[np.ndarray, "h w"]
    """Instance that the cell shows; -1 in the background."""


@dataclass(frozen=True, eq=False)
class KnownObject:
    """An object that the network is to learn."""

    model: Model
    fragments: Fragments


def make_targets(image: LabelledImage, objects: Sequence[KnownObject]) -> Targets:
    """Targets of an image; instances of objects that are not to be learned are background."""
    camera = grid_camera(image.camera)
    shape = (camera.height, camera.width)
    labels, coordinates = np.zeros(shape, np.int64), np.zeros((*shape, 3), np.float32)
    targets = Targets(labels, labels.copy(), coordinates, np.full(shape, BACKGROUND, np.int64))
    positions = {known.model.obj_id: i for i, known in enumerate(objects)}
    most = np.zeros(shape, np.int64)
    for instance, rendering in _renderings(image, camera, objects, positions).items():
        position = positions[image.obj_ids[instance]]
        pixels = shown_pixels(image.instance_ids, instance)[rendering.box.slices]
        seen = rendering.mask_crop & (pixels >= 2) & (pixels > most[rendering.box.slices])
        most[rendering.box.slices][seen] = pixels[seen]
        targets.instances[rendering.box.slices][seen] = instance
        _fill(targets, rendering, seen, position, objects[position])
    return targets


def _renderings(
    image: LabelledImage, camera: Camera, objects: Sequence[KnownObject], positions: Mapping[int, int]
) -> dict[int, Rendering]:
    """Each instance alone, at the centres of the cells, by its index; one call of the ray caster per object."""
    found: dict[int, Rendering] = {}
    for obj_id, position in positions.items():
        instances = [i for i, own in enumerate(image.obj_ids) if own == obj_id]
        if instances:
            model = objects[position].model
            rendered = render_depths(model, camera, image.poses[instances], pixel_center=0.0, with_surface=True)
            found.update(zip(instances, rendered, strict=True))
    return dict(sorted(found.items()))


def shown_pixels(instance_ids: Int32[np.ndarray, "h w"], instance: int) -> Int[np.ndarray, "r c"]:
    """How many of the four pixels about the centre of each cell show an instance; its centre lies between them."""
    rows, columns = (size // CELL_PX for size in instance_ids.shape)
    whole = instance_ids[: rows * CELL_PX, : columns * CELL_PX].reshape(rows, CELL_PX, columns, CELL_PX)
    middle = slice(CELL_PX // 2 - 1, CELL_PX // 2 + 1)
    return np.count_nonzero(whole[:, middle, :, middle] == instance, axis=(1, 3))


def _fill(
    targets: Targets, rendering: Rendering, seen: Bool[np.ndarray, "h w"], position: int, known: KnownObject
) -> None:
    """Write the targets of the cells that show an instance."""
    located = known.fragments.locate(surface_points(rendering, seen, known.model))
    targets.objects[rendering.box.slices][seen] = position + 1
    targets.fragments[rendering.box.slices][seen] = located.fragment_ids
    targets.coordinates[rendering.box.slices][seen] = located.coordinates


def surface_points(rendering: Rendering, seen: Bool[np.ndarray, "h w"], model: Model) -> Float[np.ndarray, "k 3"]:
    """Points of the model, in its frame, that pixels of a rendering with surface show; metres."""
    assert rendering.surface is not None
    corners = model.vertices[model.faces[rendering.surface.face_ids[seen]]]
    b, c = rendering.surface.barycentric[seen].astype(np.float64).T
    return np.einsum("kc,kcx->kx", np.stack([1.0 - b - c, b, c], axis=1), corners)
