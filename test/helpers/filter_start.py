"""A diagonal covariance for a filter that starts without an alignment."""

import numpy as np
from numpy.typing import ArrayLike

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.constants import state_count


def initial_covariance(
    constants: np.ndarray,
    *,
    misalignment_sd: ArrayLike,
    velocity_sd: ArrayLike,
    position_sd: ArrayLike,
    gyro_bias_sd: ArrayLike,
    accel_bias_sd: ArrayLike,
    wind_sd: float = 0.0,
    gyro_matrix_sd: float = 0.0,
) -> np.ndarray:
    """P (n, n) from deviations in SI units, one number or three, one per axis: East, North, Up or x, y, z."""
    sd = np.zeros(state_count(constants))
    for start, value in (
        (at.PHI, misalignment_sd),
        (at.DVEL, velocity_sd),
        (at.DPOS, position_sd),
        (at.D_GYRO_BIAS, gyro_bias_sd),
        (at.D_ACCEL_BIAS, accel_bias_sd),
    ):
        sd[start : start + 3] = value
    wind, matrix = int(constants[at.I_WIND]), int(constants[at.I_GYRO_MATRIX])
    if wind >= 0:
        sd[wind : wind + at.WIND_STATES] = wind_sd
    if matrix >= 0:
        sd[matrix : matrix + at.GYRO_MATRIX_STATES] = gyro_matrix_sd
    return np.diag(sd**2)
