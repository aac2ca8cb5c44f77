"""Marker boards: where the corners are, what their prints show, and their description on disk."""

import json

import cv2
import numpy as np
import pytest

from pipeline.exceptions import FormatError, InputError, MissingFileError, UnknownIdError
from pipeline.geometry import inverse, transform_points
from pipeline.synth.boards import MarkerBoard, framed_board, grid_board, read_board, write_board, write_picture
from pipeline.synth.boards.marker_board import opencv_dictionary

APRIL = "DICT_APRILTAG_36h11"


def found(picture: np.ndarray, dictionary: str) -> dict[int, np.ndarray]:
    """Corners of the markers in a print, as plain OpenCV finds them, in pixels from the edge of the picture."""
    padded = cv2.copyMakeBorder(picture, 20, 20, 20, 20, cv2.BORDER_CONSTANT, value=255)
    corners, ids, _ = cv2.aruco.ArucoDetector(opencv_dictionary(dictionary)).detectMarkers(padded)
    return {int(k): c.reshape(4, 2) - 20 + 0.5 for k, c in zip(np.ravel(ids), corners, strict=True)}


def test_a_framed_board_leaves_its_middle_free_and_numbers_the_rest():
    board = framed_board(8, 6, 4, 2, 0.05, 0.0125, 0.02, sides=False)
    assert board.ids == tuple(range(8 * 6 - 4 * 2))
    assert board.size == pytest.approx((8 * 0.0625 - 0.0125 + 0.04, 6 * 0.0625 - 0.0125 + 0.04))
    np.testing.assert_allclose(np.abs(board.corner_points[..., :2]).max(axis=(0, 1)), np.array(board.size) / 2 - 0.02)
    upper_left = board.corners(0)
    np.testing.assert_allclose(upper_left[0], (-board.size[0] / 2 + 0.02, board.size[1] / 2 - 0.02, 0))
    np.testing.assert_allclose(upper_left[1] - upper_left[0], (0.05, 0, 0), atol=1e-12)
    np.testing.assert_allclose(upper_left[3] - upper_left[0], (0, -0.05, 0), atol=1e-12)
    nearest = np.abs(board.corner_points[..., :2]) - np.array(board.free) / 2
    assert (nearest.max(axis=-1) > 0.0125 - 1e-9).all()  # every corner keeps a quiet zone from the middle


def test_a_grid_board_is_full():
    board = grid_board(5, 4, dictionary="DICT_5X5_50", first_id=10)
    assert board.ids == tuple(range(10, 30))
    assert board.free == (0.0, 0.0)
    assert board.height == 0.0
    assert np.ptp(board.corner_points[..., 2]) == 0


@pytest.mark.parametrize("dictionary", ["DICT_4X4_100", APRIL])
def test_opencv_reads_the_print_of_every_face_where_the_corners_are(dictionary):
    board = framed_board(4, 6, 2, 2, 0.04, 0.01, 0.012, dictionary=dictionary)
    assert set(board.faces) == {"top", "south", "east", "north", "west"}
    seen = {}
    for name, face in board.faces.items():
        for marker_id, corners in found(board.picture(3000.0, name), dictionary).items():
            on_face = np.c_[corners / 3000.0 * (1, -1) + (-face.width / 2, face.height / 2), np.zeros(4)]
            seen[marker_id] = transform_points(face.board_from_face, on_face)
    assert sorted(seen) == list(board.ids)
    for marker_id, corners in seen.items():
        np.testing.assert_allclose(corners, board.corners(marker_id), atol=0.001)


def test_markers_on_the_sides_look_outward():
    board = framed_board(4, 6, 2, 2)
    for name, outward in {"south": (0, -1, 0), "east": (1, 0, 0), "north": (0, 1, 0), "west": (-1, 0, 0)}.items():
        face = board.faces[name]
        np.testing.assert_allclose(face.board_from_face[:3, 2], outward)
        np.testing.assert_allclose(face.board_from_face[:3, 1], (0, 0, 1))
        np.testing.assert_allclose(np.abs(face.board_from_face[:3, 3] @ outward), board.size[abs(outward[1])] / 2)
    sides = [board.corners(k) for k in board.ids if board.corners(k)[:, 2].max() < 0]
    assert len(sides) == 2 * (4 + 6)
    for corners in sides:
        outward = np.cross(corners[3] - corners[0], corners[1] - corners[0])
        assert outward @ corners.mean(axis=0) > 0


def test_a_description_reads_back(tmp_path):
    board = framed_board(6, 6, 2, 2, dictionary=APRIL, first_id=7)
    write_board(tmp_path / "board.json", board)
    again = read_board(tmp_path / "board.json")
    assert (again.dictionary, again.ids) == (APRIL, board.ids)
    assert again.size == pytest.approx(board.size)
    assert again.free == pytest.approx(board.free)
    assert again.height == pytest.approx(board.height)
    np.testing.assert_allclose(again.corner_points, board.corner_points, atol=1e-9)
    content = json.loads((tmp_path / "board.json").read_text())
    assert content["unit"] == "m"
    assert content["markers"][0]["id"] == 7


def test_a_description_may_be_in_millimetres_and_without_a_size(tmp_path):
    corners = [[10, 50, 0], [50, 50, 0], [50, 10, 0], [10, 10, 0]]
    content = {"unit": "mm", "dictionary": "DICT_4X4_50", "markers": [{"id": 3, "corners": corners}]}
    (tmp_path / "board.json").write_text(json.dumps(content))
    board = read_board(tmp_path / "board.json")
    np.testing.assert_allclose(board.corners(3), np.array(corners) / 1000)
    assert board.size == pytest.approx((0.1, 0.1))


SQUARE = [[0, 0.04, 0], [0.04, 0.04, 0], [0.04, 0, 0], [0, 0, 0]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"unit": "inch"}, '"unit" is "inch"; write "m" or "mm"'),
        ({"unit": None}, '"unit" is null; write "m" or "mm"'),
        ({"unit": ["m"]}, r'"unit" is \["m"\]; write "m" or "mm"'),
        ({"markers": []}, '"markers" is missing or empty; list each marker'),
        ({"markers": [{"id": "a", "corners": SQUARE}]}, 'marker 0 of the list has no whole number as "id"'),
        ({"markers": [{"id": True, "corners": SQUARE}]}, 'marker 0 of the list has no whole number as "id"'),
        ({"markers": [{"id": 1, "corners": SQUARE[:3]}]}, "corners of marker 1: expected 4 x 3 finite numbers"),
        ({"markers": [{"id": 1, "corners": [["x", 0, 0]] * 4}]}, "corners of marker 1: expected 4 x 3 finite numbers"),
        ({"markers": [{"id": 77, "corners": SQUARE}]}, "id 77 is not in DICT_4X4_50, which has ids 0 to 49"),
        ({"markers": [{"id": 1, "corners": SQUARE}] * 2}, "id 1 appears more than once"),
        ({"markers": [{"id": 1, "corners": [SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]]}]}, "marker 1 is no square"),
        (
            {"markers": [{"id": 1, "corners": SQUARE[::-1]}]},
            "corners of marker 1 run counter-clockwise seen from above",
        ),
        ({"dictionary": "DICT_9X9_50"}, "dictionary DICT_9X9_50 is not in those of OpenCV; available: DICT_4X4_100"),
        ({"dictionary": None}, "dictionary None is not in those of OpenCV"),
        ({"size": [0.1, 0.1], "free": [0.2, 0.1]}, r"free middle \(0.2, 0.1\), height 0.0 m; give a size above 0"),
        ({"size": [1.0]}, "size: expected 2 finite numbers; got"),
        ({"height": "tall"}, "height: expected one finite number; got tall"),
    ],
)
def test_a_wrong_description_is_told_in_one_line(tmp_path, change, message):
    content = {"unit": "m", "dictionary": "DICT_4X4_50", "markers": [{"id": 1, "corners": SQUARE}]} | change
    path = tmp_path / "board.json"
    path.write_text(json.dumps(content))
    with pytest.raises(FormatError, match=message) as error:
        read_board(path)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


def test_a_missing_description_is_told(tmp_path):
    with pytest.raises(MissingFileError, match=r"board\.json: no such file"):
        read_board(tmp_path / "board.json")


def test_a_print_has_its_true_size(tmp_path):
    Image = pytest.importorskip("PIL.Image")

    board = grid_board(3, 2, 0.03, 0.01, 0.01)
    write_picture(tmp_path / "board.png", board, dpi=300)
    with Image.open(tmp_path / "board.png") as image:
        metres = np.array(image.size) / np.array(image.info["dpi"]) * 0.0254
        np.testing.assert_allclose(metres, board.size, atol=0.5 * 0.0254 / 300)
        printed = np.asarray(image)
    assert set(np.unique(printed)) == {0, 255}
    px_per_metre = round(300 / 0.0254)
    for marker_id, corners in found(printed, board.dictionary).items():
        in_metres = corners / px_per_metre * (1, -1) + (-board.size[0] / 2, board.size[1] / 2)
        np.testing.assert_allclose(in_metres, board.corners(marker_id)[:, :2], atol=1.5 / px_per_metre)


@pytest.mark.parametrize(
    ("made", "message"),
    [
        (lambda: framed_board(12, 12, 4, 4), r"id 100 is not in DICT_4X4_100, which has ids 0 to 99; take a larger"),
        (lambda: framed_board(8, 8, 3, 4), "leave the same number on opposite sides"),
        (lambda: framed_board(8, 8, 8, 4), "the free middle must be smaller than the board"),
        (lambda: grid_board(0, 4), "marker board of 0 x 4 markers of 0.04 m; give at least one"),
        (lambda: grid_board(4, 4, gap=0.0), "gap 0.0 m and margin 0.01 m; markers need some white about them"),
        (lambda: MarkerBoard("DICT_4X4_50", (1, 2), np.array([SQUARE]), (1.0, 1.0)), "2 ids for 1 markers"),
    ],
)
def test_boards_that_cannot_be_are_refused(made, message):
    with pytest.raises(InputError, match=message):
        made()


def test_unknown_markers_and_faces_are_told_with_those_there_are():
    board = grid_board(2, 2)
    with pytest.raises(UnknownIdError, match="marker 9 is not in the board; available: 0, 1, 2, 3"):
        board.corners(9)
    with pytest.raises(UnknownIdError, match="face south is not in the board; available: top"):
        board.picture(1000.0, "south")


def test_sides_and_frames_are_rigid():
    for face in framed_board().faces.values():
        rotation = face.board_from_face[:3, :3]
        np.testing.assert_allclose(inverse(face.board_from_face)[:3, :3], rotation.T, atol=1e-12)
        assert np.linalg.det(rotation) == pytest.approx(1.0)
