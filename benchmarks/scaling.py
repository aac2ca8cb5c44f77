"""Evaluation of very many targets: memory over the number of targets, and speed over the number of processes.

The dataset is made in a temporary folder: images of ten boxes, 640 x 480 pixels with depth, in scenes of 1,000 images,
with three estimates for every target.

    python benchmarks/scaling.py [--targets 100000] [--processes 2]

Memory is what all processes of an evaluation hold together, looked at ten times a second: resident (pages that they
share count for each) and proportional (they count once). Times are ratios of runs that take turns.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.bop.evaluation.columns import Execution
from pipeline.bop.evaluation.evaluate import Evaluation, evaluate
from pipeline.bop.json_files import write_json_by_id
from pipeline.bop.results import Results, read_results, write_results
from pipeline.parallel import open_workers

OBJECTS, IMAGES_PER_SCENE, ESTIMATES = 10, 1000, 3
SIDES_MM = np.array([60.0, 40.0, 20.0])
K = [600.0, 0, 320, 0, 600, 240, 0, 0, 1]


def main() -> None:
    """Make the data, measure, print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--targets", type=int, default=100_000)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--evaluate", nargs=2, type=Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.evaluate:
        whole(*arguments.evaluate, arguments.processes)
        return
    with tempfile.TemporaryDirectory() as folder:
        print("targets   resident MB   proportional MB   seconds   per target")
        for targets in (arguments.targets // 10, arguments.targets):
            root = Path(folder) / f"of{targets}"
            results = make_dataset(root, targets)
            resident, proportional, seconds = measured(root, results, arguments.processes)
            print(
                f"{targets:7d} {resident:13.0f} {proportional:17.0f} {seconds:9.1f} {seconds / targets * 1e3:9.2f} ms"
            )
        speed(Path(folder) / "medium", arguments.processes)
        overhead(Path(folder) / "small", arguments.processes)


def whole(root: Path, results: Path, processes: int) -> None:
    """What the command does: read, evaluate with VSD, keep finished pieces."""
    with open_workers(processes) as workers:
        execution = Execution(workers, root.with_name(f"{root.name}-journal"))
        evaluation = evaluate(open_dataset(root), read_results(results), execution=execution)
    print(len(evaluation.instances), evaluation.scores)


def measured(root: Path, results: Path, processes: int) -> tuple[float, float, float]:
    """Largest memory of an evaluation in MB, resident and proportional, and its seconds."""
    command = [sys.executable, __file__, "--evaluate", str(root), str(results), "--processes", str(processes)]
    begun = time.perf_counter()
    largest = np.zeros(2)
    with subprocess.Popen(command, stdout=subprocess.DEVNULL) as started:
        while started.poll() is None:
            largest = np.maximum(largest, sum((memory(pid) for pid in family(started.pid)), np.zeros(2)))
            time.sleep(0.1)
    if started.returncode:
        raise SystemExit("the evaluation failed")
    return *(largest / 1000).tolist(), time.perf_counter() - begun


def family(pid: int) -> list[int]:
    """A process and all that it has started."""
    found = [pid]
    for parent in found:
        try:
            tasks = list(Path(f"/proc/{parent}/task").iterdir())
            found += [int(child) for task in tasks for child in (task / "children").read_text().split()]
        except OSError:
            continue
    return found


def memory(pid: int) -> np.ndarray:
    """Resident and proportional memory of a process, kB; 0 where it is gone."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return np.zeros(2)
    values = {line.split(":")[0]: float(line.split()[1]) for line in lines[1:]}
    return np.array([values["Rss"], values["Pss"]])


def speed(root: Path, processes: int, targets: int = 2_000, repeats: int = 3) -> None:
    """VSD by one process on one core, by one on all cores, and by several, started before."""
    results = read_results(make_dataset(root, targets))
    dataset, cores = open_dataset(root), os.sched_getaffinity(0)
    with open_workers(processes) as workers:
        seconds: dict[str, list[float]] = {"one core": [], "one process": [], "processes": []}
        reference = timed(dataset, results, Execution())[0]
        timed(dataset, results, Execution(workers))  # all have read all files now
        for _ in range(repeats):
            os.sched_setaffinity(0, {min(cores)})
            seconds["one core"].append(timed(dataset, results, Execution())[1])
            os.sched_setaffinity(0, cores)
            seconds["one process"].append(timed(dataset, results, Execution())[1])
            found, took = timed(dataset, results, Execution(workers))
            seconds["processes"].append(took)
            assert found.scores == reference.scores
    core, process, several = (median(times) for times in seconds.values())
    print(
        f"VSD of {targets} targets with {processes} processes: {core / several:.2f} times as fast as one on one core, "
        f"{process / several:.2f} times as fast as one on {len(cores)}"
    )


def overhead(root: Path, processes: int, repeats: int = 5) -> None:
    """What a piece costs beside its computation: sent to a worker, or kept in the journal."""
    results = read_results(make_dataset(root, 10_000))
    dataset = open_dataset(root)
    took: dict[str, list[float]] = {"here": [], "workers": [], "journal": []}
    with open_workers(processes) as workers:
        for repeat in range(repeats + 1):
            journal = root.with_name(f"journal{repeat}")
            for name, execution in zip(
                took, (Execution(), Execution(workers), Execution(journal=journal)), strict=True
            ):
                took[name].append(timed(dataset, results, execution, with_vsd=False)[1])
    here, others, kept = (median(times[1:]) for times in took.values())  # the first has read all files
    count = 10_000 / 40  # pieces of four images
    print(
        f"a piece of 40 targets without VSD: {here / count * 1e3:.2f} ms; the journal adds "
        f"{(kept - here) / here:.0%}; {processes} processes are {here / others:.2f} times as fast"
    )


def timed(dataset: Dataset, results: Results, execution: Execution, with_vsd: bool = True) -> tuple[Evaluation, float]:
    """An evaluation, and its seconds."""
    begun = time.perf_counter()
    evaluation = evaluate(dataset, results, with_vsd=with_vsd, execution=execution)
    return evaluation, time.perf_counter() - begun


def make_dataset(root: Path, targets: int, objects: int = OBJECTS, depth: bool = True) -> Path:
    """Write a dataset with so many targets, and results for it, whose path is returned."""
    random = np.random.default_rng(0)
    images = targets // objects
    _write_models(root / "models", objects)
    rows = []
    for scene_id in range(-(-images // IMAGES_PER_SCENE)):
        count = min(IMAGES_PER_SCENE, images - scene_id * IMAGES_PER_SCENE)
        rows.append(_write_scene(root / "test" / f"{scene_id:06d}", scene_id, count, objects, depth, random))
    (root / "camera.json").write_text(json.dumps({"width": 640, "height": 480}))
    arrays = [np.concatenate(parts) for parts in zip(*rows, strict=True)]
    path = root / "mine_large-test.csv"
    write_results(path, Results(*arrays))
    return path


def _write_scene(
    folder: Path, scene_id: int, images: int, objects: int, depth: bool, random: np.random.Generator
) -> tuple[np.ndarray, ...]:
    """Write a scene; columns of the estimates for it."""
    count = images * objects
    R = Rotation.random(count, rng=random).as_matrix()
    t = np.column_stack(
        [random.uniform(-150, 150, count), random.uniform(-100, 100, count), random.uniform(500, 900, count)]
    )
    truths = [
        {"cam_R_m2c": R[i].ravel().tolist(), "cam_t_m2c": t[i].tolist(), "obj_id": i % objects + 1}
        for i in range(count)
    ]
    info = {
        "bbox_obj": [210, 155, 84, 73], "bbox_visib": [210, 155, 84, 73], "px_count_all": 4321, "px_count_valid": 4300,
        "px_count_visib": 4250, "visib_fract": 0.98,
    }  # fmt: skip
    folder.mkdir(parents=True)
    by_image = {i: truths[i * objects : (i + 1) * objects] for i in range(images)}
    write_json_by_id(folder / "scene_gt.json", by_image)
    write_json_by_id(folder / "scene_gt_info.json", {i: [info] * objects for i in by_image})
    write_json_by_id(folder / "scene_camera.json", {i: {"cam_K": K, "depth_scale": 1.0} for i in by_image})
    if depth:
        _write_depth(folder / "depth", images)
    turned = Rotation.from_rotvec(random.normal(0, 0.05, (ESTIMATES * count, 3))).as_matrix()
    moved = random.normal(0, 4.0, (ESTIMATES * count, 3))
    return (
        np.full(ESTIMATES * count, scene_id),
        np.repeat(np.arange(images), ESTIMATES * objects),
        np.tile(np.repeat(np.arange(objects) + 1, ESTIMATES), images),
        random.random(ESTIMATES * count),
        turned @ np.repeat(R, ESTIMATES, axis=0),
        np.repeat(t, ESTIMATES, axis=0) + moved,
        np.full(ESTIMATES * count, 0.5),
    )


def _write_depth(folder: Path, images: int) -> None:
    """Write one depth image, under the names of all."""
    folder.mkdir()
    rows, columns = np.mgrid[:480, :640]
    cv2.imwrite(str(folder / "000000.png"), (700 + 0.1 * rows + 20 * np.sin(columns / 30)).astype(np.uint16))
    for i in range(1, images):
        (folder / f"{i:06d}.png").hardlink_to(folder / "000000.png")


def _write_models(folder: Path, objects: int) -> None:
    folder.mkdir(parents=True)
    corners = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * SIDES_MM / 2
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [triangle for a, b, c, d in quads for triangle in ((a, b, c), (a, c, d))]
    lines = ["ply", "format ascii 1.0", "element vertex 8", *(f"property float {axis}" for axis in "xyz")]
    lines += ["element face 12", "property list uchar int vertex_indices", "end_header"]
    lines += [" ".join(map(str, corner)) for corner in corners.tolist()]
    lines += [" ".join(map(str, (3, *face))) for face in faces]
    for obj_id in range(1, objects + 1):
        (folder / f"obj_{obj_id:06d}.ply").write_text("\n".join([*lines, ""]))
    infos = {obj_id: {"diameter": float(np.linalg.norm(SIDES_MM))} for obj_id in range(1, objects + 1)}
    write_json_by_id(folder / "models_info.json", infos)


if __name__ == "__main__":
    main()
