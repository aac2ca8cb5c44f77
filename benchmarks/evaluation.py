"""Cost of whole evaluations on one core, against direct code in the manner of the benchmark's scripts, in one run.

    python benchmarks/evaluation.py [--data DIR]    (DIR: folder of LM-O in BOP format; default ../shared/data/lmo)

Nothing is asserted about times, but both must give the same scores. The images there are taken four times, as scenes
of their own, which makes the number of pairs that of the benchmark. Times are the best of some repeats; ratios are of CPU times.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

import errors as direct  # pins the process to one core
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.evaluation.evaluate import evaluate
from pipeline.bop.evaluation.pose_detection import evaluate_pose_detection
from pipeline.bop.evaluation.siso import evaluate_siso
from pipeline.bop.results import Results, read_results, write_results
from pipeline.bop.vsd import vsd, vsd_of_poses
from pipeline.ray_casting import _answer, _fill_rays, visible_box
from pipeline.rendering import render_depths

COPIES = 4
REPEATS = 5
DEMO = Path(__file__).resolve().parent.parent / "assets" / "demo"
T = TypeVar("T")

# ---- data


def copied(data: Path, folder: Path) -> tuple[Path, Path]:
    """A dataset of LM-O's scene under several numbers, and results for it."""
    root = folder / "lmo"
    (root / "test").mkdir(parents=True)
    for name in ("models_eval", "camera.json"):
        (root / name).symlink_to((data / name).resolve())
    targets = json.loads((data / "test_targets_bop19.json").read_text())
    for scene_id in range(2, 2 + COPIES):
        (root / "test" / f"{scene_id:06d}").symlink_to((data / "test" / "000002").resolve())
    many = [target | {"scene_id": scene_id} for scene_id in range(2, 2 + COPIES) for target in targets]
    (root / "test_targets_bop19.json").write_text(json.dumps(many))
    (path,) = (data / "results").glob("*_lmo-test.csv")
    one = read_results(path)
    columns = {name: value for name, value in vars(one).items() if isinstance(value, np.ndarray)}
    columns = {name: np.concatenate([value] * COPIES) for name, value in columns.items()}
    columns["scene_id"] = np.repeat(np.arange(2, 2 + COPIES), len(one))
    many_path = folder / path.name
    write_results(many_path, Results(**columns, method=one.method, dataset_name="lmo", split="test"))
    return root, many_path


# ---- direct code


def direct_errors(dataset: Dataset, results: Results) -> list[dict[str, Any]]:
    """Errors of the best estimate of every target, as the benchmark's scripts write them to JSON files."""
    entries = []
    for target in dataset.targets():
        camera = dataset.camera(target.image)
        truths = [gt for gt in dataset.ground_truth(target.image) if gt.obj_id == target.obj_id]
        model = dataset.model(target.obj_id)
        estimates = sorted(results.estimates(target.image, target.obj_id), key=lambda e: -e.score)[: target.inst_count]
        for estimate in estimates:
            pairs = [direct.Pair(model, camera, estimate.camera_from_model, gt.camera_from_model) for gt in truths]
            near = [np.linalg.norm(p.estimate[:3, 3] - p.truth[:3, 3]) < model.diameter for p in pairs]
            mssd = [direct.numpy_mssd(p) / model.diameter if n else np.inf for p, n in zip(pairs, near, strict=True)]
            mspd = [direct.numpy_mspd(p) * 640 / camera.width for p in pairs]
            entries.append({"target": list(target[:3]), "score": estimate.score, "mssd": mssd, "mspd": mspd})
    return entries


def direct_recalls(dataset: Dataset, results: Results, folder: Path) -> tuple[float, float]:
    """AR_MSSD and AR_MSPD: errors go through a file, which is read again for every threshold."""
    path = folder / "errors.json"
    path.write_text(json.dumps(direct_errors(dataset, results)))
    asked = sum(target.inst_count for target in dataset.targets())
    means = []
    for name, thetas in (("mssd", np.arange(0.05, 0.51, 0.05)), ("mspd", np.arange(5, 51, 5))):
        recalls = []
        for theta in thetas:
            found = 0
            taken: set[tuple] = set()
            for entry in sorted(json.loads(path.read_text()), key=lambda entry: -entry["score"]):
                best, best_error = None, theta
                for g, error in enumerate(entry[name]):
                    if (*entry["target"], g) not in taken and error < best_error:
                        best, best_error = (*entry["target"], g), error
                if best:
                    taken.add(best)
                    found += 1
            recalls.append(found / asked)
        means.append(float(np.mean(recalls)))
    return means[0], means[1]


def direct_siso(dataset: Dataset, results: Results) -> float:
    """Recall of 2017: whole images are rendered and compared for every pair."""
    found, asked = 0, 0
    for target in dataset.targets():
        camera, model, depth = dataset.camera(target.image), dataset.model(target.obj_id), dataset.depth(target.image)
        assert depth is not None
        truths = [gt for gt in dataset.ground_truth(target.image) if gt.obj_id == target.obj_id]
        truths = [gt for gt in truths if gt.visible_fraction is None or gt.visible_fraction >= 0.1]
        asked += bool(truths)
        for estimate in results.estimates(target.image, target.obj_id)[:1]:
            pairs = [direct.Pair(model, camera, estimate.camera_from_model, gt.camera_from_model) for gt in truths]
            found += any(direct_vsd_2017(pair, depth) < 0.3 for pair in pairs)
    return found / asked


def direct_vsd_2017(pair: direct.Pair, depth: np.ndarray) -> float:
    """VSD with tau 20 mm, delta 15 mm, unmeasured pixels not visible."""
    camera = pair.camera
    image = direct.Box(0, 0, camera.width, camera.height)
    hits = (direct.cast(pair.model, camera, pose[None], [image], 0.5)[0].depth for pose in (pair.estimate, pair.truth))
    at_estimate, at_truth = (direct.distance_from_depth(camera.K, np.where(np.isfinite(z), z, 0)) for z in hits)
    test = direct.distance_from_depth(camera.K, depth)
    seen_truth = (at_truth - test <= 0.015) & (test > 0) & (at_truth > 0)
    seen = ((at_estimate - test <= 0.015) & (test > 0) | seen_truth) & (at_estimate > 0)
    both, union = seen & seen_truth, np.count_nonzero(seen | seen_truth)
    wrong = np.count_nonzero(np.abs(at_truth[both] - at_estimate[both]) >= 0.02)
    return (wrong + union - np.count_nonzero(both)) / union if union else 1.0


def direct_detection(dataset: Dataset, results: Results) -> float:
    """Mean average precision of MSSD for one instance of each object in an image, all thresholds in plain loops."""
    errors = {}
    for key in dataset.images():
        for gt in dataset.ground_truth(key):
            for row, estimate in enumerate(results.estimates(key, gt.obj_id)):
                pair = direct.Pair(
                    dataset.model(gt.obj_id), dataset.camera(key), estimate.camera_from_model, gt.camera_from_model
                )
                near = np.linalg.norm(pair.estimate[:3, 3] - pair.truth[:3, 3]) < pair.model.diameter
                mssd = direct.numpy_mssd(pair) / pair.model.diameter if near else np.inf
                errors[(*key, gt.obj_id, row)] = (estimate.score, mssd, direct.numpy_mspd(pair))
    asked = {tuple(target[:3]) for target in dataset.targets()}
    of_objects = []
    for obj_id in sorted({ids[2] for ids in asked}):
        means = []
        for column, thetas in ((1, np.arange(0.05, 0.51, 0.05)), (2, np.arange(5, 51, 5))):
            values = []
            for theta in thetas:
                taken, right = set(), []
                for ids, values_of in sorted(errors.items(), key=lambda item: -item[1][0]):
                    if ids[2] == obj_id:
                        is_right = values_of[column] < theta and ids[:3] not in taken
                        if is_right:
                            taken.add(ids[:3])
                        if ids[:3] in asked or not is_right:
                            right.append(is_right)
                values.append(direct_precision(right, sum(ids[2] == obj_id for ids in asked)))
            means.append(float(np.mean(values)))
        of_objects.append(means)
    return float(np.mean(np.mean(of_objects, axis=0)))


def direct_precision(right: list[bool], asked: int) -> float:
    """Precision sampled at 101 recalls."""
    found = np.cumsum(right)
    precisions, recalls = found / np.arange(1, len(right) + 1), found / asked
    at = [precisions[recalls >= recall] for recall in np.linspace(0, 1, 101)]
    return float(np.mean([part.max() if len(part) else 0.0 for part in at]))


# ---- measuring


class Cost(NamedTuple):
    """What a call takes, in seconds; the two differ where other processes use the core, too."""

    wall: float
    cpu: float
    """Of this process and those that it has waited for."""

    def __str__(self) -> str:
        return f"{self.wall:.3f} s ({self.cpu:.3f})"


def best(call: Callable[[], T], repeats: int = REPEATS) -> tuple[Cost, T]:
    """The least of some calls, and what they return."""
    walls, cpus = [], []
    for _ in range(repeats):
        begun, cpu = time.perf_counter(), _cpu()
        result = call()
        walls.append(time.perf_counter() - begun)
        cpus.append(_cpu() - cpu)
    return Cost(min(walls), min(cpus)), result


def _cpu() -> float:
    used = os.times()
    return used.children_user + used.children_system + time.process_time()


def command_cost(root: Path, path: Path, *options: str) -> Cost:
    """What the command takes in a process of its own, with its machine code on disk."""
    command = [sys.executable, "-m", "inspector", "evaluate", str(root), str(path), *options]
    env = os.environ | {"PYTHONPATH": str(DEMO.parent.parent)}
    return best(lambda: subprocess.run(command, env=env, check=True, capture_output=True))[0]


def whole_evaluations(data: Path) -> Table:
    """Ours and direct code on the same data, which must agree."""
    table = Table("evaluation", "pairs", "ours, warm (CPU)", "direct (CPU)", "times faster", "as a command (CPU)")
    with tempfile.TemporaryDirectory() as folder:
        root, path = copied(data, Path(folder))
        dataset, results = open_dataset(root), read_results(path)
        pairs = sum(
            min(len(results.rows(target.image, target.obj_id)), target.inst_count) for target in dataset.targets()
        )
        evaluate(dataset, results)  # reads the models
        ours, evaluation = best(lambda: evaluate(dataset, results))
        theirs, recalls = best(lambda: direct_recalls(dataset, results, Path(folder)), 1)
        assert recalls == (evaluation.scores.mssd, evaluation.scores.mspd), recalls
        _row(table, "LM-O, MSSD and MSPD", pairs, ours, theirs, command_cost(root, path))
        ours, detected = best(lambda: evaluate_pose_detection(dataset, results))
        theirs, precision = best(lambda: direct_detection(dataset, results), 1)
        assert abs(precision - (detected.summary.scores["bop24_mAP"] or 0)) < 1e-12, precision
        claims = int((detected.outcomes.row >= 0).sum())
        _row(table, "LM-O, 6D detection", claims, ours, theirs, command_cost(root, path, "--task", "detection"))
        ours, _ = best(lambda: evaluate(dataset, results, with_ad=True), 2)
        _row(table, "LM-O, MSSD, MSPD, ADD(-I)", pairs, ours, None, command_cost(root, path, "--add"))
    path = DEMO / "results" / "perturbed-1_demo-test.csv"
    dataset, results = open_dataset(DEMO), read_results(path)
    evaluate_siso(dataset, results)
    ours, found = best(lambda: evaluate_siso(dataset, results), 3)
    theirs, recall = best(lambda: direct_siso(dataset, results), 1)
    assert recall == found.summary.scores["siso_recall"], recall
    _row(table, "demo, 2017 (VSD)", len(dataset.targets()), ours, theirs, command_cost(DEMO, path, "--task", "siso"))
    return table


def _row(table: Table, name: str, pairs: int, ours: Cost, theirs: Cost | None, command: Cost) -> None:
    compared = ["", ""] if theirs is None else [str(theirs), f"{theirs.cpu / ours.cpu:.0f}"]
    table.add_row(name, str(pairs), str(ours), *compared, str(command))


def vsd_per_pair(data: Path) -> Table:
    """Time of one VSD by object, the share of rendering, and rays per second against those of Embree alone."""
    dataset = open_dataset(data)
    depth = dataset.depth(direct.KEY_WITH_DEPTH)
    assert depth is not None
    by_object: dict[int, list[direct.Pair]] = {}
    for pair in direct.pairs_with_depth(dataset):
        by_object.setdefault(pair.model.obj_id, []).append(pair)
    columns = ("object", "rays", "ms", "CPU ms", "rendering", "numpy ms", "times faster", "Mrays/s", "Embree alone")
    table = Table(*columns, title="VSD at 10 tolerances, a pair (mean of 4)")
    totals: list[list[float]] = []
    for obj_id, pairs in by_object.items():
        values = [_of_pair(pair, depth) for pair in pairs]
        mean = np.mean(values, axis=0)
        totals.append(mean.tolist())
        table.add_row(str(obj_id), *_cells(mean))
    table.add_section()
    table.add_row("mean", *_cells(np.mean(totals, axis=0)))
    return table


def _of_pair(pair: direct.Pair, depth: np.ndarray) -> list[float]:
    """Rays, seconds, CPU seconds of it all, of rendering, of direct code, rays per CPU second within and alone."""
    poses = np.stack([pair.estimate, pair.truth])
    boxes = [visible_box(pair.model, pair.camera, pose, 0.5) for pose in poses]
    rays = sum(box.area for box in boxes)
    reference = direct.numpy_vsd(depth)
    vsd_of_poses(*pair, depth)
    whole = best(lambda: vsd_of_poses(*pair, depth), 15)[0]
    drawn, renderings = best(lambda: render_depths(pair.model, pair.camera, poses), 15)
    vsd(*renderings, depth, pair.camera.K, pair.model.diameter)
    theirs = best(lambda: reference(pair), 2)[0]
    batch = np.concatenate([_rays(pair, box, pose) for box, pose in zip(boxes, poses, strict=True)] * 10)
    alone = best(lambda: _answer(pair.model, batch), 5)[0]
    return [rays, *whole, drawn.cpu, theirs.cpu, rays / drawn.cpu, len(batch) / alone.cpu]


def _rays(pair: direct.Pair, box: direct.Box, pose: np.ndarray) -> np.ndarray:
    rays = np.empty((*box.shape, 6), np.float32)
    _fill_rays(rays, pair.camera.K, pose, box, 0.5)
    return rays.reshape(-1, 6)


def _cells(values: np.ndarray) -> list[str]:
    rays, whole, cpu, drawn, theirs, within, alone = values.tolist()
    times = [f"{whole * 1000:.2f}", f"{cpu * 1000:.2f}", f"{drawn / cpu:.0%}", f"{theirs * 1000:.1f}"]
    return [f"{rays:.0f}", *times, f"{theirs / cpu:.0f}", f"{within / 1e6:.1f}", f"{alone / 1e6:.1f}"]


def main(data: Path = direct.DATA) -> None:
    """Measure and print the tables."""
    console = Console(width=120)
    console.print(whole_evaluations(data))
    console.print(vsd_per_pair(data))


if __name__ == "__main__":
    tyro.cli(main)
