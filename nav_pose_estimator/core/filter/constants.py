"""The constants vector of the filter, from plain numbers by name."""

import math

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.filter.layout import (
    ACCEL_BIAS_PSD,
    ACCEL_BIAS_RATE,
    ACCEL_NOISE_PSD,
    BASE_STATES,
    CONSTANTS_SIZE,
    COV_PERIOD,
    GAP_ACCEL_SD,
    GAP_DT,
    GAP_RATE_SD,
    GYRO_BIAS_PSD,
    GYRO_BIAS_RATE,
    GYRO_MATRIX_PSD,
    GYRO_MATRIX_STATES,
    GYRO_NOISE_PSD,
    I_GYRO_MATRIX,
    I_WIND,
    POINT_SAMPLED,
    WIND_PSD,
    WIND_RATE,
    WIND_STATES,
)

Array = NDArray[np.float64]


def make_constants(
    *,
    gyro_noise: float,
    accel_noise: float,
    gyro_bias_sd: float,
    gyro_bias_tau: float,
    accel_bias_sd: float,
    accel_bias_tau: float,
    covariance_period: float,
    gap_dt: float,
    gap_rate_sd: float,
    gap_accel_sd: float,
    point_sampled: bool = False,
    wind_states: bool = False,
    wind_walk: float = 0.0,
    wind_tau: float = math.inf,
    gyro_matrix_states: bool = False,
    gyro_matrix_walk: float = 0.0,
) -> Array:
    """The constants vector of ``core.filter.layout`` (CONSTANTS_SIZE,).

    ``gyro_noise`` [rad/s/sqrt(Hz)] and ``accel_noise`` [m/s^2/sqrt(Hz)] are densities; ``_sd`` and ``_tau`` [s] of the
    biases their steady-state deviation and correlation time; ``_walk`` random walks per root second. A gap is an IMU
    interval longer than ``gap_dt`` [s]; during it rate [rad/s] and force [m/s^2] are unknown with ``gap_..._sd``.
    """
    constants = np.zeros(CONSTANTS_SIZE)
    constants[GYRO_NOISE_PSD] = gyro_noise**2
    constants[ACCEL_NOISE_PSD] = accel_noise**2
    constants[GYRO_BIAS_PSD] = 2.0 * gyro_bias_sd**2 / gyro_bias_tau
    constants[GYRO_BIAS_RATE] = 1.0 / gyro_bias_tau
    constants[ACCEL_BIAS_PSD] = 2.0 * accel_bias_sd**2 / accel_bias_tau
    constants[ACCEL_BIAS_RATE] = 1.0 / accel_bias_tau
    constants[COV_PERIOD] = covariance_period
    constants[GAP_DT] = gap_dt
    constants[GAP_RATE_SD] = gap_rate_sd
    constants[GAP_ACCEL_SD] = gap_accel_sd
    constants[POINT_SAMPLED] = float(point_sampled)
    constants[WIND_PSD] = wind_walk**2
    constants[WIND_RATE] = 1.0 / wind_tau
    constants[GYRO_MATRIX_PSD] = gyro_matrix_walk**2
    constants[I_WIND] = BASE_STATES if wind_states else -1
    after_wind = BASE_STATES + WIND_STATES * bool(wind_states)
    constants[I_GYRO_MATRIX] = after_wind if gyro_matrix_states else -1
    return constants


def state_count(constants: Array) -> int:
    """Size n of the error state that ``constants`` describe."""
    wind, gyro_matrix = constants[I_WIND] >= 0.0, constants[I_GYRO_MATRIX] >= 0.0
    return BASE_STATES + WIND_STATES * int(wind) + GYRO_MATRIX_STATES * int(gyro_matrix)
