"""Pose fitting against PoseLib and OpenCV on made many-to-many correspondences, one core.

    python benchmarks/fitting.py [--scale 1] [--thesis] [--data DIR]

Correct poses are counted by the number of instances and the symmetry, pooled over 30, 50 and 70 % outliers; a pose is
correct with an MSPD below 5 px modulo symmetry. The others fit one instance after the other and lose the pixels of those
before. Times are CPU milliseconds per image, median and largest of both symmetries, and their ratio to ours. --scale 0.1
takes a tenth of the images. --thesis adds the thesis's own scheme, which takes seconds an image. DIR is a folder of real
correspondences (default ../shared/data/correspondences). PoseLib (pip install poselib) is left out where absent.
Nothing is asserted.
"""

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

if hasattr(os, "sched_setaffinity"):  # before the libraries start their threads
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

import cv2
import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from pipeline.bop import errors
from pipeline.epos.fitting.config import FittingConfig
from pipeline.epos.fitting.correspondences import PotentialCorrespondences, correspondences_of_pixels
from pipeline.epos.fitting.fit import fit_poses
from pipeline.epos.fitting.results import FittingTrace
from pipeline.epos.fitting.synthetic import HEIGHT, WIDTH, K, MadeScene, Symmetry, make_scene
from pipeline.geometry import project, rotation_error, transform_points

try:
    import poselib
except ImportError:
    poselib = None

DATA = Path(os.environ.get("INSPECTOR_SHARED_DATA", "../shared/data")) / "correspondences"
TAU = 4.0
CORRECT_PX = 5.0
OUTLIERS = (0.3, 0.5, 0.7)
SYMMETRIES: tuple[Symmetry, ...] = ("two-fold", "continuous")

Fit = Callable[[PotentialCorrespondences, np.ndarray, int], list[np.ndarray]]
"""Correspondences, K and a number of instances to poses."""

FitOne = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray | None]
"""Pixels and points by falling confidence, and K, to a pose."""


class Group(NamedTuple):
    """Scenes of as many instances, by symmetry."""

    instances: int
    scenes: dict[Symmetry, list[MadeScene]]


class Measured(NamedTuple):
    """What a method did on a group."""

    right: dict[Symmetry, int]
    """Correct poses."""
    ms: list[float]
    """Of each image."""


# ---- the methods


def one_after_the_other(fit_one: FitOne) -> Fit:
    """Fit instances with a method for one: pixels explained by an instance are gone for the next."""

    def fit(correspondences: PotentialCorrespondences, camera: np.ndarray, instances: int) -> list[np.ndarray]:
        left = correspondences.at(np.argsort(-correspondences.confidence, kind="stable"))
        poses: list[np.ndarray] = []
        while len(poses) < instances and len(left) >= 8:
            pose = fit_one(left.pixels, left.points_in_model, camera)
            if pose is None:
                break
            poses.append(pose)
            off = np.linalg.norm(project(camera, transform_points(pose, left.points_in_model)) - left.pixels, axis=1)
            left = left.at(np.flatnonzero(~np.isin(left.pixel_ids, left.pixel_ids[off < TAU])))
        return poses

    return fit


def of_poselib(fewest: int, most: int) -> FitOne:
    """PoseLib with PROSAC."""
    options = {"max_reproj_error": TAU, "min_iterations": fewest, "max_iterations": most, "progressive_sampling": True}

    def fit(pixels: np.ndarray, points: np.ndarray, camera: np.ndarray) -> np.ndarray:
        numbers = [camera[0, 0], camera[1, 1], camera[0, 2], camera[1, 2]]
        pinhole = {"model": "PINHOLE", "width": WIDTH, "height": HEIGHT, "params": numbers}
        pose, _ = poselib.estimate_absolute_pose(pixels, points, pinhole, options, {})
        return np.vstack([pose.Rt, [0, 0, 0, 1]])

    return fit


def opencv_ransac(pixels: np.ndarray, points: np.ndarray, camera: np.ndarray) -> np.ndarray | None:
    """OpenCV's first RANSAC, EPnP, 400 iterations."""
    settings = {"iterationsCount": 400, "reprojectionError": TAU, "confidence": 0.9999, "flags": cv2.SOLVEPNP_EPNP}
    found, turn, shift, _ = cv2.solvePnPRansac(points, pixels, camera, None, **settings)
    return np.vstack([np.hstack([cv2.Rodrigues(turn)[0], shift]), [0, 0, 0, 1]]) if found else None


def opencv_usac(pixels: np.ndarray, points: np.ndarray, camera: np.ndarray) -> np.ndarray | None:
    """OpenCV's USAC: PROSAC, MSAC, local optimization by graph cut, 5000 iterations."""
    params = cv2.UsacParams()
    params.threshold, params.maxIterations, params.confidence = TAU, 5000, 0.999999
    params.sampler, params.score, params.loMethod = (
        cv2.SAMPLING_PROSAC,
        cv2.SCORE_METHOD_MSAC,
        cv2.LOCAL_OPTIM_GC,
    )
    found, _, turn, shift, _ = cv2.solvePnPRansac(points, pixels, camera.copy(), None, params=params)
    if not found or turn is None:
        return None
    return np.vstack([np.hstack([cv2.Rodrigues(turn)[0], shift]), [0, 0, 0, 1]])


def ours(config: FittingConfig) -> Fit:
    """The fitting of this package."""

    def fit(correspondences: PotentialCorrespondences, camera: np.ndarray, instances: int) -> list[np.ndarray]:
        found = fit_poses(correspondences, camera, config, instances=instances)
        return [pose.camera_from_model for pose in found.poses]

    return fit


def methods(thesis: bool) -> dict[str, Fit]:
    """All methods by name."""
    found = {
        "ours, pooled (default)": ours(FittingConfig()),
        "OpenCV RANSAC EPnP 400": one_after_the_other(opencv_ransac),
        "OpenCV USAC PROSAC GC 5000": one_after_the_other(opencv_usac),
    }
    if poselib is not None:
        found["PoseLib PROSAC 400"] = one_after_the_other(of_poselib(100, 400))
        found["PoseLib PROSAC 400-5000"] = one_after_the_other(of_poselib(400, 5000))
    if thesis:
        for name, solver in (("gc", "epnp+lm"), ("gc", "epnp"), ("gc", "sqpnp+lm"), ("msac", "epnp+lm")):
            found[f"Progressive-X, {name}, {solver}"] = ours(FittingConfig("progressive_x", ransac=name, solver=solver))
        found["Progressive-X, opencv"] = ours(FittingConfig("progressive_x", ransac="opencv"))
    return found


# ---- measuring


def groups(scale: float) -> list[Group]:
    """Per symmetry 120 single instances, 90 in threes and 60 in tens, times a scale."""
    return [
        Group(count, {symmetry: scenes(count, symmetry, max(1, round(scale * images))) for symmetry in SYMMETRIES})
        for count, images in ((1, 40), (3, 10), (10, 2))
    ]


def scenes(instances: int, symmetry: Symmetry, images: int) -> list[MadeScene]:
    """So many images for each share of outliers."""
    return [make_scene(100 * instances + i, instances, symmetry, o) for o in OUTLIERS for i in range(images)]


def correct(scene: MadeScene, poses: list[np.ndarray]) -> int:
    """Instances that some pose is right for, each pose counting for one."""
    free = list(range(len(scene.camera_from_model)))
    for pose in poses:
        off = [errors.mspd(scene.model, K, pose, scene.camera_from_model[k]).value for k in free]
        if off and min(off) < CORRECT_PX:
            del free[int(np.argmin(off))]
    return len(scene.camera_from_model) - len(free)


def timed(fit: Fit, correspondences: PotentialCorrespondences, camera: np.ndarray, count: int) -> tuple[list, float]:
    """Poses, and CPU milliseconds of this thread."""
    start = time.thread_time()
    poses = fit(correspondences, camera, count)
    return poses, (time.thread_time() - start) * 1000


def measure(fit: Fit, group: Group) -> Measured:
    """Run a method on all scenes of a group."""
    right, ms = dict.fromkeys(group.scenes, 0), []
    for symmetry, made in group.scenes.items():
        for scene in made:
            poses, time_ms = timed(fit, scene.correspondences, K, group.instances)
            right[symmetry] += correct(scene, poses)
            ms.append(time_ms)
    return Measured(right, ms)


def table_of(fits: dict[str, Fit], scale: float) -> Table:
    """Correct poses and times of all methods; the first is the one that others are compared with."""
    all_groups = groups(scale)
    table = Table("method", title="correct poses; CPU ms an image: median (largest), times ours")
    for group in all_groups:
        for symmetry, made in group.scenes.items():
            table.add_column(f"{group.instances}\n{symmetry}\n/{group.instances * len(made)}")
        table.add_column(f"{group.instances}\nms")
    ours_ms: list[float] = []
    for name, fit in fits.items():
        fit(all_groups[0].scenes["two-fold"][0].correspondences, K, 1)  # loads or compiles
        row = [measure(fit, group) for group in all_groups]
        ours_ms = ours_ms or [float(np.median(each.ms)) for each in row]
        texts: list[str] = []
        for each, ms in zip(row, ours_ms, strict=True):
            texts += [*map(str, each.right.values()), time_text(each.ms, ms)]
        table.add_row(name, *texts)
    return table


def time_text(ms: list[float], ours_ms: float) -> str:
    """Median, largest and ratio of times."""
    return f"{np.median(ms):.1f} ({max(ms):.1f}) x{np.median(ms) / ours_ms:.1f}"


def twins(fits: dict[str, Fit], scale: float) -> str:
    """How often a second pose is returned where one instance is present and two are asked for."""
    made = [scene for symmetry in SYMMETRIES for scene in scenes(1, symmetry, max(1, round(10 * scale)))]
    counts = {name: sum(len(fit(scene.correspondences, K, 2)) > 1 for scene in made) for name, fit in fits.items()}
    return f"second poses for one instance, of {len(made)}: " + "; ".join(f"{n}: {c}" for n, c in counts.items())


def real_correspondences(folder: Path) -> tuple[PotentialCorrespondences, np.ndarray, np.ndarray]:
    """The correspondences of `pose6dscene`, K and the given pose (millimetres on disk)."""
    numbers = np.loadtxt(folder / "pose6dscene_points.txt")
    count = len(numbers)
    pairs = correspondences_of_pixels(1, numbers[:, :2].copy(), numbers[:, 2:] / 1000, np.ones(count))
    given = np.loadtxt(folder / "pose6dscene_gt.txt")
    given[:, 3] /= 1000
    return pairs, np.loadtxt(folder / "pose6dscene.K"), given


def table_of_real(fits: dict[str, Fit], folder: Path) -> Table:
    """Errors against the given pose of real correspondences."""
    pairs, camera, given = real_correspondences(folder)
    table = Table("method", "degrees", "mm", "CPU ms", title=f"{folder}: {len(pairs)} real correspondences")
    for name, fit in fits.items():
        runs = [timed(fit, pairs, camera, 1) for _ in range(5)]
        poses, ms = runs[0][0], min(ms for _, ms in runs)
        if not poses:
            table.add_row(name, "none", "", f"{ms:.2f}")
            continue
        turn = np.degrees(rotation_error(poses[0][:3, :3], given[:, :3]))
        shift = np.linalg.norm(poses[0][:3, 3] - given[:, 3]) * 1000
        table.add_row(name, f"{turn:.2f}", f"{shift:.1f}", f"{ms:.2f}")
    return table


def trace_ratio() -> tuple[float, float]:
    """Milliseconds of a fit without and with a trace, best of some."""
    pairs = make_scene(1, 3).correspondences
    times: dict[bool, list[float]] = {False: [], True: []}
    for on in [False, True] * 20:
        start = time.thread_time()
        fit_poses(pairs, K, instances=3, trace=FittingTrace() if on else None)
        times[on].append((time.thread_time() - start) * 1000)
    return min(times[False]), min(times[True])


def compile_seconds() -> tuple[float, float]:
    """Seconds of the first fit in a new process: without and with machine code on disk."""
    code = (
        "import time; from pipeline.epos.fitting.synthetic import K, make_scene; c = make_scene(1).correspondences\n"
        "t = time.perf_counter(); from pipeline.epos.fitting.fit import fit_poses; fit_poses(c, K)\n"
        "print(time.perf_counter() - t)"
    )
    with tempfile.TemporaryDirectory() as folder:
        env = os.environ | {"NUMBA_CACHE_DIR": folder}
        cold, cached = (
            float(subprocess.run([sys.executable, "-c", code], env=env, check=True, capture_output=True).stdout)
            for _ in range(2)
        )
    return cold, cached


def main(scale: float = 1.0, thesis: bool = False, data: Path = DATA) -> None:
    """Measure and print the tables."""
    cv2.setNumThreads(1)
    console = Console(width=max(Console().width, 170))
    fits = methods(thesis)
    console.print(table_of(fits, scale))
    console.print(twins(fits, scale))
    console.print(table_of_real(fits, data) if data.is_dir() else f"real correspondences absent: {data}")
    if poselib is None:
        console.print("PoseLib absent (pip install poselib): its rows are left out")
    console.print("three instances: {:.2f} ms without a trace, {:.2f} with".format(*trace_ratio()))
    console.print("first fit of a process: {:.1f} s to compile, {:.2f} s from disk".format(*compile_seconds()))


if __name__ == "__main__":
    tyro.cli(main)
