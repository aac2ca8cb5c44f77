import numpy as np
import pytest

from pipeline.synth.augmentation import Augmentation, AugmentationError, Change, augment

NOTHING = Augmentation(None, None, None, None, None, None)


def picture(seed: int = 0, low: int = 60, high: int = 190) -> np.ndarray:
    return np.random.default_rng(seed).integers(low, high, (48, 64, 3)).astype(np.uint8)


def always(low: float, high: float | None = None) -> Change:
    return Change(1.0, low, low if high is None else high)


def only(**changes: Change) -> Augmentation:
    return Augmentation(
        **{**dict.fromkeys(("brightness", "contrast", "saturation", "hue", "blur", "noise")), **changes}
    )


def changed(rgb: np.ndarray, seed: int = 0, **changes: Change) -> np.ndarray:
    return augment(rgb, np.random.default_rng(seed), only(**changes))


@pytest.mark.parametrize(
    "settings",
    [
        NOTHING,
        Augmentation(*[Change(0.0, 0.5, 0.9)] * 6),
        only(brightness=always(0), contrast=always(1), saturation=always(1), hue=always(0)),
        only(blur=always(0), noise=always(0)),
    ],
)
def test_settings_that_change_nothing_give_an_equal_copy(settings: Augmentation):
    rgb = picture()
    result = augment(rgb, np.random.default_rng(1), settings)
    assert np.array_equal(result, rgb)
    assert not np.shares_memory(result, rgb)


def test_the_image_given_is_left_as_it_is_and_the_seed_decides():
    rgb = picture()
    first, again, other = (augment(rgb, np.random.default_rng(seed)) for seed in (3, 3, 4))
    assert np.array_equal(rgb, picture())
    assert first.dtype == np.uint8
    assert first.shape == rgb.shape
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


@pytest.mark.parametrize("shape", [(1, 1), (5, 7), (3, 1)])
def test_images_of_any_size_and_memory_layout(shape: tuple[int, int]):
    rgb = np.full((*shape, 3), 90, np.uint8)
    everything = Augmentation(*[always(0.5)] * 6)
    result = augment(rgb, np.random.default_rng(0), everything)
    flipped = augment(np.flip(rgb, axis=(0, 1, 2)), np.random.default_rng(0), everything)
    assert result.shape == rgb.shape
    assert np.array_equal(result, flipped)


def test_brightness_adds_a_share_of_the_whole_range():
    assert np.array_equal(changed(picture(), brightness=always(0.2)), picture() + 51)
    assert (changed(picture(), brightness=always(1.0)) == 255).all()  # cut, not wrapped around


def test_contrast_scales_differences_from_the_mean_colour():
    rgb = picture().astype(float)
    mean = rgb.mean(axis=(0, 1))
    assert np.abs(changed(picture(), contrast=always(1.3)) - (mean + 1.3 * (rgb - mean))).max() <= 1.0
    assert np.ptp(changed(picture(), contrast=always(0.0)).reshape(-1, 3), axis=0).max() <= 1


def test_saturation_moves_colours_to_and_from_gray_of_their_brightness():
    gray = changed(picture(), saturation=always(0.0)).astype(int)
    assert np.ptp(gray, axis=-1).max() <= 1
    assert np.abs(gray[..., 0] - picture() @ [0.299, 0.587, 0.114]).max() <= 1.0
    strong = changed(picture(), saturation=always(1.3)).astype(int)
    assert np.abs(np.ptp(strong, axis=-1) - 1.3 * np.ptp(picture().astype(int), axis=-1)).max() <= 2.0


def test_hue_turns_colours_and_keeps_grays_and_brightness():
    grays = np.repeat(np.arange(240, dtype=np.uint8).reshape(12, 20, 1), 3, axis=2)
    assert np.abs(changed(grays, hue=always(77.0)).astype(int) - grays).max() <= 1
    red = np.full((4, 4, 3), (170, 90, 90), np.uint8)
    turned = changed(red, hue=always(120.0)).astype(int)[0, 0]
    assert turned.argmax() != 0
    assert abs((turned - red[0, 0]) @ [0.299, 0.587, 0.114]) < 1.5
    assert np.abs(changed(changed(red, hue=always(40.0)), hue=always(-40.0)).astype(int) - red).max() <= 2


def test_blur_spreads_a_point_by_its_standard_deviation():
    rgb = np.zeros((41, 41, 3), np.uint8)
    rgb[20, 20] = 255
    spread = changed(rgb, blur=always(1.5))[..., 1].astype(float)
    x = np.arange(41) - 20.0
    assert np.sqrt((spread.sum(axis=0) * x**2).sum() / spread.sum()) == pytest.approx(1.5, rel=0.12)


def test_noise_is_gaussian_and_independent_in_pixels_and_channels():
    flat = np.full((200, 200, 3), 128, np.uint8)
    noise = changed(flat, noise=always(0.05)).astype(float) - 128
    assert noise.mean() == pytest.approx(0.0, abs=0.15)
    assert noise.std() == pytest.approx(0.05 * 255, rel=0.02)
    assert (np.abs(noise) > 2 * 0.05 * 255).mean() == pytest.approx(0.0455, abs=0.006)  # the tails of a Gaussian
    flattened = noise.reshape(-1, 3)
    assert np.abs(np.corrcoef(flattened.T) - np.eye(3)).max() < 0.02
    assert abs(np.corrcoef(noise[:, 1:].ravel(), noise[:, :-1].ravel())[0, 1]) < 0.02


def test_each_change_is_made_in_its_share_of_images():
    rng, rgb = np.random.default_rng(5), picture()
    settings = only(brightness=Change(0.3, 0.1, 0.2))
    share = np.mean([not np.array_equal(augment(rgb, rng, settings), rgb) for _ in range(1000)])
    assert share == pytest.approx(0.3, abs=0.05)


def test_amounts_are_uniform_in_their_range():
    rng, rgb = np.random.default_rng(6), np.full((2, 2, 3), 128, np.uint8)
    settings = only(brightness=always(-0.2, 0.2))
    shifts = np.array([augment(rgb, rng, settings)[0, 0, 0] - 128.0 for _ in range(2000)]) / 255
    assert np.quantile(shifts, [0, 0.25, 0.5, 0.75, 1]) == pytest.approx([-0.2, -0.1, 0, 0.1, 0.2], abs=0.02)


def test_leaving_a_change_out_by_chance_moves_no_other():
    rgb = picture()
    for seed in range(5):
        both = changed(rgb, seed, brightness=Change(0.0, 0.1, 0.3), hue=always(-40, 40))
        alone = changed(rgb, seed, brightness=always(0.0), hue=always(-40, 40))
        assert np.array_equal(both, alone)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Change(1.2, 0, 1), r"chance 1\.2 of a change is outside 0\.\.1"),
        (lambda: Change(0.5, 2, 1), r"range 2\.\.1 of a change; give finite numbers, low before high"),
        (lambda: Change(0.5, 0, float("nan")), "give finite numbers"),
        (lambda: only(blur=Change(0.5, -1, 1)), r"blur from -1 on; nothing below 0 has a meaning"),
    ],
)
def test_settings_without_a_meaning_are_refused_in_one_line(make, message: str):
    with pytest.raises(AugmentationError, match=message) as refusal:
        make()
    assert "\n" not in str(refusal.value)
