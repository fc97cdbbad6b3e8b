"""The attitude filters behind one interface: from parameters to the initial state vector of a filter."""

import math

import numpy as np

from nav_pose_estimator.core.attitude import complementary, two_stage
from nav_pose_estimator.core.attitude import layout as at
from nav_pose_estimator.engine.parameters import Parameters

_FIXED = {
    at.MOTION_RISE: 2.0,
    at.MOTION_FALL: 10.0,
    at.STILL_PSD: 1e-3,
    at.LEVEL_AFTER: 0.3,
    at.LEARN_PSD: 3e-7,
    at.ANOMALY_TAU: 0.3,
    at.NEW_TAU: 3.0,
    at.NEW_LIMIT: 0.05,
    at.NEW_HEADING_VAR: 0.5,
    at.MAG_DELAY_VAR: 0.02**2,
    at.AGE: -1.0,
    at.QUAT: 1.0,
    at.FIELD_TRUST: 1.0,
    at.TRUST: 1.0,
}
"""Constants that no user has a reason to change, and the state before the first sample."""


def _fill_shared(s: np.ndarray, parameters: Parameters) -> None:
    p, imu, navigator = parameters.attitude, parameters.imu, parameters.navigator
    values = _FIXED | {
        at.PERIOD: p.feedback_period,
        at.GRAVITY: p.gravity,
        at.POINT: float(imu.sampling == "point"),
        at.GAP_DT: imu.gap,
        at.GAP_RATE_SD: navigator.gap_rate_sd,
        at.WANDER_PSD: p.wander**2,
        at.BIAS_PSD: p.bias_walk**2,
        at.TURN_PSD: p.turn_noise**2,
        at.MATRIX_PSD: p.matrix_walk**2,
        at.SWAY_PSD: p.sway_noise**2,
        at.MOTION_FLOOR: p.motion_floor**2,
        at.MOTION_TAU: p.motion_tau,
        at.STILL_RATE: p.still_rate,
        at.STILL_FORCE: p.still_force,
        at.STILL_NORM: p.still_norm,
        at.LEARN_AFTER: p.learn_after,
        at.BIAS_LIMIT: p.max_bias,
        at.REJECT_FROM: p.reject_from,
        at.REJECT_TO: max(p.reject_to, p.reject_from + 1e-3),
        at.TIMING_SD: p.timing_sd,
        at.SWAY_TILT: p.sway_tilt,
        at.DECLINATION: parameters.aids.declination,
        at.HEADING_PSD: p.heading_noise**2,
        at.PLACE_VAR: p.compass_deviation**2,
        at.ANOMALY_GAIN: p.anomaly_gain,
        at.FIELD_TAU: p.field_tau,
        at.NEW_AFTER: p.new_field_after,
    }
    for slot, value in values.items():
        s[slot] = value


def complementary_state(parameters: Parameters) -> np.ndarray:
    """State vector of ``core.attitude.complementary`` before its first sample."""
    p, c = parameters.attitude, complementary
    s = np.zeros(c.SIZE)
    _fill_shared(s, parameters)
    s[c.TILT_VAR], s[c.HEADING_VAR], s[c.SWAY_START_VAR] = p.initial_tilt_sd**2, math.pi**2 / 3.0, 0.01
    P = s[c.COVARIANCE : c.GAIN].reshape(c.STATES, c.STATES)
    for i in range(3):
        P[c.D_BIAS + i, c.D_BIAS + i] = p.initial_bias_sd**2
        for j in range(3):
            k = c.D_MATRIX + 3 * i + j
            P[k, k] = (p.scale_sd if i == j else p.misalignment_sd) ** 2
    return s


def two_stage_state(parameters: Parameters) -> np.ndarray:
    """State vector of ``core.attitude.two_stage`` before its first sample."""
    p, t, c = parameters.attitude.two_stage, two_stage, parameters.attitude
    s = np.zeros(t.SIZE)
    _fill_shared(s, parameters)
    s[at.WANDER_PSD], s[at.HEADING_PSD] = p.wander**2, p.heading_noise**2
    s[t.TILT_VAR], s[t.HEADING_VAR] = c.initial_tilt_sd**2, math.pi**2 / 3.0
    s[t.R1_START], s[t.SHARED], s[t.LITERAL] = p.force_sd**2, p.shared_windows, float(p.correction == "literal")
    s[t.BIAS_VAR] = c.initial_bias_sd**2
    s[t.REGULATOR_P], s[t.REGULATOR_I], s[t.REGULATOR_BAND] = p.regulator_p, p.regulator_i, p.regulator_band
    s[t.BIAS_TAU_START], s[t.BIAS_TAU] = p.bias_tau_start, p.bias_tau
    return s


MAKE_STATE = {"complementary": complementary_state, "two_stage": two_stage_state}
KERNELS = {"complementary": complementary, "two_stage": two_stage}
