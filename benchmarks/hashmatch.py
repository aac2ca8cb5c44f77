"""HashMatch: seconds by stage with few and many templates, memory, and recall on any dataset with depth.

    python benchmarks/hashmatch.py speed [--data assets/demo]     # thesis's templates (2,916 a model), 1 object to all
    python benchmarks/hashmatch.py recall [--data assets/demo] [--images N] [--scene S] [--why] [--compare]
    python benchmarks/hashmatch.py recall --data LMO --thesis-views --pictures FOLDER

Nothing is asserted. Core-seconds are processor time of all threads. Recall is the share of instances that are at least
10 % visible whose pose has VSD < 0.3 (tau 20 mm, delta 15 mm, as in the BOP Challenge 2017), every instance sought with
its count (ViVo); beside it BOP's average recalls over the thresholds of MSSD (0.05 to 0.5 of the diameter) and MSPD (5
to 50 px for images 640 px wide). Where the objects lie in all orientations, as in the demo, views of the whole sphere
are taken; `--thesis-views` takes the upper hemisphere of the thesis. `--why` says of each lost instance which stage lost
it; `--compare` runs Open3D's global registration (FPFH features, RANSAC, ICP) on the same targets. Images without
ground truth get their objects from `--objects` (all, by default), one of each or `--count`, and only pictures.
"""

import resource
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from hashmatch_recall import Recall, recall, some
from rich.console import Console
from rich.table import Table

from pipeline.bop.dataset import open_dataset
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.estimator import HashMatchEstimator
from pipeline.scene import Target


@dataclass(frozen=True)
class Speed:
    """Seconds by stage, with the templates of one object and of all."""

    data: Path = Path("assets/demo")
    """A BOP dataset with depth."""
    images: int = 3
    """Images that are measured, evenly chosen."""
    cache: Path | None = None
    """Folder for templates; by default a temporary one, so that learning is measured."""


def main() -> None:
    """Run the benchmark that is chosen on the command line."""
    chosen = tyro.cli(Speed | Recall)  # type: ignore[arg-type]
    with tempfile.TemporaryDirectory() as folder:
        cache = chosen.cache or Path(folder)
        if isinstance(chosen, Speed):
            speed(chosen, cache, Console(width=150))
        else:
            recall(chosen, cache, Console(width=150))


def speed(options: Speed, cache: Path, console: Console) -> None:
    """Match the same images for one object, with the templates of one object and of all loaded."""
    dataset = open_dataset(options.data)
    table = Table("objects", "templates", "MB", "learn", "tables", "pyramid", "objectness", "hashing", "verification",
                  "match wall", "match core-s", "refine core-s")  # fmt: skip
    first = dataset.obj_ids[0]
    per_object = []
    for obj_ids in ((first,), dataset.obj_ids):
        begun = time.process_time()
        HashMatchEstimator.of_dataset(dataset, HashMatchConfig(cache=cache), obj_ids)
        learned = time.process_time() - begun
        begun = time.process_time()
        estimator = HashMatchEstimator.of_dataset(dataset, HashMatchConfig(cache=cache), obj_ids)
        loaded = time.process_time() - begun
        detector = estimator.detector
        rows = []
        for key in some(list(dataset.images()), options.images):
            image = dataset.image(key)
            for repeat in range(2 if not rows else 1):  # the first one compiles
                core, wall = time.process_time(), time.perf_counter()
                matching = detector.match(image)
                core, wall = time.process_time() - core, time.perf_counter() - wall
                if repeat == 0 and not rows:
                    continue
                begun = time.process_time()
                estimator.found(image, [Target(*key, first, 1)])
                both = time.process_time() - begun
                stages = [matching.seconds[name] for name in ("pyramid", "objectness", "hashing", "verification")]
                rows.append([*stages, wall, core, max(both - core, 0.0)])
        mean = np.mean(rows, axis=0)
        per_object.append(mean[5])
        megabytes = f"{detector.nbytes() / 2**20:.0f}"
        cells = [f"{seconds:.2f}" for seconds in (learned, loaded, *mean)]
        table.add_row(str(len(obj_ids)), str(len(detector.tables.objects)), megabytes, *cells)
    console.print(table)
    console.print(f"core-seconds of matching, all objects by one: {per_object[1] / per_object[0]:.2f} "
                  f"(exhaustive: {len(dataset.obj_ids)}; thesis, 15 objects: 2.8 in wall time)")  # fmt: skip
    console.print(f"largest memory of the process: {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
