"""Depth correction: a and b found from boards and poses, and what is said where they cannot be told."""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest

from annotate.calibration import named_dictionary
from annotate.depth import (
    DepthSamples,
    board_samples,
    check_registration,
    estimate,
    estimate_unknown_size,
    marker_samples,
    pose_samples,
    registration_shift,
    scene_boards,
)
from annotate.depth.corner_depth import corner_depths
from annotate.depth.fitting import fit
from pipeline.bop.dataset import Dataset, open_dataset
from pipeline.exceptions import InputError
from pipeline.scene import ImageKey
from pipeline.synth.boards import detect

DEMO = Path(__file__).resolve().parents[2] / "assets" / "demo"
TRUE_A, TRUE_B = 1.0247, -0.00519
SIZE = (640, 480)


@pytest.fixture(scope="module")
def turntable() -> Dataset:
    return open_dataset(DEMO, "val_turntable")


@pytest.fixture(scope="module")
def corners(turntable: Dataset) -> DepthSamples:
    keys = list(turntable.images())
    return board_samples(turntable, keys, scene_boards(turntable, keys)).samples


def made(a: float = 1.02, b: float = -0.01, depths=(0.5, 0.9), images: int = 8, noise: float = 0.001, seed: int = 0):
    """Samples of a sensor with a known linear error, corners in some images."""
    rng = np.random.default_rng(seed)
    expected = rng.uniform(*depths, 60 * images)
    measured = (expected - b) / a + rng.normal(0, noise, len(expected))
    pixels = rng.uniform((0, 0), SIZE, (len(expected), 2))
    keys = tuple(ImageKey(1, i) for i in range(images))
    return DepthSamples(measured, expected, pixels, np.repeat(np.arange(images), 60), keys, SIZE)


def changed(samples: DepthSamples, measured: np.ndarray) -> DepthSamples:
    return DepthSamples(measured, samples.expected, samples.pixels, samples.images, samples.keys, samples.image_size)


def test_error_of_the_turntable_is_found_from_its_board(corners):
    for near, far in ((0.53, 0.92), (0.0, 2.0)):
        found = estimate(corners, near, far)
        assert abs(found.a - TRUE_A) < 0.002
        assert abs(found.b - TRUE_B) < 0.001
        assert found.before > 0.010
        assert found.held_out.mean_abs < 0.001
        assert found.offered == ()
        assert found.notes == ()
        low, high = found.confidence.interval(0) or (0, 0)
        assert low < found.a < high
        assert high - low < 0.003
    assert (found.samples.expected > 0.4).all()


def test_error_of_the_turntable_is_found_from_its_poses(turntable):
    found = estimate(pose_samples(turntable, list(turntable.images())[::2]).samples)
    assert abs(found.a - TRUE_A) < 0.002
    assert abs(found.b - TRUE_B) < 0.001


@pytest.mark.parametrize("noise", [0.0, 0.001, 0.006])
def test_noise_does_not_flatten_the_slope(noise):
    found = estimate(made(a=1.03, b=-0.02, depths=(0.6, 0.75), noise=noise, images=30))
    assert found.a == pytest.approx(1.03, abs=max(4 * (found.confidence.std[0]), 1e-9))
    if noise == 0.006:  # plain least squares would be off by 10 % of the slope
        plain = np.polyfit(found.samples.measured, found.samples.expected, 1)[0]
        assert abs(found.a - 1.03) < 0.4 * abs(plain - 1.03)


def test_standard_deviations_are_those_of_repeated_estimates():
    found = [estimate(made(seed=seed, noise=0.002)) for seed in range(40)]
    spread = np.std([one.a for one in found])
    assert np.mean([one.confidence.std[0] for one in found]) == pytest.approx(spread, rel=0.4)


def test_wrong_measurements_do_no_harm():
    samples = made()
    measured = samples.measured.copy()
    measured[::6] += np.random.default_rng(1).uniform(0.05, 0.5, len(measured[::6]))
    found = fit("linear", changed(samples, measured))
    assert found.correction.a == pytest.approx(1.02, abs=0.001)
    assert (found.weights[::6] == 0).all()


def test_one_depth_gives_the_offset_alone_and_says_so():
    found = estimate(made(a=1.0, b=-0.012, depths=(0.699, 0.703)))
    assert found.a == 1.0
    assert found.b == pytest.approx(-0.012, abs=0.0003)
    assert found.fit.correction.kind == "offset"
    assert "all samples lie at one depth (0.699 to 0.703 m): a and b cannot be told apart" in found.notes[0]


def test_other_models_are_offered_only_when_they_are_better():
    samples = made(noise=0.0005)
    assert estimate(samples).offered == ()
    curved = changed(samples, samples.measured + 0.2 * (samples.measured - 0.7) ** 2)
    assert [one.kind for one in estimate(curved).offered] == ["quadratic"]
    tilted = changed(samples, samples.measured + 0.006 * (samples.pixels[:, 0] / SIZE[0] - 0.5))
    offered = estimate(tilted).offered
    assert [one.kind for one in offered] == ["regions"]
    assert offered[0].mean_abs < 0.6 * estimate(tilted).held_out.mean_abs


def test_few_images_and_an_empty_range_are_told():
    assert "1 image only: corners of it are held out in turn" in estimate(made(images=1)).notes[0]
    assert estimate(made(images=2)).confidence.std is None
    with pytest.raises(InputError, match=r"0 of 480 samples lie from 2 to 3 m \(they are at 0.5 to 0.899 m\)"):
        estimate(made(), 2.0, 3.0)


def test_depth_at_a_corner_is_that_of_the_plane_and_never_across_an_edge():
    v, u = np.indices((40, 40))
    plane = 1.0 / (1.4 + 0.004 * u - 0.002 * v)
    at = np.array([[17.3, 20.8], [2.0, 20.0], [np.nan, 1.0]])
    found = corner_depths(plane, at)
    assert found[0] == pytest.approx(1.0 / (1.4 + 0.004 * 17.3 - 0.002 * 20.8), abs=1e-9)
    assert np.isnan(found[1:]).all()  # at the border, and nowhere
    holes = plane.copy()
    holes[18:20, 14:18], holes[25, 15] = 0.0, 3.0
    assert corner_depths(holes, at)[0] == pytest.approx(found[0], abs=1e-6)
    edge = plane.copy()
    edge[:, 20:] += 0.03
    assert np.isnan(corner_depths(edge, at)[0])
    assert np.isnan(corner_depths(np.where(u > 15, 0.0, plane), at)[0])


def test_a_board_out_of_sight_one_marker_and_no_depth_are_told(tmp_path):
    dataset, keys = copied(tmp_path, images=1)
    boards = scene_boards(dataset, keys)
    board_file = tmp_path / "val_turntable" / "000001" / "board.json"
    content = json.loads(board_file.read_text())
    kept = content["markers"]
    seen = detect(dataset.rgb(keys[0]), boards[1]).ids[0]
    for markers, message in (
        ([one | {"id": 80 + k} for k, one in enumerate(kept[:9])], "0 of 9 markers seen; at least 2 are needed"),
        ([one for one in kept if one["id"] == seen], "1 of 1 markers seen; at least 2"),
    ):
        board_file.write_text(json.dumps(content | {"markers": markers}))
        with pytest.raises(InputError, match=f"no image to correct depth by; scene 1 image 0: .*{message}"):
            board_samples(dataset, keys, scene_boards(dataset, keys))
    depth_file = dataset.depth_path(keys[0])
    cv2.imwrite(str(depth_file), np.zeros((480, 640), np.uint16))
    with pytest.raises(InputError, match="scene 1 image 0: depth is 0 in all pixels"):
        board_samples(dataset, keys, boards)
    with pytest.raises(InputError, match="scene 1 image 0: depth is 0 in all pixels"):
        pose_samples(dataset, keys)


def test_a_missing_board_names_what_helps(tmp_path):
    dataset, keys = copied(tmp_path, images=1)
    (tmp_path / "val_turntable" / "000001" / "board.json").unlink()
    with pytest.raises(InputError, match=r"no scene of val_turntable has a board.json; give the description"):
        scene_boards(dataset, keys)


def test_markers_of_unknown_size_tell_size_and_offset_but_no_factor(turntable):
    keys = [key for key in turntable.images() if key.im_id % 2]
    found = estimate_unknown_size(marker_samples(turntable, keys, named_dictionary("DICT_4X4_100")))
    assert found.side == pytest.approx(0.05 / TRUE_A, abs=0.0003)
    assert found.b == pytest.approx(TRUE_B / TRUE_A, abs=0.004)
    assert found.as_dict()["a"] is None
    assert "takes up the factor a, which cannot be told" in found.notes[0]


def test_real_markers_of_unknown_size(shared_data):
    dataset = open_dataset(shared_data / "icbin")
    samples = marker_samples(dataset, list(dataset.images()), named_dictionary("DICT_ARUCO_ORIGINAL"))
    found = estimate_unknown_size(samples)
    assert found.side == pytest.approx(0.0965, abs=0.002)  # as measured by hand for the data's README
    assert found.side_std is not None
    assert found.side_std < 0.002
    assert abs(found.b) < 3 * found.b_std
    assert found.rms_px < 1.0


def test_shift_between_depth_and_colour(turntable):
    keys = list(turntable.images())[:3]
    found = check_registration(turntable, keys)
    assert not found.is_shifted
    assert found.shift.length < 0.4
    rgb, depth = turntable.rgb(keys[0]), turntable.depth(keys[0])
    moved = registration_shift(rgb, np.roll(depth, 3, axis=1))
    assert (moved.x, moved.y) == pytest.approx((-3, 0), abs=0.5)


def test_images_without_steps_of_depth_cannot_be_checked(tmp_path):
    assert registration_shift(np.zeros((60, 80, 3), np.uint8), np.full((60, 80), 0.7, np.float32)) is None


def copied(root: Path, images: int) -> tuple[Dataset, list[ImageKey]]:
    """A copy of the turntable with its first images, to be damaged."""
    shutil.copytree(DEMO / "models", root / "models")
    source, target = DEMO / "val_turntable" / "000001", root / "val_turntable" / "000001"
    for name in ("board.json", "scene_camera.json", "scene_gt.json"):
        target.mkdir(parents=True, exist_ok=True)
        shutil.copy(source / name, target / name)
    for kind in ("rgb", "depth"):
        (target / kind).mkdir()
        for path in sorted((source / kind).iterdir())[:images]:
            shutil.copy(path, target / kind / path.name)
    dataset = open_dataset(root, "val_turntable")
    return dataset, list(dataset.images())
