"""The rest detector: what counts as rest, its means, its cost in memory."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nav_pose_estimator.core.rest import RestDetector, RestSettings

SETTINGS = RestSettings(window=2.0, gyro_sd=0.02, accel_sd=0.35, rate=0.1, force=0.8)
LEVEL = np.array([0.0, 0.0, 9.80665])


def run(detector, seconds, rate=100.0, start=0.0, gyro=(0, 0, 0), accel=LEVEL, gyro_sd=1e-3, accel_sd=0.02, seed=1):
    """Feed noisy samples; return the samples and the flag after each."""
    rng = np.random.default_rng(seed)
    t = start + np.arange(round(seconds * rate)) / rate
    w = np.array(gyro) + rng.normal(0.0, gyro_sd, (len(t), 3))
    f = np.array(accel) + rng.normal(0.0, accel_sd, (len(t), 3))
    flags = [detector.update(*sample) for sample in zip(t, w, f, strict=True)]
    return t, w, f, np.array(flags)


@pytest.mark.parametrize("rate", [10.0, 48.0, 200.0, 1000.0])
def test_rest_is_found_after_one_window_at_any_rate(rate):
    t, *_, flags = run(RestDetector(SETTINGS), 4.0, rate)
    found = t[np.argmax(flags)]
    assert flags[-1]
    assert SETTINGS.window <= found <= 1.3 * SETTINGS.window + 1.0 / rate


def test_means_and_spreads_are_those_of_the_window():
    detector = RestDetector(SETTINGS)
    _, w, f, _ = run(detector, 7.0, gyro=(0.01, -0.02, 0.005), accel=(0.3, -0.2, 9.79))
    np.testing.assert_allclose(detector.mean_rate, w[-200:].mean(axis=0), atol=1e-4)
    np.testing.assert_allclose(detector.mean_force, f[-200:].mean(axis=0), atol=3e-3)
    np.testing.assert_allclose(detector.rate_sd, w[-200:].std(axis=0), rtol=0.15)
    np.testing.assert_allclose(detector.force_sd, f[-200:].std(axis=0), rtol=0.15)


@pytest.mark.parametrize(
    ("unrest", "word"),
    [
        ({"gyro_sd": 0.05}, "rotation"),
        ({"accel_sd": 1.0}, "vibration"),
        ({"gyro": (0.0, 0.0, 0.2)}, "mean rotation"),
        ({"accel": (0.0, 0.0, 11.0)}, "gravity"),
    ],
)
def test_unrest_is_named(unrest, word):
    detector = RestDetector(SETTINGS)
    assert not run(detector, 5.0, **unrest)[-1].any()
    assert word in detector.why_not()


def test_motion_ends_rest_quickly_and_the_past_is_forgotten():
    detector = RestDetector(SETTINGS)
    run(detector, 5.0)
    t, *_, flags = run(detector, 3.0, start=5.0, gyro_sd=0.2)
    assert t[np.argmin(flags)] - 5.0 < 0.7
    assert run(detector, 5.0, start=8.0, gyro=(0.02, 0.0, 0.0))[-1][-1]
    np.testing.assert_allclose(detector.mean_rate, [0.02, 0.0, 0.0], atol=5e-4)


def test_a_gap_starts_a_new_window():
    detector = RestDetector(SETTINGS)
    run(detector, 5.0)
    assert not run(detector, 0.5, start=60.0)[-1][-1]
    assert not run(detector, 1.0, start=60.5)[-1][-1]


def test_samples_that_are_not_later_are_left_out():
    detector = RestDetector(SETTINGS)
    run(detector, 5.0)
    kept = detector.state.copy()
    detector.update(1.0, (9.0, 9.0, 9.0), (99.0, 0.0, 0.0))
    np.testing.assert_array_equal(detector.state, kept)


@given(st.floats(-50.0, 50.0), st.floats(-50.0, 50.0))
def test_a_large_offset_costs_no_digits(rate, force):
    """The spread is that of the samples, whatever they are offset by."""
    detector = RestDetector(SETTINGS)
    _, w, *_ = run(detector, 3.0, gyro=(rate, 0, 0), accel=(force, 0, 0), gyro_sd=1e-5, accel_sd=1e-4)
    assert detector.rate_sd[0] == pytest.approx(w[-200:, 0].std(), rel=0.15)
