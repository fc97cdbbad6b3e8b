"""Levelling by gravity, heading by the field, and what is wrong with a field that cannot be the Earth's."""

import math

import numpy as np
import pytest

from nav_pose_estimator.core.alignment.levelling import (
    dipole_dip,
    field_doubt,
    inclined_attitudes,
    level_attitude,
    level_covariance,
    magnetic_yaw,
)
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.rotation import (
    euler_from_quat,
    quat_from_euler,
    quat_from_rotvec,
    quat_multiply,
    quat_to_matrix,
    rotvec_from_quat_many,
)
from nav_pose_estimator.sim.trajectories import Origin

ORIGIN = Origin(math.radians(47.4), math.radians(8.5), 450.0)
FIELD_N = np.array([0.7e-6, 21.6e-6, -42.7e-6])  # declination 1.9 deg
DECLINATION = math.atan2(FIELD_N[0], FIELD_N[1])


@pytest.mark.parametrize(("roll", "pitch", "yaw"), [(0.1, -0.2, 0.5), (-1.0, 0.6, -2.5), (3.0, 0.1, 3.1), (0, 1.4, 1)])
def test_gravity_and_field_give_the_attitude(roll, pitch, yaw):
    q = quat_from_euler(roll, pitch, yaw)
    C = quat_to_matrix(q)
    level = level_attitude(C.T @ [0.0, 0.0, 9.8])
    np.testing.assert_allclose(euler_from_quat(level), (roll, pitch, 0.0), atol=1e-12)
    assert magnetic_yaw(level, C.T @ FIELD_N, DECLINATION) == pytest.approx(yaw)


@pytest.mark.parametrize("acceleration", [[0.0, 0.0, 0.0], [9.0, -4.0, 2.0], [-3.0, 20.0, -6.0]])
def test_a_force_that_gnss_explains_leaves_one_turn_open(acceleration):
    """GIVEN a turning body that accelerates WHEN the acceleration is known THEN the true attitude is among those found,
    to half a step, and all of them put the force where it is."""
    a, rate, dt = np.array(acceleration), np.array([0.4, -0.3, 0.9]), 0.01
    qs = [quat_from_euler(0.6, -0.3, 2.0)]
    for _ in range(100):
        qs.append(quat_multiply(qs[-1], quat_from_rotvec(rate * dt)))
    force_n = a + np.array([0.0, 0.0, 9.80665])
    rows = np.array([[i * dt, *rate, *(quat_to_matrix(q).T @ force_n + 0.1)] for i, q in enumerate(qs)])
    found = inclined_attitudes(rows, (0.1, 0.1, 0.1), a)
    apart = [np.linalg.norm(rotvec_from_quat_many(quat_multiply(q, qs[-1] * (1.0, -1.0, -1.0, -1.0)))) for q in found]
    assert min(apart) < math.radians(2.6)
    for q in found:
        off = quat_to_matrix(q) @ (rows[-1, 4:7] - 0.1) - force_n
        assert np.linalg.norm(off) < 0.01 * np.linalg.norm(force_n)
    assert inclined_attitudes(rows, (0.1, 0.1, 0.1), a + 0.5 * force_n) is None


def test_level_covariance_ties_tilt_to_the_accelerometer_bias():
    """A sample of biases, levelled: the scatter of attitude and bias is the covariance."""
    q = quat_from_euler(0.3, -0.2, 0.0)
    C = quat_to_matrix(q)
    rng = np.random.default_rng(3)
    errors = []
    for bias in rng.normal(0.0, 0.1, (4000, 3)):
        level = level_attitude(C.T @ [0.0, 0.0, 9.80665] + bias)
        phi = -rotvec_from_quat_many(quat_multiply(level, q * (1.0, -1.0, -1.0, -1.0)))
        errors.append([*phi[:2], *bias])
    expected = level_covariance(q, 0.0, 1e-4, 0.1, 2.0)
    rows = [at.PHI, at.PHI + 1, *range(at.D_ACCEL_BIAS, at.D_ACCEL_BIAS + 3)]
    # the zero yaw of the start is no rotation about Up, so only the tilts are compared
    np.testing.assert_allclose(np.cov(np.array(errors).T), expected[np.ix_(rows, rows)], atol=1.2e-3 * 0.5)


@pytest.mark.parametrize(
    ("place", "dip_deg"), [((47.4, 8.5), 63), ((-37.9, 144.8), -68), ((40.5, -87.0), 66), ((32.8, 35.0), 49)]
)
def test_dipole_dip_is_near_the_true_one(place, dip_deg):
    assert math.degrees(dipole_dip(*map(math.radians, place))) == pytest.approx(dip_deg, abs=12.0)


def test_implausible_fields_are_named():
    level = quat_from_euler(0.0, 0.0, 0.0)
    zurich = (ORIGIN.lat, ORIGIN.lon)
    assert field_doubt(level, FIELD_N, *zurich) == ""
    assert "uT" in field_doubt(level, 1e6 * FIELD_N, *zurich)  # published in the wrong unit
    assert "dip" in field_doubt(level, FIELD_N * (1.0, 1.0, -1.0), *zurich)
    assert "vertical" in field_doubt(level, (0.0, 1e-6, 50e-6), *zurich)
    assert field_doubt(level, FIELD_N * (1.0, 1.0, -1.0), None, None) == ""
