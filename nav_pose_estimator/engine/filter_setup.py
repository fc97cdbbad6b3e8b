"""From parameters to the numbers that the kernels work with."""

import numpy as np
from scipy.special import chdtri

from nav_pose_estimator.core import layout as at
from nav_pose_estimator.engine.parameters import Parameters


def constants(parameters: Parameters) -> np.ndarray:
    """The vector of filter constants, by name (``core.layout``)."""
    imu, navigator = parameters.imu, parameters.navigator
    c = np.zeros(at.CONSTANTS_SIZE)
    c[at.GYRO_NOISE_PSD] = imu.gyro_noise**2
    c[at.ACCEL_NOISE_PSD] = imu.accel_noise**2
    c[at.GYRO_BIAS_PSD] = 2.0 * imu.gyro_bias_sd**2 / imu.gyro_bias_tau
    c[at.GYRO_BIAS_RATE] = 1.0 / imu.gyro_bias_tau
    c[at.ACCEL_BIAS_PSD] = 2.0 * imu.accel_bias_sd**2 / imu.accel_bias_tau
    c[at.ACCEL_BIAS_RATE] = 1.0 / imu.accel_bias_tau
    c[at.COV_PERIOD] = navigator.covariance_period
    c[at.GAP_DT] = imu.gap
    c[at.GAP_RATE_SD] = navigator.gap_rate_sd
    c[at.GAP_ACCEL_SD] = navigator.gap_force_sd
    c[at.WIND_PSD] = navigator.wind_walk**2
    c[at.DRAG_PSD] = navigator.drag_walk**2
    c[at.GYRO_MATRIX_PSD] = 1e-12
    c[at.I_WIND_DRAG] = at.BASE_STATES if navigator.wind_drag_states else -1
    after_wind = at.BASE_STATES + at.WIND_DRAG_STATES * navigator.wind_drag_states
    c[at.I_GYRO_MATRIX] = after_wind if navigator.gyro_matrix_states else -1
    c[at.POINT_SAMPLED] = float(imu.sampling == "point")
    return c


def states(parameters: Parameters) -> int:
    """Length of the error state."""
    navigator = parameters.navigator
    extra = at.WIND_DRAG_STATES * navigator.wind_drag_states + at.GYRO_MATRIX_STATES * navigator.gyro_matrix_states
    return at.BASE_STATES + extra


def with_optional_blocks(P: np.ndarray, nav: np.ndarray, parameters: Parameters) -> np.ndarray:
    """``P`` (15, 15) of an alignment enlarged to the filter's states; sets the nominal drag in ``nav``."""
    navigator = parameters.navigator
    sd: list[float] = []
    if navigator.wind_drag_states:
        nav[at.DRAG : at.DRAG + 2] = navigator.drag
        sd += [navigator.wind_sd] * 2 + [navigator.drag_sd] * 2
    if navigator.gyro_matrix_states:
        sd += [navigator.gyro_matrix_sd] * at.GYRO_MATRIX_STATES
    full = np.zeros((at.BASE_STATES + len(sd),) * 2)
    full[: at.BASE_STATES, : at.BASE_STATES] = P
    full[range(at.BASE_STATES, len(full)), range(at.BASE_STATES, len(full))] = np.square(sd)
    return full


def gates(parameters: Parameters) -> list[tuple[float, float]]:
    """(soft, hard) chi-square thresholds for 1, 2 and 3 degrees of freedom."""
    navigator = parameters.navigator
    probabilities = navigator.gate_probability, navigator.reject_probability
    soft, hard = (chdtri((1, 2, 3), 1.0 - p) for p in probabilities)
    return list(zip(soft.tolist(), hard.tolist(), strict=True))
