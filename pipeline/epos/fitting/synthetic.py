"""Many-to-many correspondences with a known answer, for tests and benchmarks of fitting.

Objects of about 8 cm are seen in a grid of 4 x 4 px cells, each the nearest instance's. At each pixel one to four points
are predicted: the true one under one of the object's symmetries, with noise, or with a given probability any point of the
surface. Confidences of right and wrong points overlap.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float, Int

from pipeline.epos.fitting.correspondences import PotentialCorrespondences
from pipeline.geometry import project, transform
from pipeline.scene import Model

Symmetry = Literal["two-fold", "continuous"]


K = np.array([[572.4, 0.0, 325.3], [0.0, 573.6, 242.0], [0.0, 0.0, 1.0]])


WIDTH, HEIGHT = 640, 480


CELL_PX = 4


_SURFACE_POINTS = 20_000


_RING = 6
"""Turns about a continuous axis that are predicted: a network knows a ring by as many fragments."""


_CENTRES = {
    1: [(0.5, 0.5)],
    3: [(0.25, 0.4), (0.5, 0.65), (0.75, 0.4)],
    10: [(x, y) for y in (0.22, 0.5, 0.78) for x in (0.14, 0.38, 0.62, 0.86)],
}
"""Where instances may be, as shares of the image, by their largest number."""


@dataclass(frozen=True, eq=False)
class MadeScene:
    """Correspondences and the poses that they came from."""

    correspondences: PotentialCorrespondences
    camera_from_model: Float[np.ndarray, "k 4 4"]
    """Metres."""
    model: Model
    """Points of the surface as vertices, no faces, and the symmetries under which a pose is right."""
    instance: Int[np.ndarray, "n"]
    """Which instance each correspondence's pixel shows."""


def make_scene(
    seed: int,
    instances: int = 1,
    symmetry: Symmetry = "two-fold",
    outliers: float = 0.5,
    noise_px: float = 1.0,
    distance: tuple[float, float] = (0.44, 0.53),
) -> MadeScene:
    """Make a scene of up to ten instances.

    Args:
        seed: of the random numbers.
        instances: how many.
        symmetry: of the object.
        outliers: share of predicted points that are wrong.
        noise_px: standard deviation of a right point, per axis, as seen in the image.
        distance: nearest and farthest instance, metres.

    """
    rng = np.random.default_rng(seed)
    surface = _surface(rng, symmetry)
    poses = _poses(rng, instances, distance)
    cells, instance, points = _visible(surface, poses)
    turns = _turns(2 if symmetry == "two-fold" else _RING)
    count = rng.integers(1, 5, len(cells))
    row = np.repeat(np.arange(len(cells)), count)
    wrong = rng.random(len(row)) < outliers
    noise = rng.normal(size=(len(row), 3)) * noise_px * points[row, 2:] / K[0, 0]
    right = np.einsum("nji,nj->ni", poses[instance[row], :3, :3], points[row] + noise - poses[instance[row], :3, 3])
    right = np.einsum("nij,nj->ni", turns[rng.integers(len(turns), size=len(row))], right)
    predicted = np.where(wrong[:, None], surface[rng.integers(len(surface), size=len(row))], right)
    confidence = np.where(wrong, rng.uniform(0.0, 0.9, len(row)), rng.uniform(0.1, 1.0, len(row)))
    pixels = (cells[row] + 0.5) * CELL_PX - 0.5
    made = PotentialCorrespondences(1, pixels, predicted, confidence, row)
    return MadeScene(made, poses, _model(surface[::20], symmetry), instance[row])


def _surface(rng: np.random.Generator, symmetry: Symmetry) -> Float[np.ndarray, "n 3"]:
    """Points of a closed surface that is symmetric about z and in no other way."""
    directions = rng.normal(size=(_SURFACE_POINTS, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    polar, around = np.arccos(directions[:, 2]), np.arctan2(directions[:, 1], directions[:, 0])
    if symmetry == "two-fold":
        radius = 1 + 0.12 * np.cos(polar) + 0.15 * np.cos(3 * polar)
        radius += np.sin(polar) ** 2 * (0.25 * np.cos(2 * around + 0.4) + 0.12 * np.sin(4 * around))
    else:
        radius = 1.07 + 0.15 * np.cos(polar) + 0.2 * np.cos(2 * polar) + 0.15 * np.cos(3 * polar)
    return 0.042 * radius[:, None] * directions


def _poses(rng: np.random.Generator, instances: int, distance: tuple[float, float]) -> Float[np.ndarray, "k 4 4"]:
    """Random rotations at places apart from each other."""
    from scipy.spatial.transform import Rotation

    places = next(places for most, places in _CENTRES.items() if instances <= most)
    places = np.array(places)[rng.permutation(len(places))[:instances]] * (WIDTH, HEIGHT)
    u, v = (places + rng.uniform(-10, 10, places.shape)).T
    z = rng.uniform(*distance, instances)
    centres = np.stack([(u - K[0, 2]) / K[0, 0] * z, (v - K[1, 2]) / K[1, 1] * z, z], axis=1)
    rotations = Rotation.random(instances, rng=rng).as_matrix()
    return np.stack([transform(R, t) for R, t in zip(rotations, centres, strict=True)])


def _visible(
    surface: Float[np.ndarray, "n 3"], poses: Float[np.ndarray, "k 4 4"]
) -> tuple[Int[np.ndarray, "p 2"], Int[np.ndarray, "p"], Float[np.ndarray, "p 3"]]:
    """Cells (column, row) in which something is seen, its instance, and the point seen at their centres (camera frame)."""
    points = np.concatenate([surface @ pose[:3, :3].T + pose[:3, 3] for pose in poses])
    owner = np.repeat(np.arange(len(poses)), len(surface))
    seen = project(K, points)
    cells = np.floor((seen + 0.5) / CELL_PX).astype(np.int64)
    order = np.argsort(points[:, 2], kind="stable")
    order = order[np.all((cells[order] >= 0) & (cells[order] < (WIDTH // CELL_PX, HEIGHT // CELL_PX)), axis=1)]
    cells, nearest = np.unique(cells[order][:, ::-1], axis=0, return_index=True)
    cells, chosen = cells[:, ::-1], order[nearest]
    aside = ((cells + 0.5) * CELL_PX - 0.5 - seen[chosen]) * points[chosen, 2:] / (K[0, 0], K[1, 1])
    return cells, owner[chosen], points[chosen] + np.pad(aside, ((0, 0), (0, 1)))


def _turns(count: int) -> Float[np.ndarray, "count 3 3"]:
    """Turns about z, all around."""
    from scipy.spatial.transform import Rotation

    angles = np.linspace(0, 2 * np.pi, count, endpoint=False)
    return Rotation.from_rotvec(angles[:, None] * [0, 0, 1]).as_matrix()


def _model(points: Float[np.ndarray, "v 3"], symmetry: Symmetry) -> Model:
    """The points as a model; a continuous symmetry is discretized into 180 turns."""
    symmetries = np.stack([transform(R, np.zeros(3)) for R in _turns(2 if symmetry == "two-fold" else 180)])
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    return Model(1, points, np.zeros((0, 3), np.int32), extent, symmetries)
