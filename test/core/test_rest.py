"""The rest detector: what counts as rest, its means, its cost in memory."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nav_pose_estimator.core.alignment.rest import RestDetector, RestSettings, Stillness

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


def still(spoil=None, seconds=3, rate=100, noise=(1e-3, 0.02), seed=1):
    """What ``Stillness`` says after each second of noise around a small bias; ``spoil(t, rows)`` adds to the rows."""
    rng = np.random.default_rng(seed)
    proof, said = Stillness(), []
    for second in range(seconds):
        t = second + np.arange(rate) / rate
        rate_noise, force_noise = (rng.normal(0.0, sd, (rate, 3)) for sd in noise)
        rows = np.column_stack([t, np.array([0.004, 0.0, -0.002]) + rate_noise, LEVEL + force_noise])
        if spoil is not None:
            spoil(t, rows)
        said.append(proof.add(rows))
    return said


@pytest.mark.parametrize("rate", [20, 50, 200, 1000])
def test_three_still_seconds_are_proof_and_give_the_rate(rate):
    first, second, third = still(rate=rate)
    assert first is None
    assert second is None
    np.testing.assert_allclose(third, [0.004, 0.0, -0.002], atol=5e-4)


def add(column, wave):
    def spoil(t, rows):
        rows[:, column] += wave(t)

    return spoil


@pytest.mark.parametrize(
    "spoil",
    [
        add(1, lambda t: 0.03 * np.sin(2.0 * np.pi * 23.0 * t)),  # an idling motor
        add(6, lambda t: 0.6 * np.sin(2.0 * np.pi * 31.0 * t)),
        add(2, lambda t: 0.006 * np.sin(2.0 * np.pi * 0.4 * t)),  # a hover that sways
        add(4, lambda t: 0.1 * np.sin(2.0 * np.pi * 0.3 * t)),
    ],
    ids=["shaken", "rattled", "swaying", "pushed"],
)
def test_what_shakes_or_sways_is_not_still(spoil):
    assert still()[-1] is not None
    assert still(spoil, seconds=8) == [None] * 8


def test_a_stuck_sensor_proves_nothing():
    assert still(noise=(0.0, 0.02), seconds=5) == [None] * 5
    assert still(noise=(1e-3, 0.0), seconds=5) == [None] * 5


def test_a_second_with_holes_begins_the_proof_anew():
    proof = Stillness()
    rng = np.random.default_rng(2)

    def second(start, length):
        t = start + np.arange(0.0, length, 0.01)
        noise = rng.normal(0.0, 1e-3, (len(t), 6))
        return np.column_stack([t, noise + np.array([0.0, 0.0, 0.0, *LEVEL])])

    lengths = (1.0, 1.0, 0.6, 1.0, 1.0, 1.0)
    said = [proof.add(second(float(k), length)) is not None for k, length in enumerate(lengths)]
    assert said == [False, False, False, False, False, True]


def test_a_known_offset_tells_a_turn_from_a_bias():
    offset = RestSettings(window=2.0, gyro_sd=0.02, accel_sd=0.35, rate=0.03, force=0.8, offset=(0.1, 0.0, 0.0))
    assert run(RestDetector(offset), 4.0, gyro=(0.1, 0.0, 0.0))[-1][-1]
    assert not run(RestDetector(offset), 4.0, gyro=(0.1, 0.0, 0.1))[-1].any()
