"""Checks of the numbers: times, poses and scores."""

from collections.abc import Iterator

import numpy as np
from jaxtyping import Bool, Float, Int

from pipeline.bop.results_problems import determinant
from pipeline.bop.submission.asked import image_keys
from pipeline.bop.submission.findings import Finding, Given, Task

TIME_TOLERANCE_S = 0.001
"""Largest difference between the times of an image that BOP's own check lets pass."""
ORTHONORMAL_TOLERANCE = 0.01
"""Largest entry of |R R^T - I| that passes: three digits give up to 3e-3, the ground truth of LM-O has up to 9.6e-3."""
NEAREST_MM, FARTHEST_MM = 10.0, 50_000.0
"""Plausible median distance along z; a smaller one is surely in metres."""

_NOT_MEASURED = -1.0


def check_times(given: Given) -> Iterator[Finding]:
    """One time for all rows of an image, in seconds, and -1 only if no image has one."""
    times = given["time"]
    _, first, places = np.unique(image_keys(given["scene_id"], given["im_id"]), return_index=True, return_inverse=True)
    differs = np.abs(times - times[first][places]) > TIME_TOLERANCE_S
    if differs.any():
        row = int(np.argmax(differs))
        other = int(first[places[row]])
        message = f"column time: {times[row]:g} s, but line {given.scan.lines.of(other)} has {times[other]:g} s for "
        message += f"the same image ({given.place(row)})"
        fix = "write in all rows of an image the seconds for the whole image: BOP refuses the file"
        line, count = given.scan.lines.of(row), int(differs.sum())
        yield Finding("error", "time differs", message, fix, line, "time", str(times[row]), count)
    missing = times < 0
    if missing.any() and not missing.all():
        fix = "BOP then gives no average time at all: measure every image"
        yield from given.warn(
            "time missing", missing, lambda row: f"column time: {times[row]:g}, others are measured", fix, "time"
        )
    odd, fix = missing & (times != _NOT_MEASURED), "write seconds, or -1 where not measured"
    yield from given.warn("time negative", odd, lambda row: f"column time: {times[row]:g} s", fix, "time")
    if len(times) and not times.any():
        yield from given.warn("time zero", times == 0, lambda row: "column time: 0 s in every row", fix, "time")


def check_poses(given: Given) -> Iterator[Finding]:
    """Rotations that are rotations, objects in front of the camera, millimetres, no pose twice."""
    R, z = given["R"], given["t"][:, 2]
    mirrored = determinant(list(R.T)) < 0
    fix = "check how R is made, it must be a rotation matrix row by row (determinant 1)"
    yield from given.warn("mirrored", mirrored, lambda row: "column R: mirrors the object (determinant < 0)", fix, "R")
    deviation = _deviation(R.reshape(-1, 3, 3))
    skewed = (deviation > ORTHONORMAL_TOLERANCE) & ~mirrored

    def skewed_text(row: int) -> str:
        return f"column R: is not orthonormal (|R R^T - I| is {deviation[row]:.2g}, above {ORTHONORMAL_TOLERANCE:g})"

    yield from given.warn("not orthonormal", skewed, skewed_text, "it is scored as it stands: write rotations", "R")
    fix = "objects in an image have z > 0, in the frame of OpenCV: check the direction of the pose"
    yield from given.warn(
        "behind the camera", z <= 0, lambda row: f"column t: z is {z[row]:g} mm, not in front of the camera", fix, "t"
    )
    yield from _units(given, np.abs(z))
    yield from _repeated(given)


def _deviation(R: Float[np.ndarray, "n 3 3"]) -> Float[np.ndarray, "n"]:
    """Largest entry of |R R^T - I|."""
    worst = np.zeros(len(R))
    for i in range(3):
        for j in range(i, 3):
            np.maximum(worst, np.abs(np.einsum("nk,nk->n", R[:, i], R[:, j]) - (i == j)), out=worst)
    return worst


def _units(given: Given, distances: Float[np.ndarray, " n"]) -> Iterator[Finding]:
    median = float(np.median(distances[distances > 0])) if distances.any() else 0.0
    if 0 < median < NEAREST_MM:
        text, rows = f"column t: half of all z are below {median:.3g} mm, so it is in metres", distances < NEAREST_MM
        yield from given.warn("units", rows, lambda row: text, "multiply t by 1000: BOP has millimetres", "t")
    if median > FARTHEST_MM:
        text, rows = f"column t: half of all z are above {median / 1000:.3g} m", distances > FARTHEST_MM
        yield from given.warn("units", rows, lambda row: text, "bring t to millimetres", "t")


def _repeated(given: Given) -> Iterator[Finding]:
    """Rows that give an object in an image the very same pose as an earlier row."""
    earlier = _earlier_twins(given)

    def text(row: int) -> str:
        return f"the same pose of the same object as in line {given.scan.lines.of(int(earlier[row]))}"

    yield from given.warn("repeated", earlier >= 0, text, "remove it: every row counts as an estimate")


def _earlier_twins(given: Given) -> Int[np.ndarray, " n"]:
    """For each row one of the same ids and pose before it, -1 where there is none."""
    columns = [given[name] for name in ("scene_id", "im_id", "obj_id")]
    columns += [given[name][:, i] for name in ("R", "t") for i in range(given[name].shape[1])]
    hashes = np.zeros(len(given), np.uint64)
    for column in columns:
        hashes = _mixed(hashes ^ np.ascontiguousarray(column).view(np.uint64))
    order = np.argsort(hashes, kind="stable")
    after, before = order[1:], order[:-1]
    same = np.logical_and.reduce([column[after] == column[before] for column in columns])
    twins = np.full(len(given), -1)
    twins[after[same]] = before[same]
    return twins


def _mixed(bits: np.ndarray) -> np.ndarray:
    """Spread every bit over all, so that equal results mean equal inputs but for very rare chance."""
    bits = (bits ^ bits >> np.uint64(33)) * np.uint64(0xFF51AFD7ED558CCD)
    return (bits ^ bits >> np.uint64(33)) * np.uint64(0xC4CEB9FE1A85EC53)


def check_scores(given: Given, task: Task) -> Iterator[Finding]:
    """Whether scores tell estimates apart."""
    scores = given["score"]
    if len(scores) > 1 and (scores == scores[0]).all():
        message = f"column score: all rows have {scores[0]:g}"
        effect = (
            "precision depends on it" if task == "detection" else "of too many estimates those first in the file count"
        )
        every: Bool[np.ndarray, " n"] = np.ones(len(scores), bool)
        yield from given.warn("scores equal", every, lambda row: message, f"{effect}: write confidences", "score")
