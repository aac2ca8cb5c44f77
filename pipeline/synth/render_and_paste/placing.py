"""Random poses: how an object is turned, how far away it is, and where in the image."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from pipeline.geometry import inverse, project, transform, transform_points
from pipeline.model_cache import convex_hull, per_model
from pipeline.scene import Camera, Model
from pipeline.synth.cameras import Viewpoint, rounded_pose, world_from_camera
from pipeline.synth.render_and_paste.settings import PasteSettings

MOST_TRIES = 25
"""Places tried for an object; of those that all touch or hide others the best is taken."""


@dataclass(frozen=True, eq=False)
class _Ball:
    """Ball about an object, by which it is told roughly whether objects touch or hide each other."""

    center: Float[np.ndarray, "3"]
    """Metres, camera frame."""
    radius: float
    pixel: Float[np.ndarray, "2"]
    radius_px: float


def _trouble(one: _Ball, other: _Ball, min_visible: float) -> float:
    """How much two objects are in each other's way: above 0 if they may touch, or one may hide the other."""
    touching = (one.radius + other.radius) / max(float(np.linalg.norm(one.center - other.center)), 1e-9) - 1.0
    farther = one if one.center[2] > other.center[2] else other
    apart = float(np.linalg.norm(one.pixel - other.pixel))
    covered = (one.radius_px + other.radius_px - apart) / (2.0 * farther.radius_px)
    return max(touching, 0.0) + max(covered - (1.0 - min_visible), 0.0)


def sample_poses(
    models: Sequence[Model], camera: Camera, settings: PasteSettings, rng: np.random.Generator
) -> list[tuple[Model, Float[np.ndarray, "4 4"]]]:
    """Draw models, with repetition, and `camera_from_model` of each, rounded as it is stored.

    The middle of each object is seen inside the image; objects hardly ever run into each other. Only the place in the
    image gives way to that: from where objects are seen and how far away stays as uniform as it was drawn.
    """
    count = int(rng.integers(settings.objects[0], settings.objects[1], endpoint=True))
    placed: list[tuple[Model, np.ndarray]] = []
    balls: list[_Ball] = []
    for index in rng.integers(len(models), size=count):
        model = models[int(index)]
        pose, ball = _placed(model, camera, settings, balls, rng)
        placed.append((model, rounded_pose(pose)))
        balls.append(ball)
    return placed


def _placed(
    model: Model, camera: Camera, settings: PasteSettings, others: list[_Ball], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "4 4"], _Ball]:
    """The first pose that is in nobody's way, else the best of those tried."""
    turned, truncated = _turned(model, camera, settings, rng), rng.random() < settings.truncated
    reach = _limits(model, camera, turned) - camera.K[:2, 2]
    best, least = None, np.inf
    for _ in range(MOST_TRIES):
        pose, fits = _candidate(model, camera, turned, reach, truncated, rng)
        ball = _ball(model, pose, camera)
        trouble = sum(_trouble(ball, other, settings.min_visible) for other in others) + (0.0 if fits else 10.0)
        if trouble < least:
            best, least = (pose, ball), trouble
        if trouble == 0.0:
            break
    assert best is not None
    return best


@per_model
def _middle(model: Model) -> Float[np.ndarray, "3"]:
    """Middle of the box about the model, model frame."""
    return (model.vertices.min(axis=0) + model.vertices.max(axis=0)) / 2


@per_model
def _centered_hull(model: Model) -> Float[np.ndarray, "h 3"]:
    return model.vertices[convex_hull(model)] - _middle(model)


@per_model
def _radius(model: Model) -> float:
    return float(np.linalg.norm(model.vertices - _middle(model), axis=1).max())


def _candidate(
    model: Model, camera: Camera, turned: np.ndarray, reach: np.ndarray, truncated: bool, rng: np.random.Generator
) -> tuple[Float[np.ndarray, "4 4"], bool]:
    """A pose, and whether the object is truncated as it should be, with its middle seen inside the image.

    `reach` is how far it reaches from its middle, in pixels, where it is straight ahead.
    """
    size = np.array([camera.width, camera.height])
    center = _place(-reach[0], reach[1], size, truncated, rng)
    camera_from_centered = _swing(camera, center) @ turned
    low, high = _limits(model, camera, camera_from_centered)
    outside = bool((low < 0).any() or (high > size - 1).any())
    inside = bool((center >= 0).all() and (center <= size - 1).all())
    return camera_from_centered @ transform(np.eye(3), -_middle(model)), outside == truncated and inside


def _turned(model: Model, camera: Camera, settings: PasteSettings, rng: np.random.Generator) -> np.ndarray:
    """Camera, looking straight at it, from the object centred about its middle."""
    if settings.views is not None:
        ranges = settings.views
        view = (ranges.azimuth_deg, ranges.elevation_deg, ranges.distance, ranges.roll_deg)
        return inverse(world_from_camera(Viewpoint(*(rng.uniform(*limits) for limits in view)), np.zeros(3)))
    from scipy.spatial.transform import Rotation

    size_px = np.exp(rng.uniform(*np.log(settings.size))) * min(camera.width, camera.height)
    distance = model.diameter * np.sqrt(camera.K[0, 0] * camera.K[1, 1]) / size_px
    distance = max(distance, 1.2 * _radius(model))  # the camera stays outside
    return transform(Rotation.random(rng=rng).as_matrix(), np.array([0.0, 0.0, distance]))


def _place(
    before: np.ndarray, after: np.ndarray, size: np.ndarray, truncated: bool, rng: np.random.Generator
) -> Float[np.ndarray, "2"]:
    """Pixel for the middle of an object, given how far it reaches to the left and up, and to the right and down."""
    low, high = before + 1.0, size - 2.0 - after
    center = rng.uniform(np.minimum(low, high), np.maximum(low, high))
    if truncated:
        axis, at_end, share = rng.integers(2), rng.random() < 0.5, rng.uniform(0.05, 0.95)
        center[axis] = size[axis] - 1.0 - share * after[axis] if at_end else share * before[axis]
    return center


def _swing(camera: Camera, pixel: np.ndarray) -> Float[np.ndarray, "4 4"]:
    """Swing what is straight ahead about the camera centre to a pixel: it is seen from the same side there."""
    (fx, skew, cx), (_, fy, cy), _ = camera.K
    y = (pixel[1] - cy) / fy
    z = np.array([(pixel[0] - cx - skew * y) / fx, y, 1.0])
    z /= np.linalg.norm(z)
    x = np.array([z[2], 0.0, -z[0]]) / np.hypot(z[0], z[2])
    down = np.array([z[1] * x[2], z[2] * x[0] - z[0] * x[2], -z[1] * x[0]])
    return transform(np.stack([x, down, z], axis=1), np.zeros(3))


def _limits(model: Model, camera: Camera, camera_from_centered: np.ndarray) -> Float[np.ndarray, "2 2"]:
    """Least and largest pixel coordinates of an object, one row each."""
    hull = transform_points(camera_from_centered, _centered_hull(model))
    pixels = project(camera.K, np.maximum(hull, [-np.inf, -np.inf, 1e-3])).T  # numpy is slow on many short rows
    return np.stack([pixels.min(axis=1), pixels.max(axis=1)])


def _ball(model: Model, pose: np.ndarray, camera: Camera) -> _Ball:
    center = transform_points(pose, _middle(model))
    radius = _radius(model)
    focal = np.sqrt(camera.K[0, 0] * camera.K[1, 1])
    distance = np.linalg.norm(center)
    return _Ball(center, radius, project(camera.K, center), float(focal * radius / max(distance, 1e-9)))
