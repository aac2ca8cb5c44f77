"""The marker board as a test bed: do its rendered markers give the camera back, and its biased depth the bias.

    python benchmarks/marker_board.py [--preset bop20] [--camera carmine] [--sensor carmine]

Per image: markers found, mean and RMS of the reprojection errors of all corners, the recovered pose of the camera
against the true one (mm, degrees). Then, over all images, d_c = a d + b fitted to the depth measured at the corners (thesis sec.
tless_depth_correction). And what a turn costs. Objects lie on the board. Nothing is asserted.
"""

import time
from dataclasses import dataclass

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from pipeline.geometry import inverse, rotation_error, transform, transform_points
from pipeline.rendering import render_scene
from pipeline.scene import Camera
from pipeline.synth.boards import BoardPose, MarkerBoard, board_scene, board_sequence, camera_pose, detect, framed_board
from pipeline.synth.demo.part_files import part_model
from pipeline.synth.materials import random_material
from pipeline.synth.sensors import depth_sensor, sensor_camera
from pipeline.synth.tracing.mitsuba_scene import Object
from pipeline.synth.tracing.path_tracer import PathTracer


@dataclass(frozen=True)
class Config:
    """What to render."""

    preset: str = "bop20"
    camera: str = "carmine"
    """Intrinsics."""
    sensor: str = "carmine"
    """Whose depth has the bias."""
    dictionary: str = "DICT_4X4_100"
    azimuths: tuple[float, ...] = (20.0, 160.0, 280.0)
    """Degrees."""
    elevations: tuple[float, ...] = (10.0, 30.0, 50.0, 75.0)
    """Degrees."""
    distances: tuple[float, ...] = (0.6, 0.75, 0.9)
    """Metres; one per azimuth, in turn."""
    seed: int = 0


def objects_on(rng: np.random.Generator) -> list[Object]:
    """Four of our parts, standing apart."""
    made: list[Object] = []
    for k, (x, y) in enumerate(((-0.06, -0.06), (0.06, -0.06), (0.06, 0.06), (-0.06, 0.06))):
        model = part_model(k + 1)
        at = np.array([x, y, -model.vertices[:, 2].min()])
        made.append((model, random_material(rng), transform(np.eye(3), at)))
    return made


def corner_depths(
    depth: np.ndarray, pose: BoardPose, ids: tuple[int, ...], board: MarkerBoard, camera: Camera
) -> np.ndarray:
    """Pairs (measured, expected by the found pose) at the pixels nearest to the inner corners of the markers."""
    pairs = []
    for marker_id in ids:
        in_camera = transform_points(pose.camera_from_board, board.corners(marker_id))
        normal = np.cross(in_camera[1] - in_camera[0], in_camera[3] - in_camera[0])
        pixels = np.rint((in_camera @ camera.K.T)[:, :2] / in_camera[:, 2:]).astype(int)
        inside = ((pixels >= 0) & (pixels < (camera.width, camera.height))).all(axis=1)
        for u, v in pixels[inside]:
            ray = np.linalg.inv(camera.K) @ (u, v, 1.0)
            pairs.append((depth[v, u], (normal @ in_camera[0]) / (normal @ ray)))
    return np.array([pair for pair in pairs if pair[0] > 0])


def fitted(pairs: np.ndarray) -> tuple[float, float]:
    """A and b by least squares with outliers pruned (those off by more than three robust deviations)."""
    kept = np.ones(len(pairs), bool)
    a, b = 1.0, 0.0
    for _ in range(5):
        a, b = np.polyfit(pairs[kept, 0], pairs[kept, 1], 1)
        off = np.abs(a * pairs[:, 0] + b - pairs[:, 1])
        kept = off < 3 * 1.4826 * np.median(off)
    return a, b


def main(config: Config) -> None:
    """Render, find, compare, print."""
    board, camera, sensor = (
        framed_board(dictionary=config.dictionary),
        sensor_camera(config.camera),
        depth_sensor(config.sensor),
    )
    start = time.perf_counter()
    scene, rng = board_scene(board, config.seed), np.random.default_rng(config.seed)
    console = Console()
    console.print(f"room and board: {time.perf_counter() - start:.1f} s")
    objects = objects_on(rng)
    table = Table("az", "el", "m", "seen", "mean px", "RMS px", "mm", "deg", "s")
    pairs, errors = [], []
    for k, azimuth in enumerate(config.azimuths):
        distance = config.distances[k % len(config.distances)]
        for turn in board_sequence(scene, camera, [azimuth], config.elevations, distance):
            start = time.perf_counter()
            tracer = PathTracer(turn.world, objects)
            console.print(f"turn to {turn.turn_deg:g} degrees, scene loaded: {time.perf_counter() - start:.1f} s")
            for view, seen in zip(turn.views, turn.cameras, strict=True):
                start = time.perf_counter()
                camera_from_board = inverse(view.board_from_camera)
                detections = detect(tracer.render(seen, camera_from_board, config.preset), board)
                pose = camera_pose(detections, board, seen)
                off = pose.camera_from_board @ view.board_from_camera
                errors.append((pose.errors_px.mean(), pose.rms_px, 1000 * np.linalg.norm(off[:3, 3]),
                               np.degrees(rotation_error(off[:3, :3], np.eye(3)))))  # fmt: skip
                everything = [(turn.world.model, camera_from_board)]
                everything += [(model, camera_from_board @ at) for model, _, at in objects]
                exact = render_scene(everything, seen, pixel_center=0.0).depth
                pairs.append(corner_depths(sensor.measure(exact, seen.K, rng), pose, detections.ids, board, seen))
                row = (f"{view.azimuth_deg:g}", f"{view.elevation_deg:g}", f"{distance:g}", str(len(detections.ids)))
                table.add_row(*row, *(f"{value:.3f}" for value in errors[-1]), f"{time.perf_counter() - start:.1f}")
            del tracer  # Mitsuba reuses compiled code for a scene like one that is gone
    table.add_section()
    for name, reduced in (("mean", np.mean(errors, axis=0)), ("max", np.max(errors, axis=0))):
        table.add_row(name, "", "", "", *(f"{value:.3f}" for value in reduced), "")
    console.print(table)
    a, b = fitted(np.concatenate(pairs))
    console.print(f"depth correction at {sum(map(len, pairs))} corners: a = {a:.4f} (true {sensor.a}), b = {1000 * b:.2f} mm"
                  f" (true {1000 * sensor.b:.2f} mm)")  # fmt: skip


if __name__ == "__main__":
    main(tyro.cli(Config))
