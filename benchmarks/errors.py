"""Cost of the pose errors on LM-O, one core, against direct numpy code in the manner of bop_toolkit.

    python benchmarks/errors.py [--data DIR]    (DIR: folder of LM-O in BOP format; default ../shared/data/lmo)

Nothing is asserted. Times are medians over pairs of an estimate and a ground-truth pose of the same object, in
milliseconds; the last column is how many times faster than the numpy code on the same pairs in this same run.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

if hasattr(os, "sched_setaffinity"):  # before the libraries start their threads
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from pipeline.bop import errors
from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.results import read_results
from pipeline.bop.vsd import DELTA, TAUS, vsd, vsd_of_poses
from pipeline.geometry import distance_from_depth, transform
from pipeline.ray_casting import Box, cast
from pipeline.rendering import render_depths
from pipeline.scene import Camera, ImageKey, Model

DATA = Path(os.environ.get("INSPECTOR_SHARED_DATA", "../shared/data")) / "lmo"
KEY_WITH_DEPTH = ImageKey(2, 3)
REPEATS = 5


class Pair(NamedTuple):
    """An estimate to be compared with a ground-truth pose."""

    model: Model
    camera: Camera
    estimate: np.ndarray
    truth: np.ndarray


Cost = Callable[[Pair], object]

# ---- direct numpy code


def placed(model: Model, pose: np.ndarray) -> np.ndarray:
    """Vertices in the camera frame."""
    return model.vertices @ pose[:3, :3].T + pose[:3, 3]


def projected(model: Model, K: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Pixels of the vertices."""
    pixels = placed(model, pose) @ K.T
    return pixels[:, :2] / pixels[:, 2:]


def numpy_mssd(pair: Pair) -> float:
    """MSSD over all vertices and symmetries."""
    estimate = placed(pair.model, pair.estimate)
    truths = (placed(pair.model, pair.truth @ S) for S in pair.model.symmetries)
    return min(np.linalg.norm(estimate - truth, axis=1).max() for truth in truths)


def numpy_mspd(pair: Pair) -> float:
    """MSPD over all vertices and symmetries."""
    estimate = projected(pair.model, pair.camera.K, pair.estimate)
    truths = (projected(pair.model, pair.camera.K, pair.truth @ S) for S in pair.model.symmetries)
    return min(np.linalg.norm(estimate - truth, axis=1).max() for truth in truths)


def numpy_add(pair: Pair) -> float:
    """ADD."""
    return np.linalg.norm(placed(pair.model, pair.estimate) - placed(pair.model, pair.truth), axis=1).mean()


def numpy_adi(pair: Pair) -> float:
    """ADI with a tree of the vertices at the estimate."""
    return cKDTree(placed(pair.model, pair.estimate)).query(placed(pair.model, pair.truth))[0].mean()


def numpy_vsd(depth: np.ndarray) -> Cost:
    """VSD on whole images: every pixel is cast and compared, and the two poses are rendered one by one."""

    def cost(pair: Pair) -> list[float]:
        camera = pair.camera
        image = Box(0, 0, camera.width, camera.height)
        hits = (cast(pair.model, camera, pose[None], [image], 0.5)[0].depth for pose in (pair.estimate, pair.truth))
        estimate, truth = (distance_from_depth(camera.K, np.where(np.isfinite(z), z, 0)) for z in hits)
        test = distance_from_depth(camera.K, depth)
        seen_truth = ((truth.astype(np.float32) - test.astype(np.float32) <= DELTA) | (test == 0)) & (truth > 0)
        seen = ((estimate.astype(np.float32) - test.astype(np.float32) <= DELTA) | (test == 0)) & (estimate > 0)
        seen |= seen_truth & (estimate > 0)
        both, union = seen & seen_truth, np.count_nonzero(seen | seen_truth)
        off = np.abs(truth[both] - estimate[both]) / pair.model.diameter
        return [(np.sum(off >= tau) + union - both.sum()) / union if union else 1.0 for tau in TAUS]

    return cost


# ---- pairs


def pairs_of_results(dataset: Dataset, results_file: Path) -> list[Pair]:
    """Every submitted estimate with the ground truth of its object in its image."""
    results = read_results(results_file)
    return [
        Pair(dataset.model(gt.obj_id), dataset.camera(key), estimate.camera_from_model, gt.camera_from_model)
        for key in dataset.images()
        for gt in dataset.ground_truth(key)
        for estimate in results.estimates(key, gt.obj_id)
    ]


def pairs_with_depth(dataset: Dataset) -> list[Pair]:
    """Ground truth of the image with depth against poses some degrees and millimetres off."""
    rng = np.random.default_rng(0)
    pairs = []
    for gt in dataset.ground_truth(KEY_WITH_DEPTH) * 4:
        truth = gt.camera_from_model
        turned = Rotation.from_rotvec(rng.normal(scale=0.1, size=3)).as_matrix() @ truth[:3, :3]
        estimate = transform(turned, truth[:3, 3] + rng.normal(scale=0.005, size=3))
        pairs.append(Pair(dataset.model(gt.obj_id), dataset.camera(KEY_WITH_DEPTH), estimate, truth))
    return pairs


def with_continuous_symmetry(pairs: list[Pair]) -> list[Pair]:
    """The same pairs, each model with 315 turns about its z axis."""
    turns = Rotation.from_rotvec(np.linspace(0, 2 * np.pi, 315, endpoint=False)[:, None] * [0, 0, 1]).as_matrix()
    symmetries = np.tile(np.eye(4), (315, 1, 1))
    symmetries[:, :3, :3] = turns
    models = {model: replace(model, symmetries=symmetries) for model in {pair.model for pair in pairs}}
    return [pair._replace(model=models[pair.model]) for pair in pairs]


# ---- measuring


def median_ms(cost: Cost, pairs: list[Pair]) -> float:
    """Median over pairs of the best of some repeats."""
    for pair in {pair.model: pair for pair in pairs}.values():
        cost(pair)  # compiles, and builds what is kept per model
    return float(np.median([min(_seconds(cost, pair) for _ in range(REPEATS)) for pair in pairs])) * 1000


def _seconds(cost: Cost, pair: Pair) -> float:
    start = time.perf_counter()
    cost(pair)
    return time.perf_counter() - start


def compile_seconds() -> tuple[float, float]:
    """Seconds of the first MSSD, MSPD and ADD in a new process: without and with machine code on disk."""
    code = (
        "import numpy as np, time; from pipeline.scene import Model; from pipeline.bop import errors\n"
        "v = np.random.default_rng(0).normal(size=(50, 3)); m = Model(1, v, np.array([[0, 1, 2]], np.int32), 1.0)\n"
        "from pipeline.model_cache import convex_hull; convex_hull(m); e = np.eye(4); t = time.perf_counter()\n"
        "errors.mssd(m, e, e); errors.mspd(m, e[:3, :3], e, e); errors.add(m, e, e); print(time.perf_counter() - t)"
    )
    with tempfile.TemporaryDirectory() as folder:
        env = os.environ | {"NUMBA_CACHE_DIR": folder}
        cold, cached = (
            float(subprocess.run([sys.executable, "-c", code], env=env, check=True, capture_output=True).stdout)
            for _ in range(2)
        )
    return cold, cached


def main(data: Path = DATA) -> None:
    """Measure and print the table."""
    dataset = open_dataset(data)
    depth = dataset.depth(KEY_WITH_DEPTH)
    assert depth is not None
    submitted = pairs_of_results(dataset, data / "results" / "megapose_lmo-test.csv")
    in_depth = pairs_with_depth(dataset)
    symmetric, close = with_continuous_symmetry(submitted[::20]), submitted[::20]

    def rendered(pair: Pair) -> object:
        return render_depths(pair.model, pair.camera, np.stack([pair.estimate, pair.truth]))

    renderings = {id(pair): render_depths(pair.model, pair.camera, np.stack(pair[2:])) for pair in in_depth}

    rows: list[tuple[str, list[Pair], Cost, Cost | None]] = [
        ("MSSD", submitted, lambda p: errors.mssd(p.model, p.estimate, p.truth), numpy_mssd),
        ("MSPD", submitted, lambda p: errors.mspd(p.model, p.camera.K, p.estimate, p.truth), numpy_mspd),
        ("MSSD, 315 symmetries", symmetric, lambda p: errors.mssd(p.model, p.estimate, p.truth), numpy_mssd),
        (
            "MSPD, 315 symmetries",
            symmetric,
            lambda p: errors.mspd(p.model, p.camera.K, p.estimate, p.truth),
            numpy_mspd,
        ),
        ("ADD", submitted, lambda p: errors.add(p.model, p.estimate, p.truth), numpy_add),
        ("ADI", close, lambda p: errors.adi(p.model, p.estimate, p.truth), numpy_adi),
        ("VSD, 10 taus", in_depth, lambda p: vsd_of_poses(*p, depth), numpy_vsd(depth)),
        ("  of which rendering", in_depth, rendered, None),
        ("  of which the rest", in_depth, lambda p: vsd(*renderings[id(p)], depth, p.camera.K, p.model.diameter), None),
    ]
    table = Table("error", "pairs", "ms", "numpy ms", "times faster", title=f"{data.name}, median per pair, one core")
    for name, pairs, cost, reference in rows:
        ours = median_ms(cost, pairs)
        theirs = median_ms(reference, pairs[:: 1 + len(pairs) // 100]) if reference else None
        compared = [f"{theirs:.4f}", f"{theirs / ours:.0f}"] if theirs else ["", ""]
        table.add_row(name, str(len(pairs)), f"{ours:.4f}", *compared)
    Console().print(table)
    cold, cached = compile_seconds()
    Console().print(f"first MSSD, MSPD and ADD of a process: {cold:.1f} s to compile, {cached:.2f} s from disk")


if __name__ == "__main__":
    tyro.cli(main)
