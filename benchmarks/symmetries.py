"""Cost of the search of symmetries, per model, against brute force over sampled rotations.

    python benchmarks/symmetries.py [--parts DIR] [--lmo DIR] [--brute-samples N]

Nothing is asserted. Brute force takes rotations about the centre of area, 10 degrees apart (axes on a half sphere, and
angles), and for each the full Hausdorff distance of all samples, both ways, at the exact nearest faces; it finds no
offset of an axis, and no axis to better than some degrees. It is timed on some of the rotations and told for all.
Seconds are wall-clock with all cores; the last column is how many times longer brute force takes in this same run.
"""

import os
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from pipeline.bop.models_info.model_set import open_models
from pipeline.bop.models_info.symmetries import group_from
from pipeline.symmetry_search.screening import directions
from pipeline.symmetry_search.search import find_symmetries
from pipeline.symmetry_search.surface import Surface

SHARED = Path(os.environ.get("INSPECTOR_SHARED_DATA", "../shared/data"))
STEP_DEGREES = 10


@dataclass(frozen=True)
class Config:
    """What to search."""

    parts: Path = Path(__file__).resolve().parent.parent / "assets" / "models"
    """Folder of our own parts."""
    lmo: Path = SHARED / "lmo" / "models_eval"
    """Folder of LM-O's models; left out where it is absent."""
    brute_samples: int = 12
    """Rotations that brute force is timed on."""


def rotations() -> np.ndarray:
    """Axis-angle samples of brute force."""
    axes = directions(round(2 * np.pi / np.radians(STEP_DEGREES) ** 2))
    angles = np.radians(np.arange(STEP_DEGREES, 181, STEP_DEGREES))
    return (axes[:, None] * angles[None, :, None]).reshape(-1, 3)


def brute_force(surface: Surface, count: int) -> float:
    """Seconds for all rotations, from those of an even sample."""
    vectors = rotations()
    sample = vectors[np.linspace(0, len(vectors) - 1, count).astype(int)]
    begun = time.perf_counter()
    for R in Rotation.from_rotvec(sample).as_matrix():
        max(surface.distances(surface.samples @ turn.T).max() for turn in (R, R.T))
    return (time.perf_counter() - begun) / count * len(vectors)


def main(config: Config) -> None:
    """Search all models, the first one once before, so that nothing is compiled or imported while it is timed."""
    table = Table(title=f"{len(rotations())} rotations of brute force, {os.cpu_count()} cores")
    for name in ("model", "faces", "samples", "candidates", "suggested", "as listed", "s", "CPU s", "brute s", "ratio"):
        table.add_column(name, justify="left" if name in ("model", "suggested", "as listed") else "right")
    warm, slowest = False, 0.0
    for folder in (config.parts, config.lmo):
        if not folder.is_dir():
            Console().print(f"{folder}: absent, left out")
            continue
        models = open_models(folder)
        for file in models.files:
            info = models.infos().get(file.obj_id or -1, {})
            model = models.read(file, info)
            if not warm:
                find_symmetries(model)
                warm = True
            begun = time.process_time()
            found = find_symmetries(model)
            cpu, brute = time.process_time() - begun, brute_force(found.surface, config.brute_samples)
            slowest = max(slowest, found.seconds)
            same = found.group.equals(group_from(info), found.surface.extent)
            table.add_row(
                f"{folder.parent.name} {file.name}",
                str(len(model.faces)),
                str(len(found.surface.samples)),
                str(len(found.candidates)),
                found.group.name,
                "yes" if same else "no",
                f"{found.seconds:.1f}",
                f"{cpu:.1f}",
                f"{brute:.0f}",
                f"{brute / found.seconds:.0f}",
            )
    Console(width=130).print(table)
    Console().print(f"slowest model: {slowest:.1f} s")


if __name__ == "__main__":
    main(tyro.cli(Config))
