"""Make the demo: our eight parts as models, the dataset of them, and made results of two made methods.

    python -m pipeline.synth.demo --out assets

The images are those of the configurations `demo` and `demo_turntable` of `inspector synthesize`. The same seed gives the
same files on the same machine; an interrupted run continues. Needs the extra `synth`; what it makes needs nothing.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2

from pipeline.bop.dataset import open_dataset
from pipeline.bop.json_files import write_atomically
from pipeline.bop.results import Results, write_results
from pipeline.parallel import open_workers
from pipeline.synth.demo import made_errors, part_files
from pipeline.synth.demo.preview import contact_sheet
from pipeline.synth.generation.config_file import read_config
from pipeline.synth.generation.run import synthesize

CONFIGS = ("demo", "demo_turntable")


@dataclass(frozen=True)
class DemoConfig:
    """What to make."""

    out: Path = Path("assets")
    """Folder that gets `models/` and `demo/`."""
    workers: int = 2
    """Processes that work at once."""


def make_demo(config: DemoConfig, progress: Callable[[str], None] | None = None) -> None:
    """Write everything under `config.out`; images that are there already stay. Raises InputError."""
    root = config.out / "demo"
    part_files.write_part_models(config.out / "models")
    sheet = cv2.cvtColor(contact_sheet(), cv2.COLOR_RGB2BGR)
    png = cv2.imencode(".png", sheet, [cv2.IMWRITE_PNG_COMPRESSION, 9])[1]
    write_atomically(config.out / "models" / "preview.png", png.tobytes())
    for name in CONFIGS:
        asked = read_config(Path(name))

        def tell(done: int, name: str = name, total: int = asked.images) -> None:
            if progress is not None:
                progress(f"{name}: {done} of {total} images")

        with open_workers(config.workers) as workers:
            synthesize(asked, root, workers, config.workers, tell)
    write_made_results(root)


def write_made_results(root: Path) -> None:
    """Write the results of the made methods, and beside them what was done to each estimate."""
    dataset = open_dataset(root)
    kinds = {}
    for method in made_errors.METHODS:
        made = made_errors.made_estimates(dataset, method)
        results = Results.from_estimates([item.estimate for item in made], method.name, "demo", "test")
        write_results(root / "results" / f"{method.name}_demo-test.csv", results)
        kinds[method.name] = {"seed": method.seed, "kind_of_row": [item.kind for item in made]}
    write_atomically(root / "results" / "made_errors.json", json.dumps(kinds, indent=1).encode())


if __name__ == "__main__":
    import tyro
    from rich.console import Console

    with Console(stderr=True).status("") as status:
        make_demo(tyro.cli(DemoConfig), status.update)
