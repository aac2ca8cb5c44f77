"""Whether the images of a scene agree on where its objects are, through the world poses of their cameras.

Annotations of one object in several images are put into the world frame and gathered by place: an object that rests
there in two images or more is taken to have been there. One that was moved between images, as those of LM-O were, has
several such places. An annotation that no other image shares is either wrong or of an object that stood there for one
image only; `annotate.quality.audit` decides by what was measured in that image, where it can.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from pipeline.geometry import inverse
from pipeline.model_cache import convex_hull, per_model
from pipeline.scene import ImageKey, Model

Verdict = Literal["agrees", "moved", "wrong", "alone"]
"""`agrees` with the place where most images see it; `moved`: it was at another place in this image; `wrong`: other
images tell where it is, and the measurements bear them out; `alone`: no other image shares the place, and nothing tells
which is right."""

TOLERANCE = 0.1
"""Of the diameter ..."""
LEAST_TOLERANCE = 0.005
"""... but at least so many metres: poses that are no farther apart are of one place."""
HULL_POINTS = 40
"""Points of the convex hull by which poses are compared."""
FEW = 15
"""Poses of one place that are all compared with each other."""
MOST_SYMMETRIES = 64
"""Steps of continuous symmetries that are compared."""


@dataclass(frozen=True, eq=False)
class Sighting:
    """An annotation in the world frame of its scene."""

    key: ImageKey
    index: int
    obj_id: int
    world_from_model: Float[np.ndarray, "4 4"]
    world_from_camera: Float[np.ndarray, "4 4"]


@dataclass(frozen=True, eq=False)
class Agreement:
    """One annotation against those of the same object in other images of its scene."""

    key: ImageKey
    index: int
    obj_id: int
    images: int
    """Other images that put the object at the same place."""
    distance: float
    """Metres: how far the farthest point of the object lies from where those images have it; where no image shares the
    place, from the place that is nearest. Modulo symmetry."""
    verdict: Verdict
    expected: Float[np.ndarray, "4 4"] | None
    """camera_from_model by the place where most images see the object, if that is another; else None."""


def agreements(sightings: Sequence[Sighting], model: Model) -> list[Agreement]:
    """Compare the annotations of one object in one scene; none where fewer than two images show it."""
    if len({sighting.key for sighting in sightings}) < 2:
        return []
    places = _places(sightings, model)
    poses = np.stack([sighting.world_from_model for sighting in sightings])
    usual = [_medoid(poses[members], model) for members in places]
    found = []
    for place, main in enumerate(_tracks(places, sightings)):
        for member in places[place]:
            others = [i for i in places[place] if i != member]
            few = 0 < len(others) < FEW  # of many, it does not matter whether one's own is among them
            compared = _medoid(poses[others], model) if few else usual[place] if others else usual[main]
            expected = usual[main] if place != main and len(places[main]) > 1 else None
            found.append(_agreement(sightings[member], model, len(others), compared, expected, is_main=place == main))
    return found


def pose_distance(
    model: Model, poses_a: Float[np.ndarray, "n 4 4"], pose_b: Float[np.ndarray, "4 4"]
) -> Float[np.ndarray, "n"]:
    """Metres by which the object's farthest point differs between poses, modulo the model's symmetries (as MSSD does).

    Over some points of the convex hull, and steps of continuous symmetries.
    """
    points = _points(model)
    turned = np.einsum("sij,pj->spi", pose_b[:3, :3] @ _symmetries(model)[:, :3, :3], points)
    turned += (pose_b[:3, :3] @ _symmetries(model)[:, :3, 3:])[:, None, :, 0] + pose_b[:3, 3]
    placed = np.einsum("nij,pj->npi", poses_a[:, :3, :3], points) + poses_a[:, None, :3, 3]
    return np.array([np.linalg.norm(turned - one, axis=-1).max(axis=1).min() for one in placed])


@per_model
def _points(model: Model) -> Float[np.ndarray, "p 3"]:
    hull = model.vertices[convex_hull(model)]
    return hull[np.linspace(0, len(hull) - 1, min(HULL_POINTS, len(hull))).astype(int)]


@per_model
def _symmetries(model: Model) -> Float[np.ndarray, "s 4 4"]:
    count = len(model.symmetries)
    return model.symmetries[np.linspace(0, count - 1, min(count, MOST_SYMMETRIES)).astype(int)]


def tolerance(model: Model) -> float:
    """Metres within which poses are of one place."""
    return max(TOLERANCE * model.diameter, LEAST_TOLERANCE)


def _places(sightings: Sequence[Sighting], model: Model) -> list[list[int]]:
    """Positions of the sightings by place, largest first; no place holds two of one image."""
    limit = tolerance(model)
    founders: list[np.ndarray] = []
    places: list[list[int]] = []
    for position, sighting in enumerate(sightings):
        near = pose_distance(model, np.stack(founders), sighting.world_from_model) if founders else np.empty(0)
        order = [k for k in np.argsort(near) if near[k] <= limit]
        free = next((k for k in order if sightings[places[k][-1]].key != sighting.key), None)
        if free is None:
            founders.append(sighting.world_from_model)
            places.append([position])
        else:
            places[free].append(position)
    return sorted(places, key=len, reverse=True)


def _tracks(places: list[list[int]], sightings: Sequence[Sighting]) -> list[int]:
    """For each place, that of most images which the same instance may have been at.

    Places that one image shares are of different instances. Those that remain without images in common are put
    together, the nearest by position first: an instance that was moved, or one that is wrong in some image.
    """
    main = list(range(len(places)))
    images = [{sightings[i].key for i in members} for members in places]
    centres = [np.median([sightings[i].world_from_model[:3, 3] for i in members], axis=0) for members in places]
    for place in range(1, len(places)):
        free = [k for k in range(place) if main[k] == k and not images[k] & images[place]]
        if free:
            nearest = min(free, key=lambda k: float(np.linalg.norm(centres[k] - centres[place])))
            main[place] = nearest
            images[nearest] = images[nearest] | images[place]
    return main


def _agreement(
    own: Sighting,
    model: Model,
    images: int,
    compared: Float[np.ndarray, "4 4"],
    expected: Float[np.ndarray, "4 4"] | None,
    *,
    is_main: bool,
) -> Agreement:
    """What is said of one annotation, for which `compared` and `expected` are poses in the world frame."""
    if is_main and not images:
        return Agreement(own.key, own.index, own.obj_id, 0, float("nan"), "alone", None)
    distance = float(pose_distance(model, compared[None], own.world_from_model)[0])
    verdict: Verdict = "agrees" if is_main else "moved" if images else "alone"
    in_camera = None if expected is None else inverse(own.world_from_camera) @ expected
    return Agreement(own.key, own.index, own.obj_id, images, distance, verdict, in_camera)


def _medoid(poses: Float[np.ndarray, "n 4 4"], model: Model) -> Float[np.ndarray, "4 4"]:
    """The pose that is nearest to all others; of many, of some that are spread evenly."""
    chosen = poses[np.linspace(0, len(poses) - 1, min(FEW, len(poses))).astype(int)]
    return chosen[int(np.argmin([pose_distance(model, chosen, pose).sum() for pose in chosen]))]
