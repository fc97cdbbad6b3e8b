"""Does the filter know how wrong it is? Fifty flights with errors drawn from its own model (NEES and NIS)."""

import numpy as np
import pytest
from exact_motion import Motion, survey, times_of
from scipy.stats import chi2

from filter_start import initial_covariance
from imu_run import run_imu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.blocks import GYRO_MATRIX, GaussMarkov, state_count
from nav_pose_estimator.core.filter.constants import make_constants
from nav_pose_estimator.core.filter.kalman import correct
from nav_pose_estimator.core.filter.measurements import gnss_position, gnss_velocity
from nav_pose_estimator.core.filter.strapdown import flush_covariance
from nav_pose_estimator.core.numerics.jit import COMPILED
from nav_pose_estimator.core.numerics.rotation import quat_from_rotvec, quat_multiply

RUNS = 50 if COMPILED else 4
DURATION = 60.0 if COMPILED else 15.0
RATE = 100.0 if COMPILED else 50.0
LEVER = np.array([0.2, -0.1, 0.3])
POSITION_SD = np.array([1.0, 1.0, 2.0])
VELOCITY_SD = 0.1


def constants(gyro_matrix_states: bool) -> np.ndarray:
    """Biases are random walks: the correlation time is without end in practice."""
    return make_constants(
        gyro_noise=5e-4,
        accel_noise=5e-3,
        gyro_bias_sd=1.0,
        gyro_bias_tau=1e9,
        accel_bias_sd=30.0,
        accel_bias_tau=1e9,
        covariance_period=0.04,
        gap_dt=1.0,
        gap_rate_sd=0.0,
        gap_accel_sd=0.0,
        blocks={GYRO_MATRIX: GaussMarkov()} if gyro_matrix_states else None,
    )


def start_covariance(numbers: np.ndarray) -> np.ndarray:
    return initial_covariance(
        numbers,
        misalignment_sd=(0.01, 0.01, 0.03),
        velocity_sd=0.2,
        position_sd=(1.0, 1.0, 2.0),
        gyro_bias_sd=2e-3,
        accel_bias_sd=0.03,
        block_sd={GYRO_MATRIX: 0.003},
    )


class Flight:
    """One flight: the truth with its sensor errors, and the filter."""

    def __init__(self, motion: Motion, rows: np.ndarray, numbers: np.ndarray, rng: np.random.Generator) -> None:
        self.motion, self.numbers, self.rng = motion, numbers, rng
        n = state_count(numbers)
        self.P = start_covariance(numbers)
        start_error = rng.normal(size=n) * np.sqrt(np.diag(self.P))
        self.nav = motion.nav(0.0)
        self.nav[at.QUAT : at.QUAT + 4] = quat_multiply(
            quat_from_rotvec(-start_error[:3]), self.nav[at.QUAT : at.QUAT + 4]
        )
        self.nav[at.VEL : at.VEL + 3] += start_error[at.DVEL : at.DVEL + 3]
        per_metre = -motion.error_of(_shifted(self.nav))[at.DPOS : at.DPOS + 2]
        self.nav[at.LON] += start_error[at.DPOS] / per_metre[0]
        self.nav[at.LAT] += start_error[at.DPOS + 1] / per_metre[1]
        self.nav[at.ALT] += start_error[at.DPOS + 2]
        self.missing = start_error[at.D_GYRO_BIAS :]
        self.rows = self._measured(rows)

    def _measured(self, rows: np.ndarray) -> np.ndarray:
        c, dt, count = self.numbers, np.diff(rows[:2, 0])[0], len(rows)
        self.gyro_bias, self.accel_bias = (
            bias + np.cumsum(self.rng.normal(size=(count, 3)) * np.sqrt(c[psd] * dt), axis=0)
            for bias, psd in ((self.missing[:3], at.GYRO_BIAS_PSD), (self.missing[3:6], at.ACCEL_BIAS_PSD))
        )
        matrix = self.missing[6:].reshape(3, 3) if len(self.missing) > 6 else np.zeros((3, 3))
        self.matrix = self.missing[6:]
        rows = rows.copy()
        rows[:, 1:4] += rows[:, 1:4] @ matrix.T + self.gyro_bias
        rows[:, 4:] += self.accel_bias
        rows[:, 1:4] += self.rng.normal(size=(count, 3)) * np.sqrt(c[at.GYRO_NOISE_PSD] / dt)
        rows[:, 4:] += self.rng.normal(size=(count, 3)) * np.sqrt(c[at.ACCEL_NOISE_PSD] / dt)
        return rows

    def second(self, begin: int, end: int, antenna, velocity) -> tuple[float, float]:
        """Fly over rows begin to end, take a fix in; returns (NEES after it, mean NIS of position and velocity)."""
        run_imu(self.nav, self.P, self.numbers, self.rows[begin:end], np.empty((end - begin, at.OUT_COLUMNS)))
        flush_covariance(self.nav, self.P, self.numbers)
        n = len(self.P)
        lat, lon, alt = antenna(self.rng.normal(size=3) * POSITION_SD)
        z, H = gnss_position(self.nav, n, lat, lon, alt, LEVER)
        nis = correct(self.nav, self.P, self.numbers, z, H, np.diag(POSITION_SD**2))
        z, H = gnss_velocity(self.nav, n, velocity + self.rng.normal(size=3) * VELOCITY_SD, LEVER)
        nis += correct(self.nav, self.P, self.numbers, z, H, np.eye(3) * VELOCITY_SD**2)
        return self._nees(end - 1), nis

    def _nees(self, i: int) -> float:
        error = np.concatenate(
            (
                self.motion.error_of(self.nav),
                self.gyro_bias[i] - self.nav[at.GYRO_BIAS : at.GYRO_BIAS + 3],
                self.accel_bias[i] - self.nav[at.ACCEL_BIAS : at.ACCEL_BIAS + 3],
                self.matrix - self.nav[at.GYRO_MATRIX : at.GYRO_MATRIX + len(self.matrix)],
            )
        )
        return float(error @ np.linalg.solve(self.P, error))


def _shifted(nav: np.ndarray) -> np.ndarray:
    """``nav`` one radian less East and North: its error gives the metres per radian."""
    nav = nav.copy()
    nav[at.LAT] -= 1.0
    nav[at.LON] -= 1.0
    return nav


def truth_at_antenna(motion: Motion, t: float):
    """(function from noise to a measured antenna position, antenna velocity): the observation inverted exactly."""
    nav = motion.nav(t)
    z, _ = gnss_position(nav, at.BASE_STATES, nav[at.LAT], nav[at.LON], nav[at.ALT], LEVER)
    metres = -motion.error_of(_shifted(nav))[at.DPOS : at.DPOS + 2]
    swing, _ = gnss_velocity(nav, at.BASE_STATES, nav[at.VEL : at.VEL + 3], LEVER)

    def antenna(noise):
        east, north, up = z + noise
        return nav[at.LAT] + north / metres[1], nav[at.LON] + east / metres[0], nav[at.ALT] + up

    return antenna, nav[at.VEL : at.VEL + 3] + swing


@pytest.mark.parametrize("gyro_matrix_states", [False, True])
def test_errors_are_as_large_as_the_filter_says(gyro_matrix_states):
    numbers, motion = constants(gyro_matrix_states), survey()
    rows = motion.imu_rows(times_of(DURATION, RATE))
    flights = [Flight(motion, rows, numbers, np.random.default_rng(1000 + i)) for i in range(RUNS)]
    step, n = round(RATE), state_count(numbers)
    nees, nis = [], []
    for k in range(round(DURATION)):
        antenna, velocity = truth_at_antenna(motion, float(k + 1))
        values = [flight.second(k * step, (k + 1) * step, antenna, velocity) for flight in flights]
        nees.append(np.mean([value[0] for value in values]))
        nis.append(np.mean([value[1] for value in values]))
    for means, dof in ((nees, n), (nis, 6)):
        low, high = chi2.ppf((0.025, 0.975), dof * RUNS) / RUNS
        inside = np.mean([low < value < high for value in means])
        assert inside > 0.85, (dof, inside, low, high, np.mean(means))
        # innovations of one flight are independent of each other: their mean over the flight has a tighter band
        assert low < np.mean(means) < high
    low, high = chi2.ppf((0.0005, 0.9995), 6 * RUNS * len(nis)) / (RUNS * len(nis))
    assert low < np.mean(nis) < high
