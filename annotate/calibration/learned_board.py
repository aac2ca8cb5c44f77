"""The layout of markers on one plane, learned from images of them; their size is 1, for images do not tell it.

Markers that lie about on a table, each a square of the same unknown size: the plane, where each marker lies on it, and
the cameras are found together by least squares of the reprojection errors.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Float

from annotate.calibration.marker_sightings import SQUARE, Sightings
from pipeline.geometry import inverse, transform
from pipeline.scene import Camera
from pipeline.synth.boards import Detections

FARTHEST_PX = 4.0
"""A marker whose corners lie farther off on average is left out."""


class Placement(NamedTuple):
    """Where a marker lies on the plane, in units of its side."""

    x: float
    y: float
    turn: float
    """Radians, counter-clockwise seen from above."""

    @property
    def corners(self) -> Float[np.ndarray, "4 3"]:
        """On the plane z = 0."""
        c, s = np.cos(self.turn), np.sin(self.turn)
        return SQUARE @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1.0]]) + (self.x, self.y, 0.0)


@dataclass(frozen=True, eq=False)
class LearnedBoard:
    """Markers whose places were found from images that share them."""

    placements: dict[int, Placement]
    """By id."""
    views: dict[int, Float[np.ndarray, "4 4"]]
    """camera_from_board by the position of the image; translations in units of the markers' side."""
    errors_px: Float[np.ndarray, "n"]
    """Of all corners in all images that count."""
    left_out: int
    """Detections that do not fit the others: misread markers, or some that were moved."""

    @property
    def rms_px(self) -> float:
        """Root mean square over all corners."""
        return float(np.sqrt((self.errors_px**2).mean()))


def learn_boards(seen: Sequence[Detections], cameras: Sequence[Camera]) -> list[LearnedBoard]:
    """Learn the layout of the markers that images of one scene show; one board for each group that images connect."""
    left = {i for i, detections in enumerate(seen) if detections.ids}
    boards = []
    while left:
        start = max(left, key=lambda i: (len(seen[i].ids), -i))
        placements, views = _begin(seen[start], cameras[start], start)
        while grown := _grow(seen, cameras, placements, views, left):
            views[grown[0]] = grown[1]
        left -= views.keys()
        boards.append(_adjusted(seen, cameras, placements, views))
    return boards


def _begin(
    detections: Detections, camera: Camera, image: int
) -> tuple[dict[int, Placement], dict[int, Float[np.ndarray, "4 4"]]]:
    """Place all markers of an image on the plane of that of them with which they come out most alike in size."""
    best: tuple[float, dict[int, Placement], np.ndarray] | None = None
    for first in range(len(detections.ids)):
        for pose in _square_poses(detections.pixels[first], camera):
            placed = {k: _placed(camera, pose, q) for k, q in zip(detections.ids, detections.pixels, strict=True)}
            off = sum(error for _, error in placed.values())
            if best is None or off < best[0]:
                best = off, {k: placement for k, (placement, _) in placed.items()}, pose
    assert best is not None  # there is a marker, and a square has at least one pose
    return best[1], {image: best[2]}


def _grow(
    seen: Sequence[Detections],
    cameras: Sequence[Camera],
    placements: dict[int, Placement],
    views: dict[int, Float[np.ndarray, "4 4"]],
    left: set[int],
) -> tuple[int, Float[np.ndarray, "4 4"]] | None:
    """The next image that shows known markers, its pose; places its other markers. None if there is none."""
    common = {i: [k for k in seen[i].ids if k in placements] for i in left - views.keys()}
    image = max(common, key=lambda i: len(common[i]), default=None)
    if image is None or not common[image]:
        return None
    known = [seen[image].ids.index(k) for k in common[image]]
    points = np.concatenate([placements[k].corners for k in common[image]])
    pixels = seen[image].pixels[known].reshape(-1, 2)
    _, turns, shifts, _ = cv2.solvePnPGeneric(points, pixels, cameras[image].K, None, flags=cv2.SOLVEPNP_IPPE)
    pose = transform(np.asarray(cv2.Rodrigues(turns[0])[0]), np.ravel(shifts[0]))
    for k, quad in zip(seen[image].ids, seen[image].pixels, strict=True):
        if k not in placements:
            placements[k] = _placed(cameras[image], pose, quad)[0]
    return image, pose


def _square_poses(quad: Float[np.ndarray, "4 2"], camera: Camera) -> list[Float[np.ndarray, "4 4"]]:
    """The two poses that a square may have."""
    flags = cv2.SOLVEPNP_IPPE_SQUARE
    _, turns, shifts, _ = cv2.solvePnPGeneric(SQUARE, quad, camera.K, None, flags=flags)
    return [transform(np.asarray(cv2.Rodrigues(r)[0]), np.ravel(t)) for r, t in zip(turns, shifts, strict=True)]


def _placed(camera: Camera, pose: Float[np.ndarray, "4 4"], quad: Float[np.ndarray, "4 2"]) -> tuple[Placement, float]:
    """Where on the plane z = 0 of a pose a marker lies, and by how much it is no square of side 1 there."""
    rays = np.column_stack([quad, np.ones(4)]) @ np.linalg.inv(camera.K).T
    board_from_camera = inverse(pose)
    turned = rays @ board_from_camera[:3, :3].T
    depth = -board_from_camera[2, 3] / np.where(np.abs(turned[:, 2]) > 1e-9, turned[:, 2], 1e-9)
    on_plane = (board_from_camera[:3, 3] + depth[:, None] * turned)[:, :2]
    middle = on_plane.mean(axis=0)
    across = (on_plane - middle) @ np.array([1, 1j])
    turn = np.angle((across * np.conj(SQUARE[:, :2] @ np.array([1, 1j]))).sum())
    placement = Placement(float(middle[0]), float(middle[1]), float(turn))
    return placement, float(np.abs(on_plane - placement.corners[:, :2]).sum())


def _adjusted(
    seen: Sequence[Detections],
    cameras: Sequence[Camera],
    placements: dict[int, Placement],
    views: dict[int, Float[np.ndarray, "4 4"]],
) -> LearnedBoard:
    """Least squares of all reprojection errors; the first marker stays, for it is the frame."""
    ids, images = list(placements), list(views)
    pairs = [(i, k, quad) for i in images for k, quad in zip(seen[i].ids, seen[i].pixels, strict=True)]
    problem = Sightings(
        np.array([images.index(i) for i, _, _ in pairs]),
        np.array([ids.index(k) for _, k, _ in pairs]),
        np.stack([quad for _, _, quad in pairs]),
        np.stack([cameras[i].K for i in images]),
        np.array(placements[ids[0]]),
    )
    rotations = [np.ravel(cv2.Rodrigues(views[i][:3, :3])[0]) for i in images]
    poses = [np.concatenate([turn, views[i][:3, 3]]) for turn, i in zip(rotations, images, strict=True)]
    vector = problem.solved(np.concatenate([*poses, *(np.array(placements[k]) for k in ids[1:])]))
    fitting = problem.distances(vector).mean(axis=1) <= FARTHEST_PX
    if not fitting.all():
        problem = problem.chosen(fitting)
        vector = problem.solved(vector)
    camera_from_board, placed = problem.unpacked(vector)
    return LearnedBoard(
        {k: Placement(*row) for k, row in zip(ids, placed.tolist(), strict=True)},
        dict(zip(images, camera_from_board, strict=True)),
        problem.distances(vector).ravel(),
        int((~fitting).sum()),
    )
