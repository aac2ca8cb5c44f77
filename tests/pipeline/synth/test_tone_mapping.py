"""Development of radiance into pictures: exposure, white balance, highlights, noise."""

import numpy as np
import pytest

from pipeline.synth.tracing.tone_mapping import PhotoConfig, exposure, photograph

PLAIN = PhotoConfig(noise=0.0)


def ramp(top: float = 1.0) -> np.ndarray:
    """A gray ramp from black."""
    return np.repeat(np.linspace(0, top, 60 * 80, dtype=np.float32).reshape(60, 80, 1), 3, axis=2)


def test_exposure_does_not_depend_on_the_unit_of_light():
    np.testing.assert_array_equal(photograph(ramp(1.0), PLAIN), photograph(ramp(1000.0), PLAIN))


def test_brighter_stays_brighter_and_nothing_wraps():
    gray = photograph(ramp(), PLAIN)[..., 0].astype(int).ravel()
    assert (np.diff(gray) >= 0).all()
    assert gray[0] == 0
    assert 200 < gray[-1] <= 255


def test_a_small_lamp_in_a_dark_room_does_not_leave_it_black():
    room = np.full((60, 80, 3), 0.05, np.float32)
    room[:10, :10] = 50.0
    image = photograph(room, PLAIN)
    assert 80 < image[30, 40, 0] < 240
    assert image[5, 5].min() > 240


def test_a_bright_window_leaves_the_room_visible():
    room = np.full((60, 80, 3), 0.05, np.float32)
    room[:20, :40] = 2.0
    assert photograph(room, PLAIN)[50, 60, 0] > 50


def test_black_stays_black():
    assert exposure(np.zeros((4, 4, 3), np.float32), PLAIN) == 1.0
    assert photograph(np.zeros((4, 4, 3), np.float32), PLAIN).max() == 0


@pytest.mark.parametrize("share", [0.0, 1.0])
def test_white_balance_takes_out_the_lights_colour(share):
    white = (1.4, 1.0, 0.6)
    image = photograph(ramp() * np.array(white, np.float32), PhotoConfig(white_balance=share), white)
    red, _, blue = image[30, 40].astype(int)
    assert (abs(red - blue) <= 1) == (share == 1.0)


def test_noise_is_seeded_and_grows_with_light():
    config = PhotoConfig(noise=0.02)
    one, same = (photograph(ramp(), config, rng=np.random.default_rng(4)) for _ in range(2))
    np.testing.assert_array_equal(one, same)
    assert (one != photograph(ramp(), config, rng=np.random.default_rng(5))).any()
