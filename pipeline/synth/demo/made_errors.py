"""Made pose estimates for the demo: the ground truth disturbed on purpose, in the ways in which real methods fail.

No method computed these poses. Each visible instance gets one kind of error from `KINDS`, by a seeded choice.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from pipeline.bop.dataset import Dataset
from pipeline.geometry import transform
from pipeline.scene import GroundTruth, ImageKey, Model, PoseEstimate

Pose = Float[np.ndarray, "4 4"]
NEAR_TWINS = {6: 7, 7: 6}
"""Objects of nearly the same shape, taken for one another."""
LOOSE_SCORES = (0.35, 0.9)
"""Scores of wrong estimates: some are as confident as good ones."""


@dataclass(frozen=True)
class MadeMethod:
    """A made method: how often it makes which error."""

    name: str
    seed: int
    shares: Mapping[str, int]
    """Relative frequency of each kind; kinds that do not suit an object are left out."""
    noise: float = 1.0
    """Scale of the small noise on good estimates."""


METHODS = (
    MadeMethod(
        "perturbed-1",
        11,
        dict(close=46, symmetric=12, flipped=9, depth=9, rough=8, twin=18, missing=5, duplicate=4, gross=5),
    ),
    MadeMethod(
        "perturbed-2",
        23,
        dict(close=52, symmetric=10, flipped=5, depth=5, rough=10, twin=10, missing=11, duplicate=4, gross=7),
        noise=0.6,
    ),
)


class MadeEstimate(NamedTuple):
    """An estimate and what was done to make it."""

    kind: str
    gt_index: int
    estimate: PoseEstimate


def made_estimates(dataset: Dataset, method: MadeMethod) -> list[MadeEstimate]:
    """Estimates of a method for all targets of a dataset, image by image, by falling score."""
    rng = np.random.default_rng(method.seed)
    made: list[MadeEstimate] = []
    for scene_id in dataset.scene_ids:
        for im_id in dataset.image_ids(scene_id):
            of_image = _image_estimates(dataset, ImageKey(scene_id, im_id), method, rng)
            made += sorted(of_image, key=lambda item: -item.estimate.score)
    return made


def _image_estimates(
    dataset: Dataset, key: ImageKey, method: MadeMethod, rng: np.random.Generator
) -> list[MadeEstimate]:
    made = []
    for truth in dataset.ground_truth(key):
        kind = _choose_kind(truth, dataset.model(truth.obj_id), method, rng)
        if (truth.visible_fraction or 0.0) >= 0.1:
            estimates = _MAKERS[kind](truth, dataset.model(truth.obj_id), method.noise, rng)
            made += [MadeEstimate(kind, truth.index, _at(estimate, key)) for estimate in estimates]
    return made


def _choose_kind(truth: GroundTruth, model: Model, method: MadeMethod, rng: np.random.Generator) -> str:
    symmetric = len(model.symmetries) > 1
    suits = {"symmetric": symmetric, "flipped": not symmetric, "twin": truth.obj_id in NEAR_TWINS}
    shares = {kind: share for kind, share in method.shares.items() if suits.get(kind, True)}
    return str(rng.choice(list(shares), p=np.array(list(shares.values())) / sum(shares.values())))


def _close(truth: GroundTruth, model: Model, noise: float, rng: np.random.Generator) -> list[PoseEstimate]:
    """A good estimate: 1-2 mm and about a degree off; worse where little is visible."""
    factor = noise * (1.0 + 2.0 * (1.0 - (truth.visible_fraction or 1.0)))
    pose = _disturbed(truth.camera_from_model, 1.2 * factor, 0.0011 * factor, rng)
    return [_estimate(truth, pose, rng.uniform(0.8, 0.99) - 0.04 * factor)]


def _symmetric(truth: GroundTruth, model: Model, noise: float, rng: np.random.Generator) -> list[PoseEstimate]:
    """Right up to a symmetry of the object: looks wrong by its axes, and is correct."""
    symmetry = model.symmetries[rng.integers(1, len(model.symmetries))]
    return _close(replace(truth, camera_from_model=truth.camera_from_model @ symmetry), model, noise, rng)


def _flipped(truth: GroundTruth, model: Model, noise: float, rng: np.random.Generator) -> list[PoseEstimate]:
    """The object turned by 180 degrees about one of its axes, which it does not look like from all sides."""
    half_turn = transform(Rotation.from_rotvec(np.pi * np.eye(3)[rng.integers(3)]).as_matrix(), np.zeros(3))
    pose = _disturbed(truth.camera_from_model @ half_turn, 1.5 * noise, 0.0015 * noise, rng)
    return [_estimate(truth, pose, rng.uniform(*LOOSE_SCORES))]


def _depth(truth: GroundTruth, model: Model, noise: float, rng: np.random.Generator) -> list[PoseEstimate]:
    """Shifted along the viewing axis: projects almost where it should (MSPD small), and is far off (MSSD large)."""
    pose = _disturbed(truth.camera_from_model, 0.8, 0.0006, rng)
    pose[:3, 3] *= 1.0 + rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.06)
    return [_estimate(truth, pose, rng.uniform(0.6, 0.93))]


def _rough(truth: GroundTruth, model: Model, noise: float, rng: np.random.Generator) -> list[PoseEstimate]:
    """About right: several millimetres and some ten degrees off."""
    pose = _disturbed(truth.camera_from_model, 9.0, 0.006, rng)
    return [_estimate(truth, pose, rng.uniform(0.45, 0.8))]


def _twin(truth: GroundTruth, model: Model, noise: float, rng: np.random.Generator) -> list[PoseEstimate]:
    """A good pose under the near twin's name: the object itself is missed."""
    return [replace(_close(truth, model, noise, rng)[0], obj_id=NEAR_TWINS[truth.obj_id])]


def _missing(truth: GroundTruth, model: Model, noise: float, rng: np.random.Generator) -> list[PoseEstimate]:
    """No estimate at all."""
    return []


def _duplicate(truth: GroundTruth, model: Model, noise: float, rng: np.random.Generator) -> list[PoseEstimate]:
    """The same instance found twice, once a little worse."""
    first = _close(truth, model, noise, rng)[0]
    second = _disturbed(truth.camera_from_model, 3.0, 0.002, rng)
    return [first, _estimate(truth, second, first.score - rng.uniform(0.01, 0.1))]


def _gross(truth: GroundTruth, model: Model, noise: float, rng: np.random.Generator) -> list[PoseEstimate]:
    """A random pose some centimetres to decimetres away."""
    shift = rng.uniform(0.04, 0.13) * _direction(rng) * (1.0, 1.0, 0.5)
    pose = transform(Rotation.random(rng=rng).as_matrix(), truth.camera_from_model[:3, 3] + shift)
    return [_estimate(truth, pose, rng.uniform(*LOOSE_SCORES))]


_MAKERS: dict[str, Callable[[GroundTruth, Model, float, np.random.Generator], Sequence[PoseEstimate]]] = {
    "close": _close,
    "symmetric": _symmetric,
    "flipped": _flipped,
    "depth": _depth,
    "rough": _rough,
    "twin": _twin,
    "missing": _missing,
    "duplicate": _duplicate,
    "gross": _gross,
}
KINDS = tuple(_MAKERS)


def _disturbed(pose: Pose, degrees: float, metres: float, rng: np.random.Generator) -> Pose:
    """Turned and shifted by random amounts about the given size; three times as much along the viewing axis."""
    turn = Rotation.from_rotvec(np.radians(degrees) * rng.uniform(0.6, 1.4) * _direction(rng)).as_matrix()
    shift = metres * rng.uniform(0.6, 1.4) * _direction(rng) * (1.0, 1.0, 3.0)
    return transform(turn @ pose[:3, :3], pose[:3, 3] + shift)


def _direction(rng: np.random.Generator) -> Float[np.ndarray, "3"]:
    vector = rng.standard_normal(3)
    return vector / np.linalg.norm(vector)


def _estimate(truth: GroundTruth, pose: Pose, score: float) -> PoseEstimate:
    return PoseEstimate(0, 0, truth.obj_id, float(np.round(np.clip(score, 0.05, 0.99), 4)), pose)


def _at(estimate: PoseEstimate, key: ImageKey) -> PoseEstimate:
    return replace(estimate, scene_id=key.scene_id, im_id=key.im_id)
