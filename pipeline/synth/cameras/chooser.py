"""Choosing cameras: sampled about a random object until one has room to stand and sees enough of it."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import isfinite

import numpy as np
from jaxtyping import Float

from pipeline.geometry import inverse, transform_points
from pipeline.ray_casting import _raycaster  # one acceleration structure per model serves rendering and distances
from pipeline.scene import Camera, Model
from pipeline.synth.cameras.errors import CameraSettingsError, NoViewError
from pipeline.synth.cameras.ranges import CameraRanges, sample_view
from pipeline.synth.cameras.views import View, render_view
from pipeline.synth.cameras.visibility import visible_fraction
from pipeline.synth.worlds.world import World


@dataclass(frozen=True)
class ViewRules:
    """What a view must keep to. Raises CameraSettingsError for what cannot be kept."""

    min_visible: float = 0.3
    """Share of the focused object that must be visible (thesis sec. synth_composition)."""
    clearance: float = 0.1
    """Metres that the camera keeps from every surface: it has a body, and what is nearer would fill the image."""
    max_tries: int = 1000
    """Cameras that are sampled before giving up."""

    def __post_init__(self) -> None:
        """Check the values."""
        if not 0 <= self.min_visible <= 1:
            raise CameraSettingsError(f"min_visible {self.min_visible:g}: not a share; give 0 to 1, such as 0.3")
        if not (isfinite(self.clearance) and self.clearance >= 0):
            raise CameraSettingsError(f"clearance {self.clearance:g}: not a distance; give metres, such as 0.1")
        if self.max_tries < 1:
            raise CameraSettingsError(f"max_tries {self.max_tries}: no try at all; give 1 or more")


class ViewChooser:
    """Chooses views of one arrangement; what is costly is computed once."""

    def __init__(
        self,
        world: World,
        models: Sequence[Model],
        world_from_models: Sequence[Float[np.ndarray, "4 4"]],
        rules: ViewRules | None = None,
        focusable: int | None = None,
    ) -> None:
        """Hold an arrangement; cameras point at its first `focusable` objects only, by default at all."""
        self._world = world
        self._focusable = len(models) if focusable is None else focusable
        self._models = tuple(models)
        self._poses = tuple(world_from_models)
        self._rules = rules or ViewRules()
        pairs = list(zip(self._models, self._poses, strict=True))
        self._centres = np.array([transform_points(pose, _centre(model)) for model, pose in pairs]).reshape(-1, 3)
        self._radii = np.array([_radius(model) for model in self._models])

    def choose(self, intrinsics: Camera, ranges: CameraRanges, rng: np.random.Generator) -> View:
        """Sample cameras until one keeps the rules (thesis sec. synth_composition).

        Each try picks one of the objects at random and points the camera at the centre of its bounding box; azimuth
        and elevation are those in the world frame. The camera must be inside the room, away from all surfaces, and
        see enough of the object. Rules that are cheap to check come first; the whole image is rendered for the view
        that is taken only. The same `rng` state gives the same view. Raises NoViewError.
        """
        failed: Counter[str] = Counter()
        if not self._focusable:
            raise NoViewError(f"world {self._world.name}", failed, "there is no object to look at, arrange one")
        for tries in range(1, self._rules.max_tries + 1):
            focus = int(rng.integers(self._focusable))
            world_from_camera = sample_view(ranges, self._centres[focus], rng)
            reason = self._failure(intrinsics, world_from_camera, focus)
            if reason is None:
                camera = replace(intrinsics, world_from_camera=world_from_camera)
                view = render_view(self._world, self._models, self._poses, camera, focus, tries)
                if view.visible_fraction >= self._rules.min_visible:  # the pose was rounded in between
                    return view
                reason = self._too_little
            failed[reason] += 1
        raise NoViewError(f"world {self._world.name}", failed, self._advice(failed.most_common(1)[0][0], ranges))

    @property
    def _too_little(self) -> str:
        return f"with less than {100 * self._rules.min_visible:g} % of the object visible"

    @property
    def _too_near(self) -> str:
        return f"nearer than {self._rules.clearance:g} m to a surface"

    def _failure(self, intrinsics: Camera, world_from_camera: Float[np.ndarray, "4 4"], focus: int) -> str | None:
        """The first rule that the camera breaks, None if it keeps all."""
        eye = world_from_camera[:3, 3]
        if (eye < self._world.room[0]).any() or (eye > self._world.room[1]).any():
            return OUTSIDE
        if not self._has_room(eye):
            return self._too_near
        camera_from_world = inverse(world_from_camera)
        things = [(model, camera_from_world @ pose) for model, pose in zip(self._models, self._poses, strict=True)]
        fraction = visible_fraction([*things, (self._world.model, camera_from_world)], focus, intrinsics)
        if fraction == 0 and self._rules.min_visible > 0:
            return HIDDEN
        return self._too_little if fraction < self._rules.min_visible else None

    def _has_room(self, eye: Float[np.ndarray, "3"]) -> bool:
        if self._world.clearance(eye[None])[0] < self._rules.clearance:
            return False
        reach = np.linalg.norm(self._centres - eye, axis=1) - self._radii
        near = np.flatnonzero(reach < self._rules.clearance)
        return all(_distance(self._models[i], self._poses[i], eye) >= self._rules.clearance for i in near)

    def _advice(self, reason: str, ranges: CameraRanges) -> str:
        """What to change if most tries failed for this reason."""
        distance = "distance (now {:g} to {:g} m)".format(*ranges.distance)
        azimuth = "azimuth_deg (now {:g} to {:g})".format(*ranges.azimuth_deg)
        elevation = "elevation_deg (now {:g} to {:g})".format(*ranges.elevation_deg)
        return {
            OUTSIDE: f"shorten {distance}, or change {azimuth} and {elevation}",
            self._too_near: f"change {distance} and {elevation}, or lower the clearance",
            HIDDEN: f"change {azimuth} and {elevation}, or take another stage",
            self._too_little: f"change {azimuth}, {elevation} and {distance}, or lower min_visible",
        }[reason]


OUTSIDE = "outside the room"
HIDDEN = "with the object hidden"


def choose_view(
    world: World,
    models: Sequence[Model],
    world_from_models: Sequence[Float[np.ndarray, "4 4"]],
    intrinsics: Camera,
    ranges: CameraRanges,
    rng: np.random.Generator,
    min_visible: float = 0.3,
    max_tries: int = 1000,
) -> View:
    """One view of an arrangement; for several of the same one make a `ViewChooser`, which see."""
    rules = ViewRules(min_visible=min_visible, max_tries=max_tries)
    return ViewChooser(world, models, world_from_models, rules).choose(intrinsics, ranges, rng)


def _centre(model: Model) -> Float[np.ndarray, "3"]:
    """Of the bounding box, model frame."""
    return (model.vertices.min(axis=0) + model.vertices.max(axis=0)) / 2


def _radius(model: Model) -> float:
    """Of the sphere about the centre that holds the model."""
    return float(np.linalg.norm(model.vertices - _centre(model), axis=1).max())


def _distance(model: Model, world_from_model: Float[np.ndarray, "4 4"], point: Float[np.ndarray, "3"]) -> float:
    """Metres from a point of the world to the surface of a model."""
    from open3d.core import Tensor

    in_model = transform_points(inverse(world_from_model), point)[None].astype(np.float32)
    return float(_raycaster(model).compute_distance(Tensor.from_numpy(in_model)).numpy()[0])
