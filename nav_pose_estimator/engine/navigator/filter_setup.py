"""Set-up of the filter from the parameters: constants, first state and gates."""

import math

import numpy as np
from numpy.typing import ArrayLike

from nav_pose_estimator.core.alignment.types import Alignment
from nav_pose_estimator.core.filter import bias_noise
from nav_pose_estimator.core.filter.blocks import (
    GNSS_ERROR,
    GRAVITY,
    GYRO_MATRIX,
    Block,
    GaussMarkov,
    enlarged,
    set_blocks,
)
from nav_pose_estimator.core.filter.constants import make_constants
from nav_pose_estimator.core.filter.gate import chi_square_quantile
from nav_pose_estimator.core.filter.layout import DPOS
from nav_pose_estimator.core.filter.noise_identification import NoiseIdentification
from nav_pose_estimator.engine.imu.latency_monitor import LatencyMonitor
from nav_pose_estimator.engine.parameters import GnssParameters, Parameters
from nav_pose_estimator.engine.sensors.gnss import lasting_error

MOST_ROWS = 8
"""Largest dimension of an observation."""


def constants(
    parameters: Parameters,
    identified: NoiseIdentification,
    vibration: tuple[float, float] = (0.0, 0.0),
    lasting: lasting_error.LastingPosition | None = None,
    latency: LatencyMonitor | None = None,
) -> np.ndarray:
    """The vector of filter constants (``core.filter.layout``).

    ``identified``: noise identified in flight; ``vibration`` [rad/s/sqrt(Hz), m/s^2/sqrt(Hz)]: additional noise of
    gyroscope and accelerometer; ``lasting``: the correlated part of the position errors that the receiver states;
    ``latency``: what motion has shown of the latency of GNSS. The driving noise of the gyroscope bias is the smallest
    one if it is learned in flight, where ``bias_noise`` adds to it.
    """
    noise = math.sqrt(identified.imu_variance)
    imu, navigator = parameters.imu, parameters.navigator
    smallest = math.sqrt(bias_noise.SMALLEST) if imu.learn_gyro_bias_sd else 1.0
    return make_constants(
        gyro_noise=math.hypot(noise * imu.gyro_noise, vibration[0]),
        accel_noise=math.hypot(noise * imu.accel_noise, vibration[1]),
        gyro_bias_sd=smallest * imu.gyro_bias_sd,
        gyro_bias_tau=imu.gyro_bias_tau,
        accel_bias_sd=noise * imu.accel_bias_sd,
        accel_bias_tau=imu.accel_bias_tau,
        covariance_period=navigator.covariance_period,
        gap_dt=imu.gap,
        gap_rate_sd=navigator.gap_rate_sd,
        gap_accel_sd=navigator.gap_force_sd,
        point_sampled=imu.sampling == "point",
        gnss_delay_sd=_delay_sd(parameters.gnss, latency or LatencyMonitor()),
        blocks=_blocks(parameters, identified, lasting),
    )


def complete_start(start: Alignment, constants: np.ndarray, parameters: Parameters) -> tuple[np.ndarray, np.ndarray]:
    """(nav, P) of an alignment: ``nav`` with the bias identification started, ``P`` enlarged to the filter's states."""
    nav = start.nav.copy()
    if parameters.imu.learn_gyro_bias_sd:
        bias_noise.begin(nav, constants)
    base = constants.copy()
    set_blocks(base, ())
    navigator = parameters.navigator
    errors = lasting_error.first_cov(parameters.gnss)
    first: dict[Block, ArrayLike] = {
        GYRO_MATRIX: navigator.gyro_matrix_sd**2,
        GRAVITY: navigator.gravity_sd**2,
        GNSS_ERROR: errors,
    }
    P = enlarged(start.P, base, constants, first)
    if GNSS_ERROR.is_in(constants):  # the position is that of a fix: the correlated error of the fix is in it
        begin = GNSS_ERROR.states(constants).start
        for i in range(3):
            P[DPOS + i, DPOS + i] += errors[i, i]
            P[DPOS + i, begin + i] = P[begin + i, DPOS + i] = errors[i, i]
    return nav, P


def _delay_sd(gnss: GnssParameters, latency: LatencyMonitor) -> float:
    """Deviation of the latency of GNSS [s]; a latency that has been measured counts as known."""
    return latency.rms(gnss.delay_sd) if gnss.delay == 0.0 else 0.0


def _blocks(
    parameters: Parameters, identified: NoiseIdentification, lasting: lasting_error.LastingPosition | None
) -> dict[Block, GaussMarkov]:
    """Optional blocks that the filter has from the start; the gravity disturbance is constant."""
    chosen = (
        (parameters.navigator.gyro_matrix_states, GYRO_MATRIX, 1e-6),
        (parameters.navigator.gravity_states, GRAVITY, 0.0),
    )
    blocks = {block: GaussMarkov(walk=walk) for is_there, block, walk in chosen if is_there}
    if parameters.gnss.error_states:
        variance = (lasting or lasting_error.LastingPosition(parameters.gnss)).variance
        blocks[GNSS_ERROR] = lasting_error.process(parameters.gnss, variance, identified)
    return blocks


def gates(parameters: Parameters) -> list[tuple[float, float]]:
    """(soft, hard) thresholds of the NIS for observations of 1, 2 ... ``MOST_ROWS`` rows."""
    navigator = parameters.navigator
    soft, hard = navigator.gate_probability, navigator.reject_probability
    return [(chi_square_quantile(soft, rows), chi_square_quantile(hard, rows)) for rows in range(1, MOST_ROWS + 1)]
