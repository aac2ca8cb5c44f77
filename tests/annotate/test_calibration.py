"""Calibration: a known camera is found from its patterns, poses from a board, and markers of no standard dictionary."""

import io
import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console
from scipy.spatial.transform import Rotation

from annotate.calibration import (
    Calibration,
    CharucoBoard,
    Checkerboard,
    MarkerDictionary,
    any_dictionary,
    calibrate,
    detect_markers,
    learn_boards,
    learn_dictionary,
    read_dictionary,
    sensor_poses,
    undistorted,
    write_dictionary,
)
from annotate.depth import scene_boards
from inspector.commands.calibrate import CalibrateConfig, run
from pipeline.bop.dataset import open_dataset
from pipeline.exceptions import FormatError, InputError, UnknownIdError
from pipeline.scene import Camera

DEMO = Path(__file__).resolve().parents[2] / "assets" / "demo"
K = np.array([[520.0, 0, 322.0], [0, 524.0, 236.0], [0, 0, 1]])
LENS = np.array([-0.12, 0.05, 0.001, -0.0005, 0.0])
SIZE = (640, 480)
PATTERN = Checkerboard(8, 6, 0.03)
SQUARE_PX = 80


def checkerboard() -> np.ndarray:
    squares = np.indices((PATTERN.rows + 1, PATTERN.columns + 1)).sum(axis=0) % 2 * 255
    board = np.kron(squares, np.ones((SQUARE_PX, SQUARE_PX))).astype(np.uint8)
    return cv2.copyMakeBorder(board, *[SQUARE_PX] * 4, cv2.BORDER_CONSTANT, value=255)


def seen(picture: np.ndarray, metres_per_px: float, step: int) -> np.ndarray:
    """A picture on a plane before the distorted camera, in another pose for each step."""
    rng = np.random.default_rng(step)
    R = Rotation.from_euler("xyz", rng.uniform((-0.6, -0.6, -0.3), (0.6, 0.6, 0.3))).as_matrix()
    extent = np.array([picture.shape[1], picture.shape[0]]) * metres_per_px
    t = np.array([*rng.uniform(-0.03, 0.03, 2), 0.45]) - R @ np.array([*extent / 2, 0])
    grid = np.stack(np.meshgrid(np.arange(0, SIZE[0], 0.5), np.arange(0, SIZE[1], 0.5)), axis=-1).reshape(-1, 1, 2)
    rays = cv2.undistortPoints(grid, K, LENS).reshape(-1, 2)
    plane = np.column_stack([rays, np.ones(len(rays))]) @ np.linalg.inv(np.column_stack([R[:, :2], t])).T
    at = (plane[:, :2] / plane[:, 2:] / metres_per_px - 0.5).astype(np.float32).reshape(2 * SIZE[1], 2 * SIZE[0], 2)
    fine = cv2.remap(picture, at[..., 0], at[..., 1], cv2.INTER_LINEAR, borderValue=255)
    return cv2.GaussianBlur(fine, (0, 0), 1.0)[::2, ::2]


@pytest.fixture(scope="module")
def checkerboards(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("checkerboards")
    for step in range(9):
        cv2.imwrite(str(folder / f"{step}.png"), seen(checkerboard(), PATTERN.square / SQUARE_PX, step))
    cv2.imwrite(str(folder / "nothing.png"), np.full(SIZE[::-1], 128, np.uint8))
    return folder


def test_a_known_camera_is_found_from_a_checkerboard(checkerboards):
    found = calibrate(sorted(checkerboards.iterdir()), PATTERN)
    np.testing.assert_allclose([found.K[0, 0], found.K[1, 1]], [520, 524], atol=3)
    np.testing.assert_allclose(found.K[:2, 2], [322, 236], atol=3)
    assert found.rms_px < 0.2
    assert found.distortion[0] == pytest.approx(-0.12, abs=0.03)
    assert [image.name for image in found.images] == [f"{step}.png" for step in range(9)]
    assert all(image.rms_px < 0.4 for image in found.images)
    assert found.notes[0] == "1 of 10 images do not show the pattern"


def test_a_known_camera_is_found_from_a_charuco_board(tmp_path):
    pattern = CharucoBoard(9, 7, 0.03, 0.022, "DICT_4X4_50")
    board = cv2.aruco.CharucoBoard((9, 7), 0.03, 0.022, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50))
    picture = board.generateImage((9 * SQUARE_PX, 7 * SQUARE_PX))
    for step in range(8):
        cv2.imwrite(str(tmp_path / f"{step}.png"), seen(picture, 0.03 / SQUARE_PX, step))
    found = calibrate(sorted(tmp_path.iterdir()), pattern)
    np.testing.assert_allclose([found.K[0, 0], found.K[1, 1]], [520, 524], atol=6)
    assert found.rms_px < 0.3


def test_undistorted_images_are_those_of_a_pinhole_and_depth_is_not_mixed():
    camera = Calibration(K, LENS, *SIZE, np.ones(4), 0.1, (), ())
    true = np.array([560.0, 420.0])
    ray = np.linalg.inv(K) @ [*true, 1]
    x, y = cv2.projectPoints(ray[None], np.zeros(3), np.zeros(3), K, LENS)[0].ravel()
    assert np.hypot(x - true[0], y - true[1]) > 5
    v, u = np.indices(SIZE[::-1])
    dot = (255 * np.exp(-((u - x) ** 2 + (v - y) ** 2) / 8)).astype(np.uint8)
    straight = undistorted(dot, camera).astype(float)
    assert [(straight * u).sum() / straight.sum(), (straight * v).sum() / straight.sum()] == pytest.approx(
        true, abs=0.1
    )
    depth = np.where(u > 300, 700, 900).astype(np.uint16)
    assert set(np.unique(undistorted(depth, camera, is_depth=True))) <= {0, 700, 900}
    with pytest.raises(InputError, match="image of 10 x 20 pixels: the calibration is of 640 x 480"):
        undistorted(np.zeros((20, 10), np.uint8), camera)


def test_too_few_images_and_impossible_patterns_are_told(checkerboards):
    with pytest.raises(InputError, match="0 of 3 images show the pattern; at least 3 are needed, so check its rows"):
        calibrate(sorted(checkerboards.iterdir())[:3], Checkerboard(11, 4, 0.03))
    with pytest.raises(InputError, match="checkerboard of 2 x 6 inner corners"):
        Checkerboard(2, 6, 0.03)
    with pytest.raises(InputError, match="markers smaller than the squares"):
        CharucoBoard(5, 5, 0.03, 0.04, "DICT_4X4_50")
    with pytest.raises(UnknownIdError, match="dictionary DICT_9X9 is not in those of OpenCV"):
        CharucoBoard(5, 5, 0.03, 0.02, "DICT_9X9")


def test_command_calibrates_and_undistorts(checkerboards, tmp_path):
    out = io.StringIO()
    config = CalibrateConfig(
        "intrinsics", checkerboards, checkerboard=(8, 6), square=30, undistort=tmp_path / "u", json=tmp_path / "c.json"
    )
    assert run(config, Console(file=out, width=120)) == 0
    assert "RMS over all corners: 0." in out.getvalue()
    assert json.loads((tmp_path / "c.json").read_text())["fx"] == pytest.approx(520, abs=3)
    assert len(list((tmp_path / "u").iterdir())) == 10
    with pytest.raises(InputError, match="give one of them"):
        run(CalibrateConfig("intrinsics", checkerboards))


def test_poses_of_the_turntable_and_their_rms():
    dataset = open_dataset(DEMO, "val_turntable")
    keys = list(dataset.images())[:3]
    found = sensor_poses(dataset, keys, scene_boards(dataset, keys))
    assert found.rms_px < 0.3
    assert found.corners > 400
    for key, pose in found.poses.items():
        off = pose.camera_from_board @ dataset.camera(key).world_from_camera
        np.testing.assert_allclose(off, np.eye(4), atol=0.001)


def own_markers(count: int = 6, cells: int = 4) -> MarkerDictionary:
    rng = np.random.default_rng(3)
    patterns = rng.integers(0, 2, (count, cells, cells)).astype(bool)
    return MarkerDictionary(patterns, border=2)


def pictures_of(dictionary: MarkerDictionary, images: int, cell_px: int = 9) -> list[np.ndarray]:
    """Images of all markers on a plane, from several sides."""
    framed = [np.pad(np.pad(one, dictionary.border), 2, constant_values=True) for one in dictionary.patterns]
    rows = [np.hstack(framed[k : k + 3]) for k in range(0, len(framed), 3)]
    sheet = np.kron(np.vstack(rows), np.ones((cell_px, cell_px))) * 200 + 30
    return [seen(sheet.astype(np.uint8), 0.3 / sheet.shape[1], step) for step in range(images)]


@pytest.fixture(scope="module")
def marker_images() -> list[np.ndarray]:
    return pictures_of(own_markers(), 8)


def test_markers_of_no_dictionary_are_learned_and_then_found(tmp_path, marker_images):
    images = marker_images
    learned = learn_dictionary(images[:5])
    assert learned.dictionary.patterns.shape == (6, 4, 4)
    assert learned.dictionary.border == 2
    write_dictionary(tmp_path / "own.json", learned.dictionary)
    found = any_dictionary(str(tmp_path / "own.json"))
    np.testing.assert_array_equal(found.patterns, learned.dictionary.patterns)
    for image in images[5:]:
        assert len(detect_markers(image, found).ids) == 6


def test_layout_of_markers_is_learned_from_images(marker_images):
    flat = [cv2.undistort(image, K, LENS) for image in marker_images[:6]]
    detections = [detect_markers(image, own_markers()) for image in flat]
    (board,) = learn_boards(detections, [Camera(K, *SIZE)] * 6)
    assert board.rms_px < 0.3
    assert sorted(board.placements) == list(range(6))
    places = np.array([board.placements[k][:2] for k in range(6)]) * 8  # cells: a marker has 8
    apart = np.linalg.norm(places[:, None] - places[None], axis=-1)
    assert apart[0, 1] == pytest.approx(12, abs=0.2)
    assert apart[0, 5] == pytest.approx(np.hypot(24, 12), abs=0.4)


def test_the_markers_around_lmo_are_learned(lmo):
    dataset = open_dataset(lmo)
    keys = list(dataset.images())
    learned = learn_dictionary([dataset.rgb(key) for key in keys[:20]])
    assert learned.dictionary.patterns.shape[1:] == (4, 4)
    assert learned.dictionary.border == 2
    assert len(learned.counts) >= 12
    cameras = [dataset.camera(key) for key in keys[20:30]]
    detections = [detect_markers(dataset.rgb(key), learned.dictionary) for key in keys[20:30]]
    assert np.mean([len(one.ids) for one in detections]) > 6
    board = max(learn_boards(detections, cameras), key=lambda one: len(one.views))
    assert len(board.views) == 10
    assert board.rms_px < 1.0


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"cells": 2, "markers": [["01", "11"]]}, '"cells" is 2; give a whole number from 3 to 8'),
        ({"cells": 3, "markers": [["010", "11"]]}, "marker 0 is .* write 3 rows such as"),
        ({"cells": 3, "markers": [["111", "101", "111"]]}, "marker 0 looks alike in 4 orientations"),
        ({"cells": 3, "markers": [["100", "000", "000"], ["001", "000", "000"]]}, "markers 0 and 1 are the same but"),
        ({"cells": 3, "border": 0, "markers": [["100"]]}, '"border" is 0; give a whole number from 1 to 4'),
    ],
)
def test_damaged_dictionary_files_are_told(tmp_path, content, message):
    (tmp_path / "d.json").write_text(json.dumps(content))
    with pytest.raises(FormatError, match=f"d.json: {message}"):
        read_dictionary(tmp_path / "d.json")


def test_images_without_markers_are_told():
    with pytest.raises(InputError, match="no markers in 2 images"):
        learn_dictionary([np.full((100, 100), 90, np.uint8)] * 2)
