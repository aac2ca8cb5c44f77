"""A made-up method of somebody else: it takes corners of boxes for fragments, and logs where EPOS does, by the recorder.

It has no search of its own to show, so it logs no hypotheses; of the second image it logs only probabilities; the
third one it does not record at all.
"""

from pathlib import Path

import numpy as np
from tiny_dataset import ANNOTATED, BARE, CAMERA, FIRST, HALF_TURN, SECOND, box, claim

from pipeline.bop.dataset import Dataset
from pipeline.geometry import inverse, transform_points, unproject
from pipeline.recording import StageRecorder
from pipeline.rendering import render_scene
from pipeline.run import Run
from pipeline.scene import ImageKey

CELL_PX = 2
GRID = (CAMERA.height // CELL_PX, CAMERA.width // CELL_PX)
OBJECTS = (1, 2)
TAU_B = 0.5
NAME = "corner-guesser"


def make_run(root: Path, dataset: Dataset) -> Path:
    """Run the method over the tiny dataset."""
    with Run.create(root, dataset=dataset, method=NAME) as run:
        for key in (FIRST, SECOND, BARE):
            if key != BARE:
                with run.recorder(key, CAMERA) as recorder:
                    record(key, recorder)
            run.add(key, [claim(key, obj_id, pose, 0.9) for obj_id, pose in ANNOTATED[key]])
    return root


def record(key: ImageKey, recorder: StageRecorder) -> None:
    """Log what the method believes of an image."""
    cells, instances, depths = look_at(key)
    obj_ids = np.array([ANNOTATED[key][i][0] if i >= 0 else 0 for i in instances])
    a = np.where(obj_ids[:, None] == (0, *OBJECTS), 0.9, 0.05)
    recorder.probabilities(
        "epos/object_probability", a, cells=cells, grid=GRID, cell_px=CELL_PX, labels=["background", "1", "2"]
    )
    for obj_id in OBJECTS:
        shown = np.flatnonzero(obj_ids == obj_id)
        points = points_in_model(key, cells[shown], instances[shown], depths[shown])
        b, guesses = guess(obj_id, points)
        recorder.probabilities(
            f"epos/fragments/{obj_id}",
            b,
            cells=cells[shown],
            grid=GRID,
            cell_px=CELL_PX,
            points_in_model=guesses,
        )
        if key == FIRST:
            recorder.table(f"epos/fragment_model/{obj_id}", {"centre_in_model": corners(obj_id)})
            rows, ids = np.nonzero(b > TAU_B * b.max(axis=1, keepdims=True))
            pixels = cells[shown][rows] * CELL_PX + (CELL_PX - 1) / 2
            links = (pixels, guesses[rows, ids], 0.9 * b[rows, ids])
            recorder.correspondences(f"epos/correspondences/{obj_id}", obj_id, *links, fragment_ids=ids)


def corners(obj_id: int) -> np.ndarray:
    """The eight fragments' centres, metres."""
    return box(obj_id).vertices


def guess(obj_id: int, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Probabilities (k, 8) of the corners, and the point (k, 8, 3) that each would mean: box 2 looks alike turned."""
    centers = corners(obj_id)
    b = np.full((len(points), len(centers)), 0.02)
    guesses = np.broadcast_to(centers, (len(points), *centers.shape)).copy()
    for turn in (np.eye(4), HALF_TURN)[: 2 if obj_id == 2 else 1]:
        turned = transform_points(turn, points)
        nearest = np.linalg.norm(turned[:, None] - centers, axis=2).argmin(axis=1)
        b[np.arange(len(points)), nearest] = 1.0
        guesses[np.arange(len(points)), nearest] = turned
    return b / np.maximum(b.sum(axis=1, keepdims=True), 1e-9), guesses


def look_at(key: ImageKey) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cells (column, row) row by row, the annotation that each shows (-1: none), and its depth."""
    seen = render_scene([(box(obj_id), pose) for obj_id, pose in ANNOTATED[key]], CAMERA, pixel_center=0.0)
    cells = np.stack(np.meshgrid(np.arange(GRID[1]), np.arange(GRID[0])), axis=-1).reshape(-1, 2)
    column, row = (cells * CELL_PX).T
    return cells, seen.instance_ids[row, column], seen.depth[row, column].astype(float)


def points_in_model(key: ImageKey, cells: np.ndarray, instances: np.ndarray, depths: np.ndarray) -> np.ndarray:
    """The point of its object that each cell shows, metres, model frame."""
    in_camera = unproject(CAMERA.K, cells * float(CELL_PX), depths)
    found = [
        transform_points(inverse(ANNOTATED[key][instance][1]), point)
        for instance, point in zip(instances, in_camera, strict=True)
    ]
    return np.array(found).reshape(-1, 3)
