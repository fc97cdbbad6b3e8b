"""From parameters to the numbers that the kernels work with."""

import math

import numpy as np

from nav_pose_estimator.core.alignment.types import Alignment
from nav_pose_estimator.core.filter import bias_noise
from nav_pose_estimator.core.filter.blocks import GYRO_MATRIX, Wander, enlarged, set_blocks
from nav_pose_estimator.core.filter.constants import make_constants
from nav_pose_estimator.engine.parameters import Parameters


def constants(parameters: Parameters) -> np.ndarray:
    """The vector of filter constants (``core.filter.layout``)."""
    imu, navigator = parameters.imu, parameters.navigator
    smallest = math.sqrt(bias_noise.SMALLEST) if imu.learn_gyro_bias_sd else 1.0
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
        blocks={GYRO_MATRIX: Wander(walk=1e-6)} if navigator.gyro_matrix_states else None,
    )


def complete_start(start: Alignment, constants: np.ndarray, parameters: Parameters) -> tuple[np.ndarray, np.ndarray]:
    """(nav, P) of an alignment: ``nav`` set to learn what it may, ``P`` enlarged to the filter's states."""
    nav = start.nav.copy()
    if parameters.imu.learn_gyro_bias_sd:
        bias_noise.begin(nav, constants)
    base = constants.copy()
    set_blocks(base, ())
    return nav, enlarged(start.P, base, constants, {GYRO_MATRIX: parameters.navigator.gyro_matrix_sd**2})


def gates(parameters: Parameters) -> list[tuple[float, float]]:
    """(soft, hard) chi-square thresholds for 1, 2 and 3 degrees of freedom."""
    navigator = parameters.navigator
    soft, hard = navigator.gate_probability, navigator.reject_probability
    return [(chi_square_quantile(soft, dof), chi_square_quantile(hard, dof)) for dof in (1, 2, 3)]


def chi_square_quantile(probability: float, dof: int) -> float:
    """The value that a chi-square variable of 1, 2 or 3 degrees of freedom exceeds with 1 - ``probability``.

    By bisection of the closed forms of the tail (Abramowitz and Stegun, 26.4.4 and 26.4.5): a few lines instead of a
    quarter of a second to load scipy.special.
    """
    tail, low, high = 1.0 - probability, 0.0, 2000.0
    while True:
        middle = 0.5 * (low + high)
        if not low < middle < high:
            return middle
        if _chi_square_tail(middle, dof) > tail:
            low = middle
        else:
            high = middle


def _chi_square_tail(x: float, dof: int) -> float:
    if dof == 2:
        return math.exp(-0.5 * x)
    tail = math.erfc(math.sqrt(0.5 * x))
    return tail if dof == 1 else tail + math.sqrt(2.0 * x / math.pi) * math.exp(-0.5 * x)
