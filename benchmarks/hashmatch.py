"""HashMatch: seconds by stage with few and many templates, memory, and recall on any dataset with depth.

    python benchmarks/hashmatch.py speed [--data assets/demo LMO]    # thesis's templates (2,916 a model) of 1, 8, 15 objects
    python benchmarks/hashmatch.py recall [--data assets/demo] [--images N] [--scene S] [--why] [--compare]
    python benchmarks/hashmatch.py recall --data LMO --thesis-views --pictures FOLDER

Nothing is asserted. Core-seconds are processor time of all threads. For speed, images are of the first dataset and
models of all that are named; where there are too few, the same models are taken again, under other ids. Recall is the
share of instances that are at least 10 % visible whose pose has VSD < 0.3 (tau 20 mm, delta 15 mm, as in the BOP
Challenge 2017), every instance sought with its count (ViVo); beside it BOP's average recalls over the thresholds of
MSSD (0.05 to 0.5 of the diameter) and MSPD (5 to 50 px for images 640 px wide). Where the objects lie in all
orientations, as in the demo, views of the whole sphere are taken; `--thesis-views` takes the upper hemisphere of the
thesis. `--why` says of each lost instance which stage lost it; `--compare` runs Open3D's global registration (FPFH
features, RANSAC, ICP) on the same targets. Images without ground truth get their objects from `--objects` (all, by
default), one of each or `--count`, and only pictures.
"""

import tempfile
from pathlib import Path

import tyro
from hashmatch_recall import Recall, recall
from hashmatch_speed import Speed, speed
from rich.console import Console


def main() -> None:
    """Run the benchmark that is chosen on the command line."""
    chosen = tyro.cli(Speed | Recall)  # type: ignore[arg-type]
    with tempfile.TemporaryDirectory() as folder:
        cache = chosen.cache or Path(folder)
        if isinstance(chosen, Speed):
            speed(chosen, cache, Console(width=150))
        else:
            recall(chosen, cache, Console(width=150))


if __name__ == "__main__":
    main()
