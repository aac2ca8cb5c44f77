"""EPOS's ablations (thesis tab. epos_fragments, epos_ransac_variants): fragments, regression, variants of fitting.

    python benchmarks/epos_ablation.py assets/demo                                     # the oracle with made-up noise
    python benchmarks/epos_ablation.py assets/demo --checkpoints n16.pt n64.pt         # trained networks, one per n

Each row is a setting: AR (with --vsd), AR_MSSD, AR_MSPD, correspondences per object and image, triplets per object and image, seconds of fitting
per image. Then AR_MSPD per object of the first setting. Without checkpoints the ground truth stands in the place of the
network, disturbed by a model of errors (`pipeline.epos.oracle.OracleNoise`): figures say what fitting makes of such
correspondences, and nothing of what a network would do. Nothing is asserted.
"""

import tempfile
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

import tyro
from rich.console import Console
from rich.table import Table

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.evaluation.evaluate import evaluate
from pipeline.bop.evaluation.scores import Scores
from pipeline.bop.results import read_results
from pipeline.epos.config import CorrespondenceConfig, EposSettings
from pipeline.epos.estimator import EposEstimator
from pipeline.epos.fitting.config import FittingConfig
from pipeline.epos.fitting.warm_up import warm_up
from pipeline.epos.oracle import OracleNoise, OracleSettings, make_oracle
from pipeline.recording import StageRecorder
from pipeline.run import Run
from pipeline.running import run_estimator
from pipeline.scene import Image, PoseEstimate, Target

FITTINGS = {
    "pooled (ours)": FittingConfig(),
    "pooled, tau_r 6": FittingConfig(inlier_threshold_px=6.0),
    "OpenCV RANSAC, EPnP": FittingConfig("progressive_x", ransac="opencv", solver="epnp"),
    "MSAC, EPnP+LM": FittingConfig("progressive_x", ransac="msac"),
    "GC-RANSAC, EPnP": FittingConfig("progressive_x", solver="epnp"),
    "GC-RANSAC, EPnP+LM": FittingConfig("progressive_x"),
}
"""Those of the thesis without DLS-PnP, and ours."""


@dataclass(frozen=True)
class Ablation:
    """What to compare, on the test images of a dataset."""

    dataset: tyro.conf.Positional[Path]
    checkpoints: tuple[Path, ...] = ()
    """Trained networks; with one for each number of fragments the first table shows what that number does."""
    fragments: tuple[int, ...] = (1, 4, 16, 64, 256)
    """Numbers of fragments for the oracle."""
    noise: OracleNoise = field(default_factory=lambda: OracleNoise(0.1, 0.25, 0.3, 0.1))
    """Errors of the oracle."""
    vsd: bool = False
    """Compute VSD and so AR, too, which takes most of the time."""


class Row(NamedTuple):
    """What a setting gave."""

    name: str
    scores: Scores
    per_object: dict[int, float]
    """AR_MSPD."""
    correspondences: float
    """Per object and image."""
    triplets: float
    """Per object and image."""
    seconds: float
    """Of fitting, per image; wall time."""


class Counting:
    """An estimator that adds up what its images took."""

    def __init__(self, epos: EposEstimator) -> None:
        self._epos, self.images, self.seconds = epos, 0, 0.0
        self.counts: Counter[str] = Counter()

    def estimate(self, image: Image, targets: Sequence[Target], recorder: StageRecorder) -> list[PoseEstimate]:
        """See `pipeline.estimator.Estimator`."""
        found = self._epos.estimate(image, targets, recorder)
        self.images += 1
        self.seconds += self._epos.seconds["fitting"]
        self.counts.update(self._epos.counts)
        return found


def main(asked: Ablation) -> None:
    """Measure and print."""
    console, dataset = Console(), open_dataset(asked.dataset)
    warm_up()
    source = "trained networks" if asked.checkpoints else f"ORACLE, not a network; {asked.noise}"
    console.print(f"{dataset.name} {dataset.split}: {len(dataset.targets())} targets; {source}", highlight=False)
    rows = [measured(*setting, dataset, asked.vsd) for setting in of_fragments(asked, dataset)]
    show(console, "Number of fragments and regression", rows)
    rows = [measured(*setting, dataset, asked.vsd) for setting in of_fitting(asked, dataset)]
    show(console, "Variants of fitting", rows)
    for obj_id, score in sorted(rows[0].per_object.items()):
        console.print(f"object {obj_id}: AR_MSPD {100 * score:.1f} ({rows[0].name})", highlight=False)


def of_fragments(asked: Ablation, dataset: Dataset) -> Iterator[tuple[str, Counting]]:
    """Settings of the first table."""
    for regression in (True, False):
        how = CorrespondenceConfig(regression=regression)
        suffix = "with regression" if regression else "without"
        for source in asked.checkpoints or asked.fragments:
            yield (
                f"{source if isinstance(source, int) else source.stem}, {suffix}",
                estimator(asked, dataset, source, EposSettings(correspondences=how)),
            )


def of_fitting(asked: Ablation, dataset: Dataset) -> Iterator[tuple[str, Counting]]:
    """Settings of the second table."""
    source = asked.checkpoints[0] if asked.checkpoints else 64
    for name, fitting in FITTINGS.items():
        yield name, estimator(asked, dataset, source, EposSettings(fitting=fitting))


def estimator(asked: Ablation, dataset: Dataset, source: Path | int, settings: EposSettings) -> Counting:
    """EPOS with a network, or with so many fragments and the oracle."""
    if isinstance(source, Path):
        return Counting(EposEstimator.of_dataset(dataset, replace(settings, checkpoint=source)))
    return Counting(make_oracle(OracleSettings(source, asked.noise, settings), dataset).epos)


def measured(name: str, method: Counting, dataset: Dataset, vsd: bool) -> Row:
    """Run a setting over the images and score it."""
    with tempfile.TemporaryDirectory() as folder:
        with Run.create(Path(folder) / "run", dataset=dataset, method="ablation") as run:
            run_estimator(method, dataset, run, record=False)
            results = read_results(run.results_path)
        found = evaluate(dataset, results, with_vsd=vsd)
    per_object = {obj_id: part.mspd for obj_id, part in found.per_object.items()}
    images, counts = method.images, method.counts
    return Row(
        name,
        found.scores,
        per_object,
        counts["correspondences"] / counts["objects"],
        counts["triplets"] / counts["objects"],
        method.seconds / images,
    )


def show(console: Console, title: str, rows: Sequence[Row]) -> None:
    """Print a table."""
    table = Table(title=title)
    for column in ("", "AR", "AR_MSSD", "AR_MSPD", "corr.", "triplets", "fitting s/image"):
        table.add_column(column, justify="left" if not column else "right")
    for row in rows:
        three = (row.scores.average, row.scores.mssd, row.scores.mspd)
        scores = ("-" if score is None else f"{100 * score:.1f}" for score in three)
        table.add_row(row.name, *scores, f"{row.correspondences:.0f}", f"{row.triplets:.0f}", f"{row.seconds:.3f}")
    console.print(table)


if __name__ == "__main__":
    main(tyro.cli(Ablation))
