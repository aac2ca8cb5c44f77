"""The part of `benchmarks/hashmatch.py` that measures time and memory."""

import resource
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from hashmatch_recall import some
from rich.console import Console
from rich.table import Table

from pipeline.bop.dataset import open_dataset
from pipeline.hashmatch.config import HashMatchConfig
from pipeline.hashmatch.dataset_models import focal_length
from pipeline.hashmatch.estimator import HashMatchEstimator
from pipeline.scene import Image, Model, Target

STAGES = ("pyramid", "objectness", "hashing", "verification", "nms")


@dataclass(frozen=True)
class Speed:
    """Seconds by stage with the thesis's templates (2,916 an object) of few and of many objects."""

    data: tuple[Path, ...] = (Path("assets/demo"),)
    """BOP datasets: images of the first one, which has depth, and models of all; where these are too few, copies."""
    objects: tuple[int, ...] = (1, 0, 15)
    """How many objects are looked for; 0 stands for all of the first dataset. These are the first ones; for 1, it is
    the mean over the `singles`."""
    singles: int = 3
    """Objects that are looked for one at a time, evenly chosen among all, as some take far longer than others."""
    images: int = 3
    """Images that are measured, evenly chosen."""
    repeats: int = 2
    """How often each is matched; the quickest counts, by core-seconds."""
    cache: Path | None = None
    """Folder for templates; by default a temporary one, so that learning is measured."""


class Row(NamedTuple):
    """What matching with a number of objects costs, means over the images."""

    objects: int
    templates: int
    megabytes: float
    """Of templates and tables."""
    learning: float
    """Core-seconds for an object that was not in the cache."""
    loading: float
    """Core-seconds for all objects and their tables, once learned."""
    stages: list[float]
    """Core-seconds of each stage."""
    core: float
    """Core-seconds of matching."""
    wall: float
    refining: float
    """Core-seconds of refining one instance of one object."""
    candidates: float
    peak: float
    """Largest memory of the process so far, megabytes."""


def speed(options: Speed, cache: Path, console: Console) -> None:
    """Match the same images with the templates of ever more objects."""
    dataset = open_dataset(options.data[0])
    counts = sorted({count or len(dataset.obj_ids) for count in options.objects})
    models, copies = _models(options.data, counts[-1])
    keys = some([key for key in dataset.images() if dataset.depth_path(key) is not None], options.images)
    images = [dataset.image(key) for key in keys]
    # symmetric objects keep their equal views, so that each has as many templates as in the thesis
    config, focal = HashMatchConfig(cache=cache, skip_symmetric_views=False), focal_length(dataset)
    rows, known = [], set[int]()
    for count in counts:
        first = np.linspace(0, counts[-1] - 1, options.singles).astype(int) if count == 1 else [0]
        several = [_measured(models[i : i + count], config, focal, images, options.repeats, known) for i in first]
        mean = Row(*(np.mean(values, axis=0) for values in zip(*several, strict=True)))
        rows.append(mean._replace(objects=count, templates=round(mean.templates)))
        console.print(_table(rows))
    if copies:
        console.print(
            f"{copies} of the {counts[-1]} objects are copies of others; more datasets after --data give models"
        )
    ratios = [f"{row.objects} to 1: {row.core / rows[0].core:.2f}" for row in rows[1:] if rows[0].objects == 1]
    console.print(f"core-seconds of matching, {', '.join(ratios)} (thesis, 15 to 1: 2.8 in wall time; exhaustive: 15)")


def _models(paths: Sequence[Path], count: int) -> tuple[list[Model], int]:
    """So many models under new ids, dataset after dataset and then from the start again, and how many are copies."""
    datasets = [open_dataset(path) for path in paths]
    own = [(dataset, obj_id) for dataset in datasets for obj_id in dataset.obj_ids]
    chosen = [own[i % len(own)] for i in range(count)]
    models = [replace(dataset.model(obj_id, "display"), obj_id=i + 1) for i, (dataset, obj_id) in enumerate(chosen)]
    return models, max(0, count - len(own))


def _measured(
    models: Sequence[Model], config: HashMatchConfig, focal: float, images: Sequence[Image], repeats: int,
    known: set[int],
) -> Row:  # fmt: skip
    """Learn what is not known yet, load it, and match all images."""
    few, begun = {model.obj_id: model for model in models}, time.process_time()
    HashMatchEstimator(few, config, focal)
    between = time.process_time()
    estimator = HashMatchEstimator(few, config, focal)
    loading = time.process_time() - between
    learning = max(0.0, between - begun - loading) / max(1, len(few.keys() - known))
    known |= few.keys()
    detector, rows = estimator.detector, []
    detector.match(images[0])  # compiles
    for image in images:
        tried = []
        for _ in range(repeats):
            core, wall = time.process_time(), time.perf_counter()
            matching = detector.match(image)
            core, wall = time.process_time() - core, time.perf_counter() - wall
            found = sum(len(level.candidates.windows) for level in matching.levels)
            tried.append([core, wall, found, *(matching.seconds[stage] for stage in STAGES)])
        begun = time.process_time()
        detector.match(image, np.arange(len(detector.objects)) == 0)
        between = time.process_time()
        estimator.found(image, [Target(*image.key, detector.objects[0].obj_id, 1)])
        refining = time.process_time() - between - (between - begun)
        rows.append([*min(tried), max(refining, 0.0)])
    core, wall, found, *stages, refining = np.mean(rows, axis=0).tolist()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    size = detector.nbytes() / 2**20
    return Row(len(detector.objects), len(detector.tables.objects), size, learning, loading, stages, core, wall,
               refining, found, peak)  # fmt: skip


def _table(rows: Sequence[Row]) -> Table:
    table = Table("objects", "templates", "MB", "peak MB", "learn 1", "load", *STAGES, "match core-s", "wall s",
                  "refine core-s", "candidates", title="core-seconds per image")  # fmt: skip
    for row in rows:
        numbers = (row.learning, row.loading, *row.stages, row.core, row.wall, row.refining)
        table.add_row(str(row.objects), str(row.templates), f"{row.megabytes:.0f}", f"{row.peak:.0f}",
                      *(f"{value:.2f}" for value in numbers), f"{row.candidates:,.0f}")  # fmt: skip
    return table
