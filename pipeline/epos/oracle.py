"""The ground truth in the place of the network: what EPOS finds when everything before fitting is right, or errs as told.

It tells how far fragments, cells and fitting alone can go on a dataset, and makes runs with all recordings where there is
no trained network yet:

    python -m pipeline.epos.oracle assets/demo --out runs/oracle --images 3
"""

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.epos.checkpoint import TrainedObject
from pipeline.epos.config import EposSettings, Precision
from pipeline.epos.estimator import EposEstimator
from pipeline.epos.fragments import DEFAULT_COUNT, fragments_of
from pipeline.epos.prediction import ObjectPrediction
from pipeline.epos.showing import show_targets
from pipeline.epos.targets import KnownObject, Targets, make_targets
from pipeline.epos.training.images import labelled_image
from pipeline.exceptions import InputError
from pipeline.geometry import transform_points
from pipeline.recording import StageRecorder
from pipeline.run import Run
from pipeline.running import run_estimator
from pipeline.scene import Image, PoseEstimate, Target

METHOD = "epos-oracle"


@dataclass(frozen=True)
class OracleNoise:
    """How the oracle errs. A model of errors, made up: no network errs just like this."""

    lost: float = 0.0
    """Share of an object's cells where it is not seen."""
    confused: float = 0.0
    """Share of cells that are taken for another place of the same object."""
    doubted: float = 0.0
    """Share of cells where another fragment, drawn at random, is believed half as much or more, with any coordinates."""
    coordinates: float = 0.0
    """Standard deviation of 3D fragment coordinates, in sizes of the fragment."""

    def __post_init__(self) -> None:
        for name in ("lost", "confused", "doubted"):
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise InputError(f"oracle: {name} is {getattr(self, name)}; expected 0 to 1")
        if not 0.0 <= self.coordinates < float("inf"):
            raise InputError(f"oracle: coordinates is {self.coordinates}; expected a number from 0")


@dataclass(frozen=True)
class OracleSettings:
    """Find objects by EPOS with the ground truth in the place of its network."""

    fragments: int = DEFAULT_COUNT
    """n, fragments of an object."""
    noise: OracleNoise = field(default_factory=OracleNoise)
    epos: EposSettings = field(default_factory=EposSettings)
    """Of all that follows the network; the seed is that of the noise, too."""


@dataclass(frozen=True, eq=False)
class OracleSeen:
    """An image as the ground truth has it; see `pipeline.epos.prediction.Seen`."""

    object_probability: Float32[np.ndarray, "h w m"]
    predictions: tuple[ObjectPrediction, ...]
    targets: Targets
    damaged_cells: int = 0

    def about(self, position: int, obj_id: int, min_probability: float) -> ObjectPrediction:
        """See `Seen`; where the object is seen at all, it is certain."""
        return self.predictions[position]


@dataclass(frozen=True, eq=False)
class Oracle:
    """Knows the objects of a dataset and the ground truth of its images."""

    dataset: Dataset
    known: tuple[KnownObject, ...]
    objects: tuple[TrainedObject, ...]
    """The same as `pipeline.epos.estimator.Predictor` has them."""
    noise: OracleNoise
    seed: int

    def see(self, image: Image, precision: Precision = "float32") -> OracleSeen:
        """Look the image up. Raises InputError where its annotations are damaged."""
        targets = make_targets(labelled_image(self.dataset, image.key), self.known)
        rng = np.random.default_rng([self.seed, *image.key])
        a = np.zeros((*targets.objects.shape, 1 + len(self.known)), np.float32)
        predictions = tuple(
            disturbed(exact(targets, position, known), self.noise, rng) for position, known in enumerate(self.known)
        )
        for position, prediction in enumerate(predictions):
            a[prediction.cells[:, 1], prediction.cells[:, 0], position + 1] = 1.0
        a[..., 0] = 1.0 - a.sum(axis=-1)
        return OracleSeen(a, predictions, targets)


def exact(targets: Targets, position: int, known: KnownObject) -> ObjectPrediction:
    """What a perfect network says of an object: all points that its symmetries make look alike, equally likely."""
    model, fragments = known.model, known.fragments
    rows, columns = np.nonzero(targets.objects == position + 1)
    points = fragments.points(targets.fragments[rows, columns], targets.coordinates[rows, columns].astype(np.float64))
    b = np.zeros((len(rows), len(fragments)), np.float32)
    r = np.zeros((len(rows), len(fragments), 3), np.float32)
    nearest = np.full(b.shape, np.inf)
    for symmetry in model.symmetries:
        located = fragments.locate(transform_points(symmetry, points))
        k, lengths = np.arange(len(rows)), np.linalg.norm(located.coordinates, axis=1)
        better = lengths < nearest[k, located.fragment_ids]  # of a ring that crosses a fragment, its middle
        k, ids = k[better], located.fragment_ids[better]
        nearest[k, ids], r[k, ids], b[k, ids] = lengths[better], located.coordinates[better], 1.0
    b /= np.maximum(b.sum(axis=1, keepdims=True), 1.0)
    cells = np.stack([columns, rows], axis=1)
    return ObjectPrediction(model.obj_id, targets.objects.shape, cells, np.ones(len(rows), np.float32), b, r)


def disturbed(prediction: ObjectPrediction, noise: OracleNoise, rng: np.random.Generator) -> ObjectPrediction:
    """A prediction with errors."""
    rows = np.flatnonzero(rng.random(len(prediction.cells)) >= noise.lost)
    source = np.where(rng.random(len(rows)) < noise.confused, rng.permutation(rows), rows)
    b, r = prediction.fragment_probability[source], prediction.coordinates[source]
    doubted = np.flatnonzero(rng.random(len(rows)) < noise.doubted)
    others = rng.integers(b.shape[1], size=len(doubted))
    highest = b[doubted].max(axis=1, initial=0.0)
    b[doubted, others] = highest * rng.uniform(0.5, 1.0, len(doubted)).astype(np.float32)
    r[doubted, others] = rng.uniform(-0.5, 0.5, (len(doubted), 3)).astype(np.float32)
    b /= np.maximum(b.sum(axis=1, keepdims=True), 1e-30)
    r += noise.coordinates * rng.standard_normal(r.shape, dtype=np.float32)
    a = prediction.object_probability[rows]
    return replace(
        prediction, cells=prediction.cells[rows], object_probability=a, fragment_probability=b, coordinates=r
    )


class OracleEstimator:
    """EPOS with an oracle; it records the targets, too. See `pipeline.estimator.Estimator`."""

    def __init__(self, oracle: Oracle, settings: EposSettings) -> None:
        """Take the oracle in the place of a network."""
        self.oracle = oracle
        self.epos = EposEstimator(oracle, settings)

    def estimate(self, image: Image, targets: Sequence[Target], recorder: StageRecorder) -> list[PoseEstimate]:
        """See `pipeline.estimator.Estimator`; raises as `EposEstimator.estimate`."""
        if recorder.enabled:
            recorder.text("log", "the ground truth stands in the place of the network", "WARN")
            labelled = labelled_image(self.oracle.dataset, image.key)
            show_targets(make_targets(labelled, self.oracle.known), self.oracle.known, recorder)
        return self.epos.estimate(image, targets, recorder)


def make_oracle(settings: OracleSettings, dataset: Dataset) -> OracleEstimator:
    """Make the estimator for a dataset. Raises InputError for a model that cannot be split."""
    models = [dataset.model(obj_id, "display") for obj_id in dataset.obj_ids]
    known = tuple(KnownObject(model, fragments_of(model, settings.fragments)) for model in models)
    objects = tuple(TrainedObject.of(model, own.fragments) for model, own in zip(models, known, strict=True))
    return OracleEstimator(Oracle(dataset, known, objects, settings.noise, settings.epos.seed), settings.epos)


def record_oracle(dataset_root: Path, out: Path, *, images: int = 3, settings: OracleSettings | None = None) -> Path:
    """Run the oracle over the first test images of a dataset into a run folder with all recordings; returns the folder.

    Raises:
        InputError: the dataset cannot be read, or the folder holds something else.

    """
    settings = settings or OracleSettings()
    dataset = open_dataset(dataset_root)
    keys = list(dict.fromkeys(target.image for target in dataset.targets()))[:images]
    targets = [target for target in dataset.targets() if target.image in keys]
    with Run.create(out, dataset=dataset, method=METHOD, config=asdict(settings), seed=settings.epos.seed) as run:
        run.save_models([dataset.model(obj_id) for obj_id in sorted({target.obj_id for target in targets})])
        run_estimator(make_oracle(settings, dataset), dataset, run, targets=targets)
    return out


def main() -> None:
    """Make a run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("dataset", type=Path)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--images", type=int, default=3)
    parser.add_argument("--fragments", type=int, default=DEFAULT_COUNT)
    for name, value in asdict(OracleNoise()).items():
        parser.add_argument(f"--{name}", type=float, default=value)
    asked = parser.parse_args()
    noise = OracleNoise(asked.lost, asked.confused, asked.doubted, asked.coordinates)
    record_oracle(asked.dataset, asked.out, images=asked.images, settings=OracleSettings(asked.fragments, noise))


if __name__ == "__main__":
    main()
