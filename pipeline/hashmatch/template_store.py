"""The templates of several objects in one set of arrays, as the compiled tests want them."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Integer

from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.templates import Templates


@dataclass(frozen=True, eq=False)
class TemplateStore:
    """The points of the templates of several objects, numbered through as in the hash tables."""

    expected: Float[np.ndarray, "t 2"]
    """Metres at scale 1: what T1 takes the surface's distance for, as a factor of the scale and a constant."""
    objects: Integer[np.ndarray, "t"]
    normal_points: Integer[np.ndarray, "t p 2"]
    normal_bits: Integer[np.ndarray, "t p"]
    point_distances: Integer[np.ndarray, "t p"]
    point_hues: Integer[np.ndarray, "t p"]
    normal_counts: Integer[np.ndarray, "t"]
    gradient_points: Integer[np.ndarray, "t p 2"]
    gradient_bits: Integer[np.ndarray, "t p"]
    gradient_counts: Integer[np.ndarray, "t"]
    distances: Float[np.ndarray, "o"]
    """Metres; of each object's centroid."""
    diameters: Float[np.ndarray, "o"]
    colored: Bool[np.ndarray, "o"]


def store(objects: Sequence[Templates], config: HashMatchConfig) -> TemplateStore:
    """Put the templates of several objects into one."""

    def all_of(name: str) -> np.ndarray:
        return np.concatenate([getattr(own, name) for own in objects])

    names = ("normal_points", "normal_bits", "point_distances", "point_hues", "normal_counts")
    names += ("gradient_points", "gradient_bits", "gradient_counts")
    return TemplateStore(
        expected=np.concatenate([_expected(own, config) for own in objects]),
        objects=np.repeat(np.arange(len(objects), dtype=np.int32), [len(own) for own in objects]),
        distances=np.array([own.distance for own in objects]),
        diameters=np.array([own.diameter for own in objects]),
        colored=np.array([own.colored for own in objects]),
        **{name: all_of(name) for name in names},
    )


def _expected(own: Templates, config: HashMatchConfig) -> Float[np.ndarray, "t 2"]:
    """Expected e = scale * first + second: the thesis's is s_w |t_t| - 0.5 d_t."""
    behind = -0.5 * np.full(len(own), own.diameter)
    if config.size_from_surface:
        behind = np.where(own.nearest > 0, own.nearest - own.distance, behind)
    return np.stack([np.full(len(own), own.distance), behind], axis=-1)


def size_ranges(points: TemplateStore, scale: float, factor: float) -> Float[np.ndarray, "o 2"]:
    """Distances (metres) at which some template of each object passes T1, at a scale of focal lengths alike."""
    expected = scale * points.expected[:, 0] + points.expected[:, 1]
    of_objects = [expected[points.objects == o] for o in range(len(points.diameters))]
    nearest, farthest = np.array([(own.min(), own.max()) for own in of_objects]).reshape(-1, 2).T
    return np.stack([nearest / np.sqrt(factor), farthest * np.sqrt(factor)], axis=-1)
