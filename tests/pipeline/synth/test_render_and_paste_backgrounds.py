"""Backgrounds of render-and-paste images: photographs of a folder, and made-up ones."""

import logging
from pathlib import Path

import cv2
import numpy as np
import pytest

from pipeline.exceptions import FormatError, MissingFileError
from pipeline.synth.render_and_paste import PasteSettings, PhotoFolder, made_up_scenery
from pipeline.synth.render_and_paste.patterns import SURFACES


def write(path: Path, rgb: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), rgb[..., ::-1])


def ramp(width: int, height: int) -> np.ndarray:
    """Red tells the column, green the row, as shares of 240."""
    y, x = np.indices((height, width))
    return np.stack([240 * x / (width - 1), 240 * y / (height - 1), 0 * x + 90], axis=-1).round().astype(np.uint8)


@pytest.mark.parametrize(("width", "height"), [(200, 60), (60, 200), (64, 48), (20, 12), (1000, 700)])
def test_a_photograph_is_scaled_to_cover_the_image_and_cut_in_its_middle(tmp_path: Path, width: int, height: int):
    write(tmp_path / "photo.png", ramp(width, height))
    image = PhotoFolder(tmp_path, "center").image(np.random.default_rng(0), 64, 48)
    assert image.shape == (48, 64, 3)
    scale = max(64 / width, 48 / height)
    seen = 240 * np.array([64 / width, 48 / height]) / scale  # levels across the image
    reach = np.ptp(image[..., :2].astype(float), axis=(0, 1))
    assert reach == pytest.approx(seen, abs=12)
    assert image[..., :2].reshape(-1, 2).mean(axis=0) == pytest.approx([120, 120], abs=6)


def test_random_cuts_reach_all_of_a_photograph(tmp_path: Path):
    write(tmp_path / "photo.png", ramp(200, 48))
    folder = PhotoFolder(tmp_path)
    rng = np.random.default_rng(0)
    lefts = np.array([folder.image(rng, 64, 48)[0, 0, 0] for _ in range(200)], float)
    assert lefts.min() < 5
    assert lefts.max() == pytest.approx(240 * 136 / 200, abs=5)


def test_photographs_are_chosen_by_the_seed_also_from_subfolders(tmp_path: Path):
    for i in range(4):
        write(tmp_path / f"a{i % 2}" / f"{i}.JPG", np.full((48, 64, 3), 40 + 50 * i, np.uint8))
    (tmp_path / "notes.txt").write_text("no photograph")
    folder, other = PhotoFolder(tmp_path), PhotoFolder(tmp_path)
    levels = [folder.image(np.random.default_rng(seed), 64, 48)[0, 0, 0] for seed in range(40)]
    assert len(set(levels)) == 4
    assert levels[::-1] == [other.image(np.random.default_rng(seed), 64, 48)[0, 0, 0] for seed in range(39, -1, -1)]


def test_bad_photographs_are_skipped_with_one_warning(tmp_path: Path, caplog: pytest.LogCaptureFixture):
    write(tmp_path / "good.png", np.full((48, 64, 3), 200, np.uint8))
    (tmp_path / "empty.jpg").touch()
    (tmp_path / "text.png").write_text("not a picture at all")
    whole = cv2.imencode(".jpg", np.full((300, 300, 3), 9, np.uint8))[1].tobytes()
    (tmp_path / "cut.jpg").write_bytes(whole[: len(whole) // 2])
    folder = PhotoFolder(tmp_path)
    with caplog.at_level(logging.WARNING):
        images = [folder.image(np.random.default_rng(seed), 64, 48) for seed in range(30)]
    assert all((image == 200).all() for image in images)
    assert len(caplog.records) == 1
    assert "it is skipped, as are others that cannot be read" in caplog.text


def test_folders_without_a_usable_photograph_are_refused_in_one_line(tmp_path: Path):
    with pytest.raises(MissingFileError, match=r"absent: is no folder of background photographs; give one, or none"):
        PhotoFolder(tmp_path / "absent")
    with pytest.raises(MissingFileError, match=r"has no background photographs \(.*\.jpg.*\); give a folder that has"):
        PhotoFolder(tmp_path)
    (tmp_path / "bad.png").touch()
    with pytest.raises(FormatError, match="none of its 1 photographs can be read; replace them") as refusal:
        PhotoFolder(tmp_path).image(np.random.default_rng(0), 64, 48)
    assert "\n" not in str(refusal.value)
    assert PasteSettings(backgrounds=tmp_path).crop == "random"


@pytest.mark.parametrize(("width", "height"), [(640, 480), (64, 48), (97, 211), (16, 9)])
def test_made_up_backgrounds_of_any_size_follow_the_seed(width: int, height: int):
    for seed in range(12):
        image, again = (made_up_scenery(np.random.default_rng(seed), width, height) for _ in range(2))
        assert image.shape == (height, width, 3)
        assert image.dtype == np.uint8
        assert np.array_equal(image, again)


@pytest.mark.parametrize("surface", sorted(set(SURFACES), key=lambda kind: kind.__name__))
def test_every_kind_of_surface_has_any_size(surface):
    for seed, (width, height) in enumerate([(4, 4), (5, 90), (120, 7), (160, 120)]):
        assert surface(np.random.default_rng(seed), width, height).shape == (height, width, 3)


def test_made_up_backgrounds_are_varied_and_neither_black_nor_white():
    images = [made_up_scenery(np.random.default_rng(seed), 320, 240) for seed in range(60)]
    levels = np.array([image.mean() for image in images])
    assert 70 < levels.mean() < 170
    assert levels.std() > 20
    colors = np.array([image.reshape(-1, 3).mean(axis=0) / image.mean() for image in images])
    assert colors.std(axis=0).min() > 0.05
    edges = np.array([np.abs(np.diff(image.astype(int), axis=1)).mean() for image in images])
    assert np.quantile(edges, 0.9) > 5 * np.quantile(edges, 0.1) > 0  # from blurred to dense
    assert np.median(edges) > 1.5
    assert np.mean([image.std() > 15 for image in images]) > 0.8  # nearly all have structure
