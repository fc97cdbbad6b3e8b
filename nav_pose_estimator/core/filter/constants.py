"""The constants vector of the filter, made from named parameters."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.filter.blocks import Block, GaussMarkov, set_blocks, set_process
from nav_pose_estimator.core.filter.layout import (
    ACCEL_BIAS_PSD,
    ACCEL_BIAS_RATE,
    ACCEL_NOISE_PSD,
    CONSTANTS_SIZE,
    COV_PERIOD,
    GAP_ACCEL_SD,
    GAP_DT,
    GAP_RATE_SD,
    GNSS_DELAY_SD,
    GYRO_BIAS_PSD,
    GYRO_BIAS_RATE,
    GYRO_NOISE_PSD,
    POINT_SAMPLED,
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
    gnss_delay_sd: float = 0.0,
    blocks: Mapping[Block, GaussMarkov] | None = None,
) -> Array:
    """The constants vector of ``core.filter.layout`` (CONSTANTS_SIZE,).

    ``gyro_noise`` [rad/s/sqrt(Hz)] and ``accel_noise`` [m/s^2/sqrt(Hz)] are noise densities. ``_sd`` and ``_tau`` [s]
    of the biases are steady-state standard deviation and correlation time of a Gauss-Markov process. An IMU interval
    longer than ``gap_dt`` [s] is a gap, in which rate [rad/s] and force [m/s^2] are unknown with ``gap_..._sd``.
    ``gnss_delay_sd`` [s]: deviation of the latency of GNSS from the one that is compensated.
    ``blocks``: the optional blocks of the filter and their processes.
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
    constants[GNSS_DELAY_SD] = gnss_delay_sd
    blocks = blocks or {}
    set_blocks(constants, blocks)
    for block, process in blocks.items():
        set_process(constants, block, process)
    return constants
