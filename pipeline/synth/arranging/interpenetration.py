"""How deep meshes reach into each other: points of the one's surface, signed distances to the other's.

It knows nothing of the simulation and its convex pieces. Points are all vertices and some on larger triangles,
about `SPACING` apart. Inside is where a ray leaves a mesh through an odd number of faces; for meshes that are not
watertight, where most of seven rays do. Of the world, whose walls and papers have no inside, the back of the nearest
face counts as inside.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from pipeline.geometry import inverse, transform_points
from pipeline.model_cache import per_model
from pipeline.ray_casting import _raycaster
from pipeline.scene import Model
from pipeline.synth.arranging.arrangement import MAX_OVERLAP
from pipeline.synth.arranging.convex_pieces import extremes, signed_distance
from pipeline.synth.arranging.crossings import Posed, separation
from pipeline.synth.arranging.soup import Soup, split
from pipeline.synth.worlds.world import World

SPACING = 0.002
"""Metres."""


class Overlap(NamedTuple):
    """The deepest interpenetration of some bodies."""

    depth: float = 0.0
    """Metres; 0 for none."""
    between: str = ""


def deepest_overlap(world: World, objects: Sequence[Posed]) -> Overlap:
    """The deepest interpenetration of objects with each other and with the world."""
    boxes = [_box(*item) for item in objects]
    found = [Overlap()]
    for (first, box_a), (second, box_b) in combinations(zip(objects, boxes, strict=True), 2):
        if (box_a[0] <= box_b[1]).all() and (box_b[0] <= box_a[1]).all():
            depth = _depth_between(first, second)
            found.append(Overlap(depth, f"objects {first[0].obj_id} and {second[0].obj_id}"))
    nearby = _nearby(world, boxes)
    for item, box in zip(objects, boxes, strict=True):
        depth = max(_depth_behind(nearby, item), _depth_of_surface(nearby, item, box))
        found.append(Overlap(depth, f"object {item[0].obj_id} and the world"))
    deepest = max(found, key=lambda overlap: overlap.depth)
    return deepest if deepest.depth > 0 else Overlap()


def _depth_between(first: Posed, second: Posed) -> float:
    depth = max(depth_inside(first, second), depth_inside(second, first))
    if depth > MAX_OVERLAP:
        return depth
    apart = separation(first, second, MAX_OVERLAP)  # thin walls may cross without depth
    return apart if apart > MAX_OVERLAP else depth


def depth_inside(inner: Posed, outer: Posed) -> float:
    """Metres that the deepest point of the surface of `inner` lies inside `outer`; 0 for none."""
    outer_from_inner = inverse(outer[1]) @ inner[1]
    return _depth_of_points(outer[0], transform_points(outer_from_inner, surface_points(inner[0])))


def _depth_of_points(model: Model, points: Float[np.ndarray, "n 3"]) -> float:
    inside = points[_within(points, *_limits(model))]
    return max(0.0, -float(signed_distance(model, inside).min())) if len(inside) else 0.0


@per_model
def surface_points(model: Model) -> Float[np.ndarray, "n 3"]:
    """Points all over the surface, about `SPACING` apart, and all vertices; model frame."""
    return np.concatenate([model.vertices, points_on(model.vertices[model.faces])])


def points_on(triangles: Soup) -> Float[np.ndarray, "n 3"]:
    """Points on the triangles that are larger than `SPACING`, about so far apart."""
    edges = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2).max(axis=1, initial=0.0)
    counts = np.ceil(edges / SPACING).astype(int)
    points = [np.zeros((0, 3))]
    for count in np.unique(counts[counts > 1]):
        i, j = (grid.ravel() for grid in np.indices((count + 1, count + 1)))
        inner = (i + j <= count) & (np.maximum.reduce([i, j, count - i - j]) < count)
        weights = np.stack([i, j, count - i - j], axis=1)[inner] / count
        points.append(np.einsum("wk,nkc->nwc", weights, triangles[counts == count]).reshape(-1, 3))
    return _thinned(np.concatenate(points))


def _thinned(points: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "m 3"]:
    """One of the points in each small cell: narrow triangles have many close together."""
    cells = np.floor(points / (0.7 * SPACING)).astype(np.int64)
    keys = (cells[:, 0] * 2097152 + cells[:, 1]) * 2097152 + cells[:, 2]
    return points[np.unique(keys, return_index=True)[1]]


@per_model
def _limits(model: Model) -> tuple[Float[np.ndarray, " 3"], Float[np.ndarray, " 3"]]:
    return model.vertices.min(axis=0), model.vertices.max(axis=0)


def _within(
    points: Float[np.ndarray, "n 3"], low: Float[np.ndarray, " 3"], high: Float[np.ndarray, " 3"]
) -> Bool[np.ndarray, " n"]:
    inside = np.ones(len(points), bool)
    for k in range(3):  # long inner loops: numpy is slow on arrays whose last axis is 3
        inside &= (points[:, k] > low[k]) & (points[:, k] < high[k])
    return inside


def _box(model: Model, world_from_model: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "2 3"]:
    """Lower and upper corner of the object's bounding box in the world."""
    points = transform_points(world_from_model, extremes(model))
    return np.stack([points.min(axis=0), points.max(axis=0)])


def _nearby(world: World, boxes: Sequence[Float[np.ndarray, "2 3"]], reach: float = 0.05) -> Model:
    """What of the world is near some objects: queries of all of it take ten times as long."""
    low, high = _face_boxes(world.model)
    ends = np.array(boxes).reshape(-1, 2, 3)
    near = ((low < ends[:, 1].max(axis=0) + reach) & (high > ends[:, 0].min(axis=0) - reach)).all(axis=1)
    return Model(world.model.obj_id, world.model.vertices, world.model.faces[near], world.model.diameter)


@per_model
def _face_boxes(model: Model) -> tuple[Float[np.ndarray, "f 3"], Float[np.ndarray, "f 3"]]:
    triangles = model.vertices[model.faces]
    return triangles.min(axis=1), triangles.max(axis=1)


def _depth_behind(nearby: Model, item: Posed) -> float:
    """How far points of an object lie behind the face of the world that is nearest to them."""
    from open3d.core import Tensor

    if not len(nearby.faces):
        return 0.0
    points = transform_points(item[1], surface_points(item[0])).astype(np.float32)
    answer = _raycaster(nearby).compute_closest_points(Tensor.from_numpy(points))
    away = points - answer["points"].numpy()
    distance = np.linalg.norm(away, axis=1)
    behind = np.einsum("ij,ij->i", away, answer["primitive_normals"].numpy()) < -0.1 * distance
    return float(distance[behind].max(initial=0.0))


def _depth_of_surface(nearby: Model, item: Posed, box: Float[np.ndarray, "2 3"]) -> float:
    """How far points of the world's surface lie inside an object."""
    soup = nearby.vertices[nearby.faces]
    for axis in range(3):
        soup = split(split(soup, axis, float(box[0, axis]))[1], axis, float(box[1, axis]))[0]
    points = np.concatenate([soup.reshape(-1, 3), points_on(soup)])
    return _depth_of_points(item[0], transform_points(inverse(item[1]), points))
