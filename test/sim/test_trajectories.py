"""The ideal IMU is the exact inverse of navigation: checked in inertial space, and with the strapdown navigator."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from closed_loop import navigate
from nav_pose_estimator.core.earth.ellipsoid import OMEGA, ecef_to_enu_matrix, gravity_many, lla_to_ecef, lla_to_enu
from nav_pose_estimator.core.numerics.rotation import (
    quat_conjugate_many,
    quat_multiply_many,
    quat_rotate_many,
)
from nav_pose_estimator.sim import trajectories
from nav_pose_estimator.sim.trajectories import Origin, Truth, sample_times, truth_of_motion
from nav_pose_estimator.sim.vehicles import motions
from nav_pose_estimator.sim.vehicles.motions import HarmonicMotion, Harmonics
from rotations import rotation_matrices, rotation_vectors

HOME = Origin(np.radians(47.0), np.radians(8.0), 500.0)
MOTIONS = {
    "at rest": motions.at_rest(0.1, -0.2, 0.3),
    "coning": motions.coning(),
    "figure eight": motions.figure_eight(),
    "closed curve": motions.closed_curve(),
    "coordinated acceleration": motions.coordinated_acceleration(),
}


def inertial(truth: Truth) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position r_i (N, 3), gravitation (N, 3) and attitude C_ib (N, 3, 3) in the inertial frame of time zero."""
    angle = OMEGA * truth.t
    c, s, zero, one = np.cos(angle), np.sin(angle), np.zeros_like(angle), np.ones_like(angle)
    C_ie = np.stack([np.stack([c, -s, zero], -1), np.stack([s, c, zero], -1), np.stack([zero, zero, one], -1)], -2)
    r_e = lla_to_ecef(truth.lat, truth.lon, truth.alt)
    C_en = np.swapaxes(ecef_to_enu_matrix(truth.lat, truth.lon), -1, -2)
    gravity_e = -gravity_many(truth.lat, truth.alt)[:, None] * C_en[:, :, 2]
    gravitation_e = gravity_e - OMEGA**2 * r_e * [1.0, 1.0, 0.0]  # without the centrifugal part
    rotate = lambda v: np.einsum("nij,nj->ni", C_ie, v)  # noqa: E731
    return rotate(r_e), rotate(gravitation_e), C_ie @ C_en @ rotation_matrices(truth.q_nb)


@pytest.mark.parametrize(
    ("name", "rate", "tolerance"),
    # What remains is the curvature of the force times dt^2, and 1e-9 m of rounding differenced twice.
    [("figure eight", 50.0, 5e-5), ("coordinated acceleration", 100.0, 6e-4), ("closed curve", 200.0, 6e-3)],
)
def test_accelerometer_agrees_with_newton_in_inertial_space(name: str, rate: float, tolerance: float) -> None:
    truth = truth_of_motion(MOTIONS[name], sample_times(25.0, rate), HOME)
    r_i, gravitation_i, C_ib = inertial(truth)
    # Newton knows nothing of Coriolis (1 mm/s^2 at 7 m/s): second difference of the position minus gravitation.
    force_i = (r_i[2:] - 2.0 * r_i[1:-1] + r_i[:-2]) / truth.dt**2 - gravitation_i[1:-1]
    expected = np.einsum("nji,nj->ni", C_ib[1:-1], force_i)
    measured = 0.5 * (truth.accel[1:-1] + truth.accel[2:])
    np.testing.assert_allclose(measured, expected, atol=tolerance)
    np.testing.assert_allclose(np.mean(measured - expected, axis=0), 0.0, atol=0.05 * tolerance)


@pytest.mark.parametrize("name", ["at rest", "closed curve", "coning"])
def test_gyroscope_agrees_with_the_turn_in_inertial_space(name: str) -> None:
    truth = truth_of_motion(MOTIONS[name], sample_times(20.0, 400.0), HOME)
    spin = np.zeros((len(truth), 4))
    spin[:, 0], spin[:, 3] = np.cos(0.5 * OMEGA * truth.t), np.sin(0.5 * OMEGA * truth.t)
    q_ib = quat_multiply_many(spin, quat_multiply_many(trajectories._q_en(truth.lat, truth.lon), truth.q_nb))
    turn = rotation_vectors(quat_multiply_many(quat_conjugate_many(q_ib[:-1]), q_ib[1:]))
    # The rotation vector is the integral of the rate plus coning, which two successive means give to third order.
    coning = truth.dt**2 / 12.0 * np.cross(truth.gyro[:-1], truth.gyro[1:])
    np.testing.assert_allclose(truth.gyro[1:] * truth.dt + coning, turn, atol=1e-8)


def test_at_rest_the_imu_feels_gravity_and_the_rotation_of_the_earth() -> None:
    truth = truth_of_motion(motions.at_rest(0.1, -0.2, 0.3), sample_times(2.0, 100.0), HOME)
    q_bn = quat_conjugate_many(truth.q_nb)
    up = np.array([0.0, 0.0, 1.0]) * gravity_many(truth.lat, truth.alt)[:, None]
    earth = OMEGA * np.array([0.0, np.cos(HOME.lat), np.sin(HOME.lat)])
    np.testing.assert_allclose(truth.accel, quat_rotate_many(q_bn, up), atol=1e-12)
    np.testing.assert_allclose(truth.gyro, quat_rotate_many(q_bn, earth), atol=1e-17)


@pytest.mark.parametrize("name", MOTIONS)
def test_navigator_returns_within_a_centimetre_after_a_minute(name: str) -> None:
    # GIVEN the error-free IMU of a motion at 200 Hz, the aggressive one up to 4.8 g
    truth = truth_of_motion(MOTIONS[name], sample_times(60.0, 200.0), HOME)
    # WHEN the strapdown navigator integrates it THEN it ends where the truth ends
    errors = navigate(truth)
    assert errors.position[-1] < 0.01
    assert errors.velocity[-1] < 0.001
    assert errors.attitude[-1] < (1e-4 if name == "coning" else 1e-6)


def test_navigator_converges_with_the_cube_of_the_interval() -> None:
    ends = [
        navigate(truth_of_motion(motions.closed_curve(), sample_times(30.0, rate), HOME)).position[-1]
        for rate in (100.0, 200.0)
    ]
    assert ends[0] / ends[1] > 6.0


def test_closed_curve_closes() -> None:
    truth = truth_of_motion(motions.closed_curve(), sample_times(60.0, 200.0), HOME)
    enu = truth.position_enu(HOME)
    assert np.linalg.norm(enu[-1] - enu[0]) < 1e-6
    assert np.linalg.norm(truth.v_n, axis=1).max() > 40.0
    assert np.linalg.norm(truth.accel, axis=1).max() > 4.5 * 9.8


def test_coordinated_acceleration_hides_in_the_accelerometer() -> None:
    truth = truth_of_motion(motions.coordinated_acceleration(), sample_times(60.0, 200.0), HOME)
    leaning = (truth.t > 21.0) & (truth.t < 29.0)
    assert np.abs(truth.accel[leaning, :2]).max() < 0.02  # 2 mg although the tilt is 15 deg
    np.testing.assert_allclose(truth.accel[leaning, 2] / 9.81, 1.0 / np.cos(np.radians(15.0)), rtol=2e-3)
    still = (truth.t < 19.0) | (truth.t > 41.0)
    assert np.linalg.norm(truth.v_n[still], axis=1).max() < 1e-9


@settings(max_examples=20, deadline=None)
@given(
    st.floats(-1.3, 1.3),
    st.floats(-3.0, 3.0),
    st.lists(st.tuples(st.floats(0.1, 3.0), st.floats(0.2, 6.0), st.floats(-3.0, 3.0)), min_size=6, max_size=6),
)
def test_any_smooth_motion_anywhere_is_inverted(lat: float, lon: float, waves: list) -> None:
    axes = [Harmonics(0.0, 0.0, (size,), (frequency,), (phase,)) for size, frequency, phase in waves]
    angles = [Harmonics(0.0, 0.0, (0.3 * size,), (frequency,), (phase,)) for size, frequency, phase in waves[3:]]
    motion = HarmonicMotion(tuple(axes[:3]), tuple(angles))
    truth = truth_of_motion(motion, sample_times(5.0, 400.0), Origin(lat, lon, 100.0))
    errors = navigate(truth)
    assert errors.position[-1] < 1e-3
    assert errors.attitude[-1] < 1e-5


def test_velocity_is_the_derivative_of_position() -> None:
    truth = truth_of_motion(motions.closed_curve(), sample_times(10.0, 400.0), HOME)
    enu = lla_to_enu(truth.lat, truth.lon, truth.alt, *HOME)
    slope = (enu[2:] - enu[:-2]) / (2.0 * truth.dt)
    # The local level frame turns by 100 m / 6.4e6 m against the tangent frame: 1.6e-5 of the speed.
    np.testing.assert_allclose(truth.v_n[1:-1], slope, atol=0.02)


def test_long_motions_are_worked_on_in_chunks_without_a_seam(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = truth_of_motion(motions.closed_curve(), sample_times(4.0, 100.0), HOME)
    monkeypatch.setattr(trajectories, "_CHUNK", 37)
    pieces = truth_of_motion(motions.closed_curve(), sample_times(4.0, 100.0), HOME)
    for name in ("lat", "lon", "alt", "v_n", "q_nb", "gyro", "accel"):
        np.testing.assert_allclose(getattr(pieces, name), getattr(whole, name), rtol=1e-12, atol=1e-12)


def test_truth_between_its_rows() -> None:
    truth = truth_of_motion(motions.figure_eight(), sample_times(45.0, 100.0), HOME)
    same = truth.at(truth.t)
    np.testing.assert_allclose(same.v_n, truth.v_n, atol=1e-12)
    between = truth.at(truth.t[:-1] + 0.005)
    finer = truth_of_motion(motions.figure_eight(), sample_times(45.0, 200.0), HOME)
    # The yaw runs through +-pi: there the quaternion changes its sign, and the interpolation must not notice.
    turn = rotation_vectors(quat_multiply_many(quat_conjugate_many(between.q_nb), finer.q_nb[1:-1:2]))
    assert np.linalg.norm(turn, axis=1).max() < 1e-4


def test_harmonics_derivatives() -> None:
    wave = Harmonics(1.0, 0.5, (2.0, 0.3), (1.5, 7.0), (0.1, 0.2))
    t, h = np.linspace(0.0, 3.0, 50), 1e-5
    np.testing.assert_allclose(wave(t, 1), (wave(t + h) - wave(t - h)) / (2.0 * h), atol=1e-8)
    np.testing.assert_allclose(wave(t, 2), (wave(t + h, 1) - wave(t - h, 1)) / (2.0 * h), atol=1e-7)
