"""Motions given by formulas with analytic derivatives, for tests of navigators and attitude filters."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from nav_pose_estimator.core.numerics.rotation import quat_from_euler_many
from nav_pose_estimator.sim.trajectories import Kinematics, Motion

G = 9.81
"""Gravity [m/s^2] in the planning of manoeuvres; the IMU is computed with the local gravity."""


@dataclass(frozen=True)
class Harmonics:
    """offset + slope t + sum of amplitude_i sin(frequency_i t + phase_i), with its first two derivatives."""

    offset: float = 0.0
    slope: float = 0.0
    amplitudes: tuple[float, ...] = ()
    frequencies: tuple[float, ...] = ()  # rad/s
    phases: tuple[float, ...] = ()  # rad

    def __call__(self, t: np.ndarray, derivative: int = 0) -> np.ndarray:
        """Value (0), first (1) or second (2) derivative at the times ``t`` (N,)."""
        straight = (self.offset + self.slope * t, np.full_like(t, self.slope), np.zeros_like(t))[derivative]
        angle = np.multiply.outer(t, self.frequencies) + np.asarray(self.phases) + 0.5 * np.pi * derivative
        return straight + np.sin(angle) @ (np.asarray(self.amplitudes) * np.asarray(self.frequencies) ** derivative)


@dataclass(frozen=True)
class HarmonicMotion:
    """Position (East, North, Up) and attitude (roll, pitch, yaw) as one ``Harmonics`` each."""

    position: tuple[Harmonics, Harmonics, Harmonics] = (Harmonics(), Harmonics(), Harmonics())
    attitude: tuple[Harmonics, Harmonics, Harmonics] = (Harmonics(), Harmonics(), Harmonics())

    def __call__(self, t: np.ndarray) -> Kinematics:
        """State of motion at the times ``t`` (N,)."""
        v, a = (np.column_stack([axis(t, order) for axis in self.position]) for order in (1, 2))
        angles, rates = ([axis(t, order) for axis in self.attitude] for order in (0, 1))
        return Kinematics(v, a, *attitude_from_euler(*angles, *rates))


def attitude_from_euler(
    roll: np.ndarray,
    pitch: np.ndarray,
    yaw: np.ndarray,
    roll_rate: np.ndarray,
    pitch_rate: np.ndarray,
    yaw_rate: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Quaternion (N, 4) and angular rate in b (N, 3) of Euler angles (N,) [rad] and their derivatives."""
    sin_roll, cos_roll = np.sin(roll), np.cos(roll)
    horizontal = yaw_rate * np.cos(pitch)
    w_b = np.column_stack(
        [
            roll_rate - yaw_rate * np.sin(pitch),
            pitch_rate * cos_roll + horizontal * sin_roll,
            horizontal * cos_roll - pitch_rate * sin_roll,
        ]
    )
    return quat_from_euler_many(roll, pitch, yaw), w_b


def at_rest(roll: float = 0.0, pitch: float = 0.0, yaw: float = 0.0) -> Motion:
    """Rest relative to the rotating Earth at the given attitude [rad]."""
    return HarmonicMotion(attitude=(Harmonics(roll), Harmonics(pitch), Harmonics(yaw)))


def mooring(sway: tuple[float, float, float] = (5.0, 3.0, 2.0), heading: float = 30.0) -> Motion:
    """A moored ship at ``heading`` [deg]; roll, pitch, yaw with amplitudes ``sway`` [deg] and periods of 8, 6, 10 s."""
    roll, pitch, yaw = (
        Harmonics(offset, 0.0, (float(np.radians(size)),), (2.0 * np.pi / period,), (phase,))
        for offset, size, period, phase in zip(
            (0.0, 0.0, float(np.radians(90.0 - heading))), sway, (8.0, 6.0, 10.0), (0.0, 1.0, 2.0), strict=True
        )
    )
    return HarmonicMotion(attitude=(roll, pitch, yaw))


def coning(half_angle: float = 0.05, frequency: float = 2.0 * np.pi * 5.0) -> Motion:
    """Coning motion: the z axis moves on a cone of ``half_angle`` [rad] at ``frequency`` [rad/s].

    The attitude is periodic, but the integral of each axis's rate alone drifts by frequency (1 - cos half_angle) about
    z (Savage, Strapdown Inertial Navigation Integration Algorithm Design Part 1, 1998, section on coning).
    """

    def motion(t: np.ndarray) -> Kinematics:
        phase = frequency * t
        zero = np.zeros((len(t), 3))
        s, c = np.sin(phase), np.cos(phase)
        half = np.sin(0.5 * half_angle)
        q = np.column_stack([np.full_like(t, np.cos(0.5 * half_angle)), half * c, half * s, np.zeros_like(t)])
        across = frequency * np.sin(half_angle)
        w_b = np.column_stack([-across * s, across * c, np.full_like(t, frequency * (np.cos(half_angle) - 1.0))])
        return Kinematics(zero, zero, q, w_b)

    return motion


def figure_eight(size: float = 60.0, period: float = 40.0) -> Motion:
    """A level figure of eight, ``size`` [m] long, with the x axis along the path."""
    w = 2.0 * np.pi / period
    east = Harmonics(0.0, 0.0, (0.5 * size,), (w,), (0.0,))
    north = Harmonics(0.0, 0.0, (0.25 * size,), (2.0 * w,), (0.0,))

    def motion(t: np.ndarray) -> Kinematics:
        v = np.column_stack([east(t, 1), north(t, 1), np.zeros_like(t)])
        a = np.column_stack([east(t, 2), north(t, 2), np.zeros_like(t)])
        yaw = np.arctan2(v[:, 1], v[:, 0])
        yaw_rate = (v[:, 0] * a[:, 1] - v[:, 1] * a[:, 0]) / (v[:, 0] ** 2 + v[:, 1] ** 2)
        level = np.zeros_like(t)
        return Kinematics(v, a, *attitude_from_euler(level, level, yaw, level, level, yaw_rate))

    return motion


def closed_curve(period: float = 60.0) -> Motion:
    """An aggressive aerobatic curve that closes after ``period`` [s]: up to 44 m/s, 4.8 g and 3.6 rad/s."""
    w = 2.0 * np.pi / period
    return HarmonicMotion(
        position=(
            Harmonics(0.0, 0.0, (60.0, 8.0, 0.8), (3 * w, 11 * w, 47 * w), (0.0, 1.0, 2.0)),
            Harmonics(0.0, 0.0, (50.0, 10.0, 0.9), (4 * w, 9 * w, 43 * w), (0.5, 2.0, 0.3)),
            Harmonics(0.0, 0.0, (15.0, 3.0, 0.4), (5 * w, 13 * w, 53 * w), (1.0, 0.0, 1.5)),
        ),
        attitude=(
            Harmonics(0.0, 0.0, (0.9, 0.15), (19 * w, 61 * w), (0.0, 0.7)),
            Harmonics(0.1, 0.0, (0.7, 0.10), (17 * w, 67 * w), (1.1, 0.0)),
            Harmonics(0.3, 5 * w, (1.0, 0.2), (7 * w, 59 * w), (0.4, 2.2)),
        ),
    )


def coordinated_acceleration(
    tilt: float = np.radians(15.0), start: float = 20.0, length: float = 10.0, ramp: float = 0.5
) -> Motion:
    """A multirotor without drag that tilts forward by ``tilt`` [rad] for ``length`` [s], then brakes for as long.

    Its specific force is always along the z axis of b, so that a filter that takes it for the vertical stays
    level. At 15 deg its norm deviates from gravity by only 3.5 %.
    """
    knots = np.arange(0.0, start + 2.0 * length + 10.0, 0.002)
    lean = _plateau(knots, start, length, ramp) - _plateau(knots, start + length, length, ramp)
    pitch = CubicSpline(knots, tilt * lean)
    speed = CubicSpline(knots, G * np.tan(tilt * lean)).antiderivative()

    def motion(t: np.ndarray) -> Kinematics:
        inside = np.clip(t, knots[0], knots[-1])
        still = np.zeros_like(t)
        v = np.column_stack([speed(inside), still, still])
        a = np.column_stack([speed(inside, 1), still, still])
        rate = np.where(inside == t, pitch(inside, 1), 0.0)
        return Kinematics(v, a, *attitude_from_euler(still, pitch(inside), still, still, rate, still))

    return motion


def minimum_jerk(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Minimum-jerk step 10 x^3 - 15 x^4 + 6 x^5 and its first two derivatives; constant outside [0, 1]."""
    x = np.clip(x, 0.0, 1.0)
    return (
        x**3 * (10.0 - 15.0 * x + 6.0 * x**2),
        30.0 * x**2 * (1.0 - x) ** 2,
        60.0 * x * (1.0 - x) * (1.0 - 2.0 * x),
    )


def _plateau(t: np.ndarray, start: float, length: float, ramp: float) -> np.ndarray:
    return minimum_jerk((t - start) / ramp)[0] - minimum_jerk((t - start - length) / ramp)[0]
