"""Simulated input checks of autopilots: each consumer stores the messages it accepts, and why it rejects others.

The checks are those of PX4's EKF2 (external vision: finite values, known frame, unit quaternion in float32, gaps of at
most 200 ms, no stamps in the future), of ArduPilot's external navigation (LOCAL_FRD and BODY_FRD via MAVROS, at least
4 Hz) and of its GPS_INPUT driver (instance, fix type, time of week). In addition, a position may only jump with the
reset counter, or after a pause in sending.
"""

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

LATE = 0.2  # s
SILENCE = 1.0  # s: gap that counts as a pause in sending
JUMP = 1.0  # m
TO_NED = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
TO_FRD = np.diag([1.0, -1.0, -1.0])


@dataclass
class Taken:
    """A message as interpreted by the autopilot: time [s], NED, body FRD."""

    t: float
    position: np.ndarray  # (3,), NaN where none is given
    velocity: np.ndarray  # (3,) NED
    attitude: np.ndarray  # (3, 3) FRD to NED
    position_var: np.ndarray  # (3,)
    resets: int = 0


@dataclass
class Consumer:
    """Common checks: time, rate, jumps."""

    longest_gap: float
    taken: list[Taken] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)

    def take(self, message: Any, now: float) -> None:
        """Receive a message at ``now`` [s]."""
        try:
            item = self.read(message)
            self.check(item, now)
        except AssertionError as reason:
            self.refused.append(str(reason).splitlines()[0])
        else:
            self.taken.append(item)

    def read(self, message: Any) -> Taken:
        """Interpret the message; ``AssertionError`` if the autopilot would reject it."""
        raise NotImplementedError

    def check(self, item: Taken, now: float) -> None:
        """Check time and continuity."""
        assert -1e-6 <= now - item.t <= LATE, f"time: {now - item.t:.3f} s old"
        assert np.isfinite(item.velocity).all(), "velocity: not finite"
        if np.isfinite(item.position).all():
            assert is_variance(item.position_var), "covariance: position"
        else:
            assert np.isnan(item.position).all(), "position: partly unknown"
        if not self.taken:
            return
        last, dt = self.taken[-1], item.t - self.taken[-1].t
        assert dt > 0.0, "time: not monotonic"
        if dt > SILENCE:
            return
        assert dt <= self.longest_gap, f"rate: a gap of {dt:.3f} s"
        step = np.linalg.norm(item.position - last.position - 0.5 * dt * (item.velocity + last.velocity))
        assert not step > JUMP or item.resets != last.resets, f"jump: {step:.1f} m without a reset"


class Px4(Consumer):
    """EKF2 with external vision, behind the uXRCE-DDS client with clocks in step."""

    def __init__(self) -> None:
        super().__init__(LATE)

    def read(self, message: Any) -> Taken:
        """px4_msgs/VehicleOdometry."""
        assert (message.pose_frame, message.velocity_frame) == (1, 1), "frame: not NED"
        q = np.asarray(message.q, np.float32)
        assert abs(1.0 - float(np.linalg.norm(q))) <= 1e-5, "attitude: no unit quaternion"
        assert min(message.timestamp, message.timestamp_sample) > 0, "time: zero"
        for name in ("velocity", "orientation"):
            assert is_variance(getattr(message, f"{name}_variance")), f"covariance: {name}"
        assert np.isfinite(message.angular_velocity).all(), "angular velocity: not finite"
        assert 0 < message.quality <= 100, "quality: out of range"
        t = message.timestamp_sample * 1e-6
        position, velocity = np.array(message.position, float), np.array(message.velocity, float)
        variance = np.array(message.position_variance, float)
        return Taken(t, position, velocity, matrix(q), variance, message.reset_counter)


class Mavros(Consumer):
    """The plugin ``odometry`` of MAVROS with an autopilot: without a reset counter, so that no jump is allowed."""

    def __init__(self) -> None:
        super().__init__(0.25)

    def read(self, message: Any) -> Taken:
        """nav_msgs/Odometry, converted like MAVROS by the static transforms that it publishes."""
        assert message.header.frame_id in ("map", "odom"), "frame: no transform to ..._ned"
        assert message.child_frame_id == "base_link", "frame: no transform to ..._frd"
        for name, cov in (("pose", message.pose.covariance), ("twist", message.twist.covariance)):
            P = np.reshape(cov, (6, 6))
            assert np.isfinite(P).all(), f"covariance: {name} not finite"
            assert np.allclose(P, P.T), f"covariance: {name} not symmetric"
            assert np.linalg.eigvalsh(P).min() > 0.0, f"covariance: {name} not positive"
        pose, linear = message.pose.pose, message.twist.twist.linear
        C_nb = matrix(np.array([getattr(pose.orientation, axis) for axis in "wxyz"]))
        velocity = C_nb @ [linear.x, linear.y, linear.z]
        position = np.array([pose.position.x, pose.position.y, pose.position.z])
        variance = np.diag(np.reshape(message.pose.covariance, (6, 6)))[[1, 0, 2]]
        return Taken(seconds(message), TO_NED @ position, TO_NED @ velocity, TO_NED @ C_nb @ TO_FRD, variance)


class GpsInput(Consumer):
    """ArduPilot's GPS driver for GPS_INPUT: instance 1, GPS time; metres from the first position."""

    def __init__(self) -> None:
        super().__init__(LATE)
        self.first: tuple[float, float, float] | None = None

    def read(self, message: Any) -> Taken:
        """mavros_msgs/GPSINPUT."""
        assert message.gps_id == 1, "frame: another receiver"
        assert message.fix_type >= 3, "quality: no fix"
        assert message.satellites_visible >= 6, "quality: satellites"
        assert message.ignore_flags & ~6 == 0, "covariance: ignored fields that are needed"
        accuracies = (message.horiz_accuracy, message.vert_accuracy, message.speed_accuracy)
        assert all(0.0 < a < math.inf for a in accuracies), "covariance: accuracy"
        assert message.time_week > 0, "time: no week"
        t = message.time_week * 604_800 + message.time_week_ms * 1e-3 + 315_964_800 - 18
        assert abs(t - seconds(message)) < 2e-3, "time: week and stamp disagree"
        place = math.radians(message.lat * 1e-7), math.radians(message.lon * 1e-7), message.alt
        self.first = first = self.first or place
        north, east = (place[0] - first[0]) * 6.37e6, (place[1] - first[1]) * 6.37e6 * math.cos(first[0])
        variance = np.array([0.5, 0.5, 1.0]) * np.square([accuracies[0], accuracies[0], accuracies[1]])
        velocity = np.array([message.vn, message.ve, message.vd], float)
        return Taken(seconds(message), np.array([north, east, first[2] - place[2]]), velocity, np.eye(3), variance)


def is_variance(values: np.ndarray) -> bool:
    """Whether all are finite and positive."""
    return bool(np.isfinite(values).all() and (values > 0.0).all())


def seconds(message: Any) -> float:
    """The stamp of the header."""
    return message.header.stamp.sec + message.header.stamp.nanosec * 1e-9


def matrix(q: np.ndarray) -> np.ndarray:
    """Matrix (3, 3) of a quaternion, scalar first; independent of the code under test."""
    w, x, y, z = (float(c) for c in q)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
