"""The two attitude filters behind one face: how parameters become the constants in a filter's state vector."""

import numpy as np

from nav_pose_estimator.core import complementary
from nav_pose_estimator.core.attitude_layout import QUAT
from nav_pose_estimator.engine.parameters import Parameters


def complementary_state(parameters: Parameters) -> np.ndarray:
    """State vector of ``core.complementary`` that waits for its first sample."""
    p, imu, c = parameters.attitude, parameters.imu, complementary
    s = np.zeros(c.SIZE)
    s[QUAT], s[c.AGE], s[c.MAG_WEIGHT] = 1.0, -1.0, 1.0
    s[c.KP], s[c.TAU], s[c.GRAVITY] = p.kp, p.tau, p.gravity
    s[c.REJECT_FROM], s[c.REJECT_TO] = p.reject_from, max(p.reject_to, p.reject_from + 1e-3)
    s[c.REST_RATE_LIMIT], s[c.REST_FORCE_LIMIT], s[c.REST_AFTER] = p.rest_rate, p.rest_force, p.rest_after
    s[c.BIAS_LIMIT], s[c.BIAS_VAR] = p.max_bias, p.initial_bias_sd**2
    s[c.TAU_MAG], s[c.NORM_SD], s[c.DIP_SD] = p.mag_tau, p.mag_norm_sd, p.mag_dip_sd
    s[c.GYRO_PSD], s[c.BIAS_PSD] = imu.gyro_noise**2, 2.0 * imu.gyro_bias_sd**2 / imu.gyro_bias_tau
    s[c.ACCEL_SD] = p.accel_sd
    return s


MAKE_STATE = {"complementary": complementary_state}
KERNELS = {"complementary": complementary}
