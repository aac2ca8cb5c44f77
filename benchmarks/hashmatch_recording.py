"""What recording HashMatch costs, and what it costs to say why instances were found or lost.

    python benchmarks/hashmatch_recording.py [--data assets/demo] [--images 3] [--cache FOLDER]

In one run on one machine: processor time of an image without recording, with it, and with the traces of all annotated
instances of the targets, and the size of the recording. Nothing is asserted.
"""

import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path

import tyro
from hashmatch_recall import some
from rich.console import Console
from rich.table import Table

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.explaining import explain_targets, explained
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.estimator import HashMatchEstimator
from pipeline.recording import NullRecorder, Recorder
from pipeline.scene import ImageKey, Target


@dataclass(frozen=True)
class Options:
    """What is measured."""

    data: Path = Path("assets/demo")
    """A BOP dataset with depth and ground truth."""
    images: int = 3
    """Images that are measured, evenly chosen."""
    cache: Path | None = None
    """Folder for templates; by default that of the user."""


def main() -> None:
    """Measure, and print a row per image."""
    options, console = tyro.cli(Options), Console(width=130)
    dataset = open_dataset(options.data)
    estimator = HashMatchEstimator.of_dataset(dataset, replace(HashMatchConfig(), cache=options.cache))
    table = Table("image", "instances", "core-s", "recorded", "share", "traced", "share", "MB")
    keys = some(list(dataset.images()), options.images)
    _row(estimator, dataset, keys[0])  # compiles and imports
    for key in keys:
        table.add_row(*_row(estimator, dataset, key))
    console.print(table)


def _row(estimator: HashMatchEstimator, dataset: Dataset, key: ImageKey) -> list[str]:
    image, targets = dataset.image(key), [target for target in dataset.annotated_targets() if target.image == key]
    begun = time.process_time()
    estimator.estimate(image, targets, NullRecorder())
    alone = time.process_time() - begun
    recording, tracing, instances, size = _recorded(estimator, dataset, key, targets)
    shares = [f"{100 * (seconds / alone):.1f} %" for seconds in (recording - alone, tracing)]
    where = f"scene {key.scene_id}, image {key.im_id}"
    return [
        where, str(instances), f"{alone:.1f}", f"{recording:.1f}", shares[0], f"{tracing:.2f}", shares[1],
        f"{size / 1e6:.1f}",
    ]  # fmt: skip


def _recorded(
    estimator: HashMatchEstimator, dataset: Dataset, key: ImageKey, targets: list[Target]
) -> tuple[float, float, int, int]:
    """Seconds with recording, seconds of tracing, instances traced, bytes."""
    image = dataset.image(key)
    assert image.depth is not None
    with tempfile.TemporaryDirectory() as folder:
        path, begun = Path(folder) / "image.rrd", time.process_time()
        with Recorder(path, "benchmark", key, image.camera) as recorder:
            if image.rgb is not None:
                recorder.image("image/rgb", image.rgb)
            recorder.depth("image/depth", image.depth)
            _, explain = explained(estimator, image, targets, recorder)
            assert explain is not None
            between = time.process_time()
            told = explain_targets(explain, dataset.ground_truth(key), targets, dataset.model, recorder)
            tracing = time.process_time() - between
        return time.process_time() - begun - tracing, tracing, len(told), path.stat().st_size


if __name__ == "__main__":
    main()
