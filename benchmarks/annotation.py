"""Cost of judging ground truth and of correcting depth, against plain loops in the same run.

    python benchmarks/annotation.py [--dataset DIR] [--split NAME] [--images N] [--repeats N]

Nothing is asserted. Seconds are of processor time. The plain loop does what a throw-away script would: for each
annotated instance a ray through every pixel of the image (Open3D), then the statistics in NumPy, occlusion by other
annotated objects left out. The plain correction computes each pixel in floating point, clips and rounds it.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import open3d as o3d
import tyro
from rich.console import Console
from rich.table import Table

from annotate.depth import correct_raw
from annotate.quality import measure_instances
from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.scene import Image, ImageKey, Model


@dataclass(frozen=True)
class Config:
    """What to measure on."""

    dataset: Path = Path(__file__).resolve().parent.parent / "assets" / "demo"
    """Folder of a BOP dataset."""
    split: str | None = None
    """Folder of the split; by default the official test split."""
    images: int = 6
    """Images with depth and annotations, from the beginning."""
    repeats: int = 5
    """Of each measurement; the shortest counts."""


def plain_statistics(image: Image, models: dict[int, Model], truths: list) -> list[tuple[float, ...]]:
    """Mean, standard deviation, mean and median absolute difference of every instance, the obvious way."""
    v, u = np.indices(image.depth.shape)
    directions = np.stack([u + 0.5, v + 0.5, np.ones(u.shape)], axis=-1) @ np.linalg.inv(image.camera.K).T
    found = []
    for truth in truths:
        model = models[truth.obj_id]
        points = model.vertices @ truth.camera_from_model[:3, :3].T + truth.camera_from_model[:3, 3]
        scene = o3d.t.geometry.RaycastingScene()
        scene.add_triangles(o3d.core.Tensor(points.astype(np.float32)), o3d.core.Tensor(model.faces.astype(np.uint32)))
        rays = np.concatenate([np.zeros_like(directions), directions], axis=-1).astype(np.float32)
        rendered = scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
        both = np.isfinite(rendered) & (image.depth > 0)
        difference = image.depth[both] - rendered[both]
        kept = difference[np.abs(difference) <= 0.05]
        if len(kept):
            found.append((kept.mean(), kept.std(), np.abs(kept).mean(), np.median(np.abs(kept))))
    return found


def plain_correction(raw: np.ndarray, scale_mm: float, a: float, b: float) -> np.ndarray:
    """The correction pixel by pixel."""
    corrected = np.rint(a * raw.astype(np.float64) + b * 1000.0 / scale_mm)
    corrected[raw == 0] = 0
    return np.clip(corrected, 0, 65535).astype(np.uint16)


def shortest(work: Callable[[], object], repeats: int) -> float:
    """Processor seconds of the shortest of some runs, after one that does not count."""
    work()
    spent = []
    for _ in range(repeats):
        begun = time.process_time()
        work()
        spent.append(time.process_time() - begun)
    return min(spent)


def chosen(dataset: Dataset, count: int) -> list[ImageKey]:
    """The first images with depth and annotations."""
    keys = (key for key in dataset.images() if dataset.depth_path(key) and dataset.ground_truth(key))
    return [key for key, _ in zip(keys, range(count), strict=False)]


def main(config: Config) -> None:
    """Measure and print."""
    dataset = open_dataset(config.dataset, config.split)
    keys = chosen(dataset, config.images)
    images = [dataset.image(key) for key in keys]
    truths = [list(dataset.ground_truth(key)) for key in keys]
    models = {truth.obj_id: dataset.model(truth.obj_id) for own in truths for truth in own}
    pairs = list(zip(images, truths, strict=True))
    count = sum(map(len, truths))

    def ours(with_colour: bool) -> None:
        for image, own in pairs:
            rgb = image.rgb if with_colour else None
            measure_instances(image.key, own, models, image.camera, rgb, image.depth)

    plain = shortest(lambda: [plain_statistics(image, models, own) for image, own in pairs], config.repeats)
    depth_only = shortest(lambda: ours(False), config.repeats)
    both = shortest(lambda: ours(True), config.repeats)
    scale = dataset.depth_scale_mm(keys[0])
    raw = np.rint(images[0].depth * (1000.0 / scale)).astype(np.uint16)
    by_pixel = shortest(lambda: plain_correction(raw, scale, 1.0247, -0.00519), 5 * config.repeats)
    by_table = shortest(lambda: correct_raw(raw, scale, 1.0247, -0.00519), 5 * config.repeats)

    table = Table(title=f"{dataset.name}: {count} instances in {len(keys)} images")
    for name in ("what", "ms", "plain ms", "ratio"):
        table.add_column(name, justify="left" if name == "what" else "right")
    rows = (
        ("depth statistics of an instance", depth_only / count, plain / count),
        ("with contour and shift", both / count, plain / count),
        (f"depth correction of {raw.shape[1]} x {raw.shape[0]}", by_table, by_pixel),
    )
    for name, own, other in rows:
        table.add_row(name, f"{1000 * own:.2f}", f"{1000 * other:.2f}", f"{other / own:.1f}")
    Console(width=100).print(table)


if __name__ == "__main__":
    main(tyro.cli(Config))
