"""Datasets of random annotations without images, and results for them that are near, far, doubled and equal in score.

Objects are the boxes of `tiny_dataset`, of which box 2 has a listed symmetry. Lengths here are millimetres, as in the
files, so that whoever follows the equations on the files themselves shares nothing with the program.
"""

import json
import shutil
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tests.tiny_dataset import SIDES_MM, make_dataset

K = [80.0, 0, 33.0, 0, 81.0, 22.0, 0, 0, 1]
WIDTH, HEIGHT = 64, 48
SYMMETRIES = {1: [np.eye(4)], 2: [np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0])]}
CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
POINTS = {obj_id: CORNERS * sides for obj_id, sides in SIDES_MM.items()}
DIAMETERS = {obj_id: float(np.linalg.norm(np.array(sides) / 1000)) * 1000 for obj_id, sides in SIDES_MM.items()}

Row = dict
"""A row of a results file: scene_id, im_id, obj_id, score, R (3x3), t (mm)."""


def make_random(root: Path, seed: int, scenes: int = 2, images: int = 3) -> list[Row]:
    """Write a dataset with visible fractions and return results for it, in the order of the file."""
    rng = np.random.default_rng(seed)
    make_dataset(root)
    shutil.rmtree(root / "test")
    (root / "camera.json").write_text(json.dumps({"width": WIDTH, "height": HEIGHT}))
    rows: list[Row] = []
    for scene_id in range(1, scenes + 1):
        truths, infos = {}, {}
        for im_id in range(images):
            entries = [_annotation(rng) for _ in range(rng.integers(1, 5))]
            truths[im_id] = entries
            infos[im_id] = [{"visib_fract": float(rng.choice([0.0, 0.05, 0.1, 0.3, 0.9]))} for _ in entries]
            rows += _claims(rng, scene_id, im_id, entries)
        folder = root / "test" / f"{scene_id:06d}"
        folder.mkdir(parents=True)
        cameras = {im_id: {"cam_K": K, "depth_scale": 1.0} for im_id in range(images)}
        for name, content in (("camera", cameras), ("gt", truths), ("gt_info", infos)):
            (folder / f"scene_{name}.json").write_text(json.dumps(content))
    rng.shuffle(rows)
    return rows


def write_rows(path: Path, rows: list[Row]) -> Path:
    """Write a results file."""
    lines = ["scene_id,im_id,obj_id,score,R,t,time"]
    for row in rows:
        R, t = (" ".join(map(repr, np.ravel(row[name]).tolist())) for name in ("R", "t"))
        lines.append(f"{row['scene_id']},{row['im_id']},{row['obj_id']},{row['score']!r},{R},{t},-1")
    path.write_text("\n".join([*lines, ""]))
    return path


def read_scene(root: Path, scene_id: int, name: str) -> dict[int, list]:
    """Content of a scene's file by image."""
    content = json.loads((root / "test" / f"{scene_id:06d}" / f"scene_{name}.json").read_text())
    return {int(key): value for key, value in content.items()}


def placed(obj_id: int, R: np.ndarray, t: np.ndarray, symmetry: np.ndarray | None = None) -> np.ndarray:
    """Corners of a box in the camera frame."""
    points = POINTS[obj_id] if symmetry is None else POINTS[obj_id] @ symmetry[:3, :3].T + symmetry[:3, 3]
    return points @ np.reshape(R, (3, 3)).T + np.ravel(t)


def slow_mssd(row: Row, truth: dict) -> float:
    """Millimetres; infinite where the bounding spheres are apart."""
    obj_id = row["obj_id"]
    if np.linalg.norm(np.ravel(row["t"]) - truth["cam_t_m2c"]) >= DIAMETERS[obj_id]:
        return np.inf
    at_estimate = placed(obj_id, row["R"], row["t"])
    at_truth = [placed(obj_id, truth["cam_R_m2c"], truth["cam_t_m2c"], S) for S in SYMMETRIES[obj_id]]
    return min(max(np.linalg.norm(a - b) for a, b in zip(at_estimate, points, strict=True)) for points in at_truth)


def slow_mspd(row: Row, truth: dict) -> float:
    """Pixels in an image 640 wide."""

    def pixels(points: np.ndarray) -> np.ndarray:
        homogeneous = points @ np.reshape(K, (3, 3)).T
        return homogeneous[:, :2] / homogeneous[:, 2:]

    obj_id = row["obj_id"]
    at_estimate = pixels(placed(obj_id, row["R"], row["t"]))
    at_truth = [pixels(placed(obj_id, truth["cam_R_m2c"], truth["cam_t_m2c"], S)) for S in SYMMETRIES[obj_id]]
    return min(np.linalg.norm(at_estimate - points, axis=1).max() for points in at_truth) * 640 / WIDTH


def greedy(errors: dict[tuple[int, int], float], estimates: int, instances: int, threshold: float) -> dict[int, int]:
    """Instance of each estimate that has one: estimates in their order, each takes the nearest that is left."""
    taken: dict[int, int] = {}
    for estimate in range(estimates):
        best, best_error = -1, threshold
        for instance in range(instances):
            if instance not in taken.values() and errors[estimate, instance] < best_error:
                best, best_error = instance, errors[estimate, instance]
        if best >= 0:
            taken[estimate] = best
    return taken


def _annotation(rng: np.random.Generator) -> dict:
    R = Rotation.random(rng=rng).as_matrix()
    t = rng.uniform([-60, -40, 380], [60, 40, 420])
    return {"obj_id": int(rng.integers(1, 3)), "cam_R_m2c": R.ravel().tolist(), "cam_t_m2c": t.tolist()}


def _claims(rng: np.random.Generator, scene_id: int, im_id: int, entries: list[dict]) -> list[Row]:
    """Estimates about the annotations, some of a wrong object; scores of a few values, so that many are equal."""
    rows = []
    for entry in entries:
        for _ in range(rng.integers(0, 4)):
            turn = Rotation.from_rotvec(rng.normal(scale=0.15, size=3)).as_matrix()
            flip = SYMMETRIES[2][rng.integers(0, 2)][:3, :3]
            R = turn @ np.reshape(entry["cam_R_m2c"], (3, 3)) @ flip
            t = entry["cam_t_m2c"] + rng.normal(scale=rng.choice([1.0, 6.0, 60.0]), size=3)
            obj_id = entry["obj_id"] if rng.random() < 0.85 else 3 - entry["obj_id"]
            score = float(rng.choice([0.2, 0.5, 0.5, 0.9])) if rng.random() < 0.7 else float(rng.random())
            rows.append({"scene_id": scene_id, "im_id": im_id, "obj_id": obj_id, "score": score, "R": R, "t": t})
    return rows
