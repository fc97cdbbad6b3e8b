"""The driving noise of the gyroscope bias is found from the filter's own corrections of a scalar bias per axis."""

import numpy as np
import pytest

from nav_pose_estimator.core.filter import bias_noise as bias_wander
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.constants import make_constants

PERIOD, MEASUREMENT_SD = 0.2, 5e-4  # s; rad/s: how well each epoch shows the bias
SET_SD, TAU = 4e-3, 3000.0  # the bias that is set: rad/s, s
SET_PSD = 2.0 * SET_SD**2 / TAU


def start() -> tuple[np.ndarray, np.ndarray]:
    """(nav, constants) of a filter that may learn."""
    constants = make_constants(
        gyro_noise=5e-4,
        accel_noise=0.02,
        gyro_bias_sd=SET_SD * np.sqrt(bias_wander.SMALLEST),
        gyro_bias_tau=TAU,
        accel_bias_sd=0.03,
        accel_bias_tau=300.0,
        covariance_period=0.02,
        gap_dt=0.06,
        gap_rate_sd=0.3,
        gap_accel_sd=2.0,
    )
    nav = np.zeros(at.NAV_SIZE)
    nav[at.QUAT] = 1.0
    bias_wander.begin(nav, constants)
    return nav, constants


def fly(psd: float, seconds: float, seed: int, measured_sd: float = MEASUREMENT_SD, skip=(1.0, 0.0)) -> np.ndarray:
    """A Kalman filter of three random walks of density ``psd``; returns ``nav``. No epochs between ``skip`` [s]."""
    rng = np.random.default_rng(seed)
    nav, constants = start()
    P, truth = np.eye(at.BASE_STATES) * MEASUREMENT_SD**2, np.zeros(3)
    for k in range(round(seconds / PERIOD)):
        nav[at.TIME] = (k + 1) * PERIOD
        truth += rng.normal(size=3) * np.sqrt(psd * PERIOD)
        believed = (constants[at.GYRO_BIAS_PSD] + nav[at.GYRO_WANDER]) * PERIOD
        for i in range(at.D_GYRO_BIAS, at.D_GYRO_BIAS + 3):
            P[i, i] += believed
        if skip[0] <= nav[at.TIME] < skip[1]:
            continue
        for i in range(3):
            variance = P[at.D_GYRO_BIAS + i, at.D_GYRO_BIAS + i]
            gain = variance / (variance + MEASUREMENT_SD**2)
            measured = truth[i] + rng.normal() * measured_sd
            nav[at.GYRO_BIAS + i] += gain * (measured - nav[at.GYRO_BIAS + i])
            P[at.D_GYRO_BIAS + i, at.D_GYRO_BIAS + i] = (1.0 - gain) * variance
        bias_wander.observe(nav, P)
    return nav


def learned(nav: np.ndarray) -> float:
    return float(nav[at.WANDER_FLOOR] + nav[at.GYRO_WANDER])


@pytest.mark.parametrize("part", [0.2, 1.0, 3.0])
def test_the_wander_of_the_bias_is_found(part):
    """GIVEN a bias that wanders less, as, or more than set WHEN it flies for 20 min THEN the density is found."""
    found = np.mean([np.log(learned(fly(part * SET_PSD, 1200.0, seed)) / SET_PSD) for seed in range(8)])
    assert found == pytest.approx(np.log(part), abs=0.5)


@pytest.mark.parametrize(("part", "bound"), [(1e-4, bias_wander.SMALLEST), (100.0, bias_wander.LARGEST)])
def test_the_bounds_hold(part, bound):
    """GIVEN a bias far outside the bounds WHEN it flies THEN the density stops at the bound."""
    assert learned(fly(part * SET_PSD, 1500.0, 1)) == pytest.approx(bound * SET_PSD)


def test_innovations_that_are_too_large_at_once_are_not_blamed_on_the_bias():
    """GIVEN measurements five times as noisy as stated WHEN it flies THEN the density is not driven to its bound."""
    found = [learned(fly(SET_PSD, 600.0, seed, measured_sd=5.0 * MEASUREMENT_SD)) for seed in range(6)]
    assert np.median(found) < 0.6 * bias_wander.LARGEST * SET_PSD


def test_an_overstated_measurement_noise_shows():
    """GIVEN measurements and a bias much better than stated WHEN it flies THEN the covariance is called too large."""
    good = fly(1e-4 * SET_PSD, 1200.0, 2, measured_sd=0.05 * MEASUREMENT_SD)
    assert bias_wander.overstatement(good) < 0.5
    honest = [bias_wander.overstatement(fly(SET_PSD, 600.0, seed)) for seed in range(8)]
    assert np.mean(honest) > 0.65


def test_windows_do_not_reach_across_an_outage():
    """GIVEN no observation for a minute WHEN GNSS is back THEN windows begin again: what drifted is not a wander."""
    before = learned(fly(SET_PSD, 100.0, 3))
    after = learned(fly(SET_PSD, 185.0, 3, skip=(100.1, 160.0)))
    assert after == before


def test_without_begin_nothing_is_learned():
    """GIVEN a filter that was not told to learn WHEN GNSS corrects it THEN its state stays as it is."""
    nav = np.zeros(at.NAV_SIZE)
    nav[at.TIME] = 100.0
    before = nav.copy()
    bias_wander.observe(nav, np.eye(at.BASE_STATES))
    np.testing.assert_array_equal(nav, before)
    assert bias_wander.overstatement(nav) == 1.0
