"""Every observation matrix against central differences of the observation itself."""

import numpy as np
import pytest

from beamed import beam_directions
from filter_start import plain_constants
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import measurements
from nav_pose_estimator.core.filter.blocks import DEPTH, DVL, DVL_DELAY, WIND, state_count
from nav_pose_estimator.core.filter.error_state import inject
from nav_pose_estimator.core.numerics.rotation import quat_from_euler, quat_from_rotvec, quat_to_matrix

CONSTANTS = plain_constants([WIND, DVL, DEPTH, DVL_DELAY])
N = state_count(CONSTANTS)
WIND_STATES = WIND.states(CONSTANTS).start
BEAM_STATES = DVL.states(CONSTANTS).start, DVL_DELAY.states(CONSTANTS).start
CHANGE = np.array([1.5, -0.7, 0.3])  # m/s^2
LEVER = np.array([0.3, -0.2, 0.5])
AIR = np.array([3.0, -6.0, 1.0])


def state() -> np.ndarray:
    """A moving, tilted, turning vehicle with biases and wind."""
    nav = np.zeros(at.NAV_SIZE)
    nav[at.LAT : at.VEL] = 0.8, 0.2, 300.0
    nav[at.VEL : at.VEL + 3] = 4.0, -7.0, 1.5
    nav[at.QUAT : at.QUAT + 4] = quat_from_euler(0.2, -0.1, 2.0)
    nav[at.WIND : at.WIND + 2] = 1.0, -2.0
    nav[DVL.estimates] = 0.02, -0.01, 0.03, 0.0, 0.01, 0.02, -0.01, 0.02
    nav[at.DVL_DELAY] = 0.1
    nav[at.PREV_RATE : at.PREV_RATE + 3] = 0.4, -0.3, 0.9
    nav[at.PREV_FORCE : at.PREV_FORCE + 3] = -0.7, 0.4, 9.9
    return nav


CASES = {
    "zero_velocity": (measurements.zero_velocity, ()),
    "gnss_position": (measurements.gnss_position, (0.80001, 0.20002, 290.0, LEVER)),
    "gnss_velocity": (measurements.gnss_velocity, (np.array([3.0, -6.0, 1.0]), LEVER)),
    "horizontal_velocity": (measurements.horizontal_velocity, (3.0, -6.0)),
    "height": (measurements.height, (290.0,)),
    "height_in_water": (measurements.height_in_water, (DEPTH.states(CONSTANTS).start, -12.0)),
    "body_velocity": (measurements.body_velocity, (np.array([3.0, -6.0, 1.0]), LEVER)),
}


def mean_air_velocity(nav, states, air):
    """The observation of an interval in which nothing changed: the means are the state itself."""
    attitude = measurements.quat_to_matrix(nav[at.QUAT : at.QUAT + 4])
    velocity = nav[at.VEL : at.VEL + 3].copy()
    return measurements.mean_air_velocity(nav, states, WIND_STATES, attitude, velocity, attitude.T @ velocity, air)


CASES["mean_air_velocity"] = (mean_air_velocity, (AIR,))


def beam_velocities(nav, states, measured, lever, has_biases):
    directions = beam_directions()
    return measurements.beam_velocities(nav, states, BEAM_STATES, directions, measured, lever, CHANGE, has_biases)


CASES["beams"] = (beam_velocities, (np.array([1.0, -2.0, 0.5, 3.0]), LEVER, True))
CASES["points"] = (beam_velocities, (np.array([1.0, -2.0, 0.5, 3.0]), LEVER, False))


def disturbed(nav: np.ndarray, error: np.ndarray) -> np.ndarray:
    """``nav`` with ``error`` in it, the corrected rate and force included: a correction by -error."""
    other = nav.copy()
    inject(other, CONSTANTS, -error)
    # the sensors' values are fixed: a bias estimate that moves shows in the corrected rate and force
    for corrected, bias in ((at.PREV_RATE, at.GYRO_BIAS), (at.PREV_FORCE, at.ACCEL_BIAS)):
        other[corrected : corrected + 3] -= other[bias : bias + 3] - nav[bias : bias + 3]
    return other


@pytest.mark.parametrize("name", CASES)
def test_observation_matrix_is_the_derivative(name: str) -> None:
    function, arguments = CASES[name]
    nav = state()
    _, H = function(nav, N, *arguments)
    numeric = np.empty_like(H)
    for k in range(N):
        step = np.zeros(N)
        step[k] = 1e-5
        plus, _ = function(disturbed(nav, step), N, *arguments)
        minus, _ = function(disturbed(nav, -step), N, *arguments)
        numeric[:, k] = (plus - minus) / 2e-5
    np.testing.assert_allclose(H, numeric, atol=2e-5)


def test_magnetic_heading_sees_the_misalignment_about_up() -> None:
    nav = state()
    error = np.zeros(N)
    error[at.PHI + 2] = 0.01
    field_n = np.array([0.0, 20e-6, -40e-6])
    C = measurements.quat_to_matrix(nav[at.QUAT : at.QUAT + 4])
    field = C.T @ field_n
    z, H = measurements.magnetic_heading(disturbed(nav, error), N, *field, 0.0)
    assert z[0] == pytest.approx(0.01, abs=1e-4)
    assert np.flatnonzero(H[0]).tolist() == [at.PHI + 2]


def test_position_across_the_date_line_is_near() -> None:
    nav = state()
    nav[at.LON] = np.pi - 1e-7
    z, _ = measurements.gnss_position(nav, N, nav[at.LAT], -np.pi + 1e-7, nav[at.ALT], np.zeros(3))
    assert abs(z[0]) < 2.0


def test_mean_air_velocity_is_nought_for_the_true_velocity_and_wind() -> None:
    nav = state()
    C = measurements.quat_to_matrix(nav[at.QUAT : at.QUAT + 4])
    velocity = nav[at.VEL : at.VEL + 3]
    air = C.T @ (velocity - [*nav[at.WIND : at.WIND + 2], 0.0])
    z, _ = measurements.mean_air_velocity(nav, N, WIND_STATES, C, velocity, C.T @ velocity, air)
    np.testing.assert_allclose(z, 0.0, atol=1e-12)


def test_beams_are_nought_for_what_the_sensor_measures() -> None:
    """GIVEN beams, late, turned, with bias and scale error THEN the row is what they measure less what is told."""
    nav = state()
    C = measurements.quat_to_matrix(nav[at.QUAT : at.QUAT + 4])
    *biases, scale, x, y, z = nav[DVL.estimates]
    turned = beam_directions() @ quat_to_matrix(quat_from_rotvec(np.array([x, y, z]))).T
    v_b = C.T @ nav[at.VEL : at.VEL + 3] + np.cross(nav[at.PREV_RATE : at.PREV_RATE + 3], LEVER)
    measured = (1.0 + scale) * turned @ (v_b - 0.1 * CHANGE) + biases
    rows, _ = beam_velocities(nav, N, measured, LEVER, True)
    np.testing.assert_allclose(rows, 0.0, atol=1e-12)
