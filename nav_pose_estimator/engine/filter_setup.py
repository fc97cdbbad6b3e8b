"""From parameters to the numbers that the kernels work with."""

import math

import numpy as np
from scipy.special import chdtri

from nav_pose_estimator.core import bias_wander
from nav_pose_estimator.core import layout as at
from nav_pose_estimator.core.alignment_types import Alignment
from nav_pose_estimator.core.filter_setup import make_constants
from nav_pose_estimator.engine.parameters import Parameters


def constants(parameters: Parameters) -> np.ndarray:
    """The vector of filter constants (``core.layout``)."""
    imu, navigator = parameters.imu, parameters.navigator
    smallest = math.sqrt(bias_wander.SMALLEST) if imu.learn_gyro_bias_sd else 1.0
    return make_constants(
        gyro_noise=imu.gyro_noise,
        accel_noise=imu.accel_noise,
        gyro_bias_sd=smallest * imu.gyro_bias_sd,
        gyro_bias_tau=imu.gyro_bias_tau,
        accel_bias_sd=imu.accel_bias_sd,
        accel_bias_tau=imu.accel_bias_tau,
        covariance_period=navigator.covariance_period,
        gap_dt=imu.gap,
        gap_rate_sd=navigator.gap_rate_sd,
        gap_accel_sd=navigator.gap_force_sd,
        point_sampled=imu.sampling == "point",
        gyro_matrix_states=navigator.gyro_matrix_states,
        gyro_matrix_walk=1e-6,
    )


def states(parameters: Parameters) -> int:
    """Length of the error state."""
    return at.BASE_STATES + at.GYRO_MATRIX_STATES * parameters.navigator.gyro_matrix_states


def complete_start(start: Alignment, constants: np.ndarray, parameters: Parameters) -> tuple[np.ndarray, np.ndarray]:
    """(nav, P) of an alignment: ``nav`` set to learn what it may, ``P`` enlarged to the filter's states."""
    nav = start.nav.copy()
    if parameters.imu.learn_gyro_bias_sd:
        bias_wander.begin(nav, constants)
    full = np.diag(np.full(states(parameters), parameters.navigator.gyro_matrix_sd**2))
    full[: at.BASE_STATES, : at.BASE_STATES] = start.P
    return nav, full


def gates(parameters: Parameters) -> list[tuple[float, float]]:
    """(soft, hard) chi-square thresholds for 1, 2 and 3 degrees of freedom."""
    navigator = parameters.navigator
    probabilities = navigator.gate_probability, navigator.reject_probability
    soft, hard = (chdtri((1, 2, 3), 1.0 - p) for p in probabilities)
    return list(zip(soft.tolist(), hard.tolist(), strict=True))
