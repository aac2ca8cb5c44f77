"""Templates that are taken from images of the objects, such as the `train` split of a BOP dataset.

In the thesis they come from "capturing the objects using a specialized setup" (sec. Object Detection): an object alone,
with pose, mask, colour and depth. Any split does whose images show objects wholly.
"""

import logging
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from pipeline.bop.dataset import Dataset
from pipeline.exceptions import FormatError, InputError
from pipeline.geometry import project, transform_points
from pipeline.hashmatch.captured_views import captured_view, rendered_mask
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.template_making import check_model, templates_of_views
from pipeline.hashmatch.template_source import PART, digest_of, parts_of
from pipeline.hashmatch.templates import Templates
from pipeline.hashmatch.viewpoints import in_plane_angles
from pipeline.hashmatch.views import View, centroid_of
from pipeline.scene import Camera, GroundTruth, ImageKey, Model

log = logging.getLogger(__name__)

LEAST_VISIBLE = 0.95
"""Visible fraction of an instance that becomes a template; where it is unknown, the instance has to be alone."""


class Sighting(NamedTuple):
    """An instance that becomes a template."""

    image: ImageKey
    truth: GroundTruth


@dataclass(frozen=True)
class CapturedTemplates:
    """See `TemplateSource`; raises InputError for objects that no image shows wholly, and for damaged images."""

    split: Dataset
    """Where the images are."""
    models: Mapping[int, Model]
    config: HashMatchConfig
    focal_px: float

    def digest(self, obj_id: int) -> str:
        """See `TemplateSource`. Of the images, sizes and times of change tell."""
        model = self.models[obj_id]
        check_model(model)
        seen = [(one.image, one.truth.index, self._files(one.image)) for one in self.sightings(obj_id)]
        poses = np.array([one.truth.camera_from_model for one in self.sightings(obj_id)])
        K = np.array([self.split.camera(one.image).K for one in self.sightings(obj_id)])
        return digest_of(model, self.config, self.focal_px, "captured", seen, poses, K)

    def parts(self, obj_id: int) -> list[int]:
        """See `TemplateSource`."""
        return parts_of(len(self.sightings(obj_id)), len(in_plane_angles(self.config)))

    def learn(self, obj_id: int, part: int) -> Templates:
        """See `TemplateSource`."""
        sightings = self.sightings(obj_id)[part * PART : (part + 1) * PART]
        found = [self._view(one) for one in sightings]
        views = [view for view in found if view.distance.any()]
        if not views:
            first = sightings[0].image
            text = f"no depth within the masks of object {obj_id}; check depth_scale and masks"
            raise FormatError(f"{self._name}: scene {first.scene_id}, image {first.im_id} and those behind it: {text}")
        return templates_of_views(self.models[obj_id], views, self.config, self.focal_px, colored=True)

    def sightings(self, obj_id: int) -> list[Sighting]:
        """Instances of an object that become templates, no two of nearly the same orientation."""
        chosen = self._thinned.get(obj_id)
        if not chosen:
            text = f"no image with colour and depth shows object {obj_id} alone and wholly"
            raise InputError(f"{self._name}: {text}; give another split, or leave out --templates to render them")
        return chosen

    @property
    def _name(self) -> str:
        return f"{self.split.name}/{self.split.split}"

    @cached_property
    def _thinned(self) -> dict[int, list[Sighting]]:
        found: dict[int, list[Sighting]] = {obj_id: [] for obj_id in self.models}
        for one in self._all():
            found[one.truth.obj_id].append(one)
        return {obj_id: different(sightings, self.config.angle_step_deg / 2) for obj_id, sightings in found.items()}

    def _all(self) -> Iterator[Sighting]:
        for key in self.split.images():
            if self.split.rgb_path(key) is None or self.split.depth_path(key) is None:
                continue
            try:
                truths, camera = self.split.ground_truth(key), self.split.camera(key)
            except InputError as error:
                log.warning("left out: %s", error)
                continue
            for truth in truths:
                alone = len(truths) == 1 if truth.visible_fraction is None else truth.visible_fraction >= LEAST_VISIBLE
                if alone and truth.obj_id in self.models and _inside(self.models[truth.obj_id], truth, camera):
                    yield Sighting(key, truth)

    def _files(self, key: ImageKey) -> list[tuple[int, int]]:
        paths = filter(None, (self.split.rgb_path(key), self.split.depth_path(key)))
        return [(path.stat().st_size, path.stat().st_mtime_ns) for path in paths]

    def _view(self, one: Sighting) -> View:
        image, model = self.split.image(one.image), self.models[one.truth.obj_id]
        mask = self.split.mask(one.image, one.truth.index)
        if mask is None:
            mask = rendered_mask(model, image, one.truth.camera_from_model)
        return captured_view(image, one.truth.camera_from_model, mask, model, self.focal_px)


def different(sightings: list[Sighting], angle_deg: float) -> list[Sighting]:
    """Leave out each one whose orientation differs by less than an angle from one that is kept."""
    rotations = np.array([one.truth.camera_from_model[:3, :3] for one in sightings]).reshape(-1, 9)
    most = 1 + 2 * np.cos(np.deg2rad(angle_deg))  # trace of the rotation between the two
    kept: list[int] = []
    for i, rotation in enumerate(rotations):
        if not kept or (rotations[kept] @ rotation).max() < most:
            kept.append(i)
    return [sightings[i] for i in kept]


def _inside(model: Model, truth: GroundTruth, camera: Camera) -> bool:
    """Whether a sphere that holds the object is before the camera and inside the image."""
    x, y, z = transform_points(truth.camera_from_model, centroid_of(model)[None])[0]
    radius = float(np.linalg.norm(model.vertices - centroid_of(model), axis=1).max())
    if z <= radius:
        return False
    u, v = project(camera.K, np.array([x, y, z]))
    reach = radius / np.sqrt(z**2 - radius**2)
    near = np.array([u - reach * camera.K[0, 0], v - reach * camera.K[1, 1]])
    far = np.array([u + reach * camera.K[0, 0], v + reach * camera.K[1, 1]])
    return bool((near >= -0.5).all() and (far <= np.array([camera.width, camera.height]) - 0.5).all())
