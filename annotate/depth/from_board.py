"""Depth at the corners of a marker board, measured and expected (thesis sec. tless_depth_correction)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from jaxtyping import Float

from annotate.depth.corner_depth import corner_depths
from annotate.depth.samples import DepthSamples, gathered
from pipeline.bop import layout
from pipeline.bop.dataset import Dataset
from pipeline.exceptions import InputError
from pipeline.geometry import project, transform_points
from pipeline.parallel import HERE, Workers
from pipeline.scene import Camera, ImageKey
from pipeline.synth.boards import BoardPose, Detections, MarkerBoard, camera_pose, detect, read_board

BOARD_FILE = "board.json"
"""In the folder of a scene: the description of its board."""


@dataclass(frozen=True, eq=False)
class Collected:
    """Samples of all images that have any, and what became of the others."""

    samples: DepthSamples
    notes: tuple[str, ...]


def board_samples(
    dataset: Dataset, keys: Sequence[ImageKey], boards: Mapping[int, MarkerBoard], workers: Workers = HERE
) -> Collected:
    """Depth at the corners of the board of each scene (by its id) in all images.

    Raises InputError if no image has any: it says what is wrong with the first, such as no board in sight, one marker
    only, or no measured depth.
    """
    found: dict[int, DepthSamples | str] = {}
    for position, samples in workers.map_unordered(_of_image, keys, (dataset, boards), total=len(keys)):
        found[position] = samples
    return collected(keys, found, str(dataset.root))


def scene_boards(dataset: Dataset, keys: Sequence[ImageKey], path: Path | None = None) -> dict[int, MarkerBoard]:
    """The board of each scene that images are from: the given one, else what the scene's `board.json` describes.

    Raises InputError if there is no description, or one that is damaged.
    """
    scenes = sorted({key.scene_id for key in keys})
    if path is not None:
        return dict.fromkeys(scenes, read_board(path))
    folders = layout.scene_folders(dataset.root / dataset.split)
    found = {scene: folders[scene] / BOARD_FILE for scene in scenes if (folders[scene] / BOARD_FILE).is_file()}
    if not found:
        raise InputError(
            f"{dataset.root}: no scene of {dataset.split} has a {BOARD_FILE}; give the description of the board with"
            " --board, or the markers' dictionary with --dictionary, or correct depth --from poses"
        )
    return {scene: read_board(file) for scene, file in found.items()}


def collected(keys: Sequence[ImageKey], found: dict[int, DepthSamples | str], where: str) -> Collected:
    """Samples by the position of their image put together, reasons why there are none as notes.

    Raises InputError if there are no samples at all.
    """
    parts = [(keys[i], samples) for i, samples in sorted(found.items()) if isinstance(samples, DepthSamples)]
    reasons = [f"scene {keys[i].scene_id} image {keys[i].im_id}: {text}" for i, text in _texts(found)]
    if not parts:
        raise InputError(f"{where}: no image to correct depth by; {reasons[0] if reasons else 'there are no images'}")
    usable = gathered(parts)
    notes = [f"{len(reasons)} of {len(keys)} images are left out, the first: {reasons[0]}"] if reasons else []
    return Collected(usable, tuple(notes))


def _texts(found: dict[int, DepthSamples | str]) -> list[tuple[int, str]]:
    return [(i, text) for i, text in sorted(found.items()) if isinstance(text, str)]


def _of_image(shared: tuple[Dataset, Mapping[int, MarkerBoard]], key: ImageKey) -> DepthSamples | str:
    """What a worker does: samples of an image, or why there are none."""
    dataset, boards = shared
    board = boards.get(key.scene_id)
    if board is None:
        return f"its scene has no {BOARD_FILE}"
    try:
        rgb, depth, camera = dataset.rgb(key), dataset.depth(key), dataset.camera(key)
        if rgb is None or depth is None:
            return f"has no {'colour' if rgb is None else 'depth'} image"
        detections = detect(rgb, board)
        return corner_samples(detections, board, camera_pose(detections, board, camera), camera, depth)
    except InputError as error:
        return str(error)


def corner_samples(
    detections: Detections,
    board: MarkerBoard,
    pose: BoardPose,
    camera: Camera,
    depth: Float[np.ndarray, "h w"],
) -> DepthSamples:
    """Measured and expected depth at the corners of one image that its pose was fitted to.

    Raises InputError if depth is 0 all over, or at none of the corners can be told.
    """
    if not (depth > 0).any():
        raise InputError("depth is 0 in all pixels; give images whose depth was measured")
    corners = np.concatenate([board.corners(k) for k in detections.ids])[pose.inliers.ravel()]
    in_camera = transform_points(pose.camera_from_board, corners)
    pixels = project(camera.K, in_camera)
    measured = corner_depths(depth, pixels)
    known = np.isfinite(measured)
    if not known.any():
        raise InputError(f"depth is measured about none of the {len(corners)} corners, or not on one plane")
    images = np.zeros(int(known.sum()), int)
    size = (camera.width, camera.height)
    return DepthSamples(measured[known], in_camera[known, 2], pixels[known], images, (), size)
