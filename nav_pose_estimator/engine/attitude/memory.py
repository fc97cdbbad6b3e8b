"""State of an attitude engine, and the aiding of its filter by the navigator's velocity."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.attitude import layout as at
from nav_pose_estimator.core.attitude.motion import subtract_velocity_change
from nav_pose_estimator.engine.number_checks import is_within
from nav_pose_estimator.engine.samples import NavigatorVelocity, Vector3
from nav_pose_estimator.engine.solutions import Event

_NS = 1e-9
_VELOCITY_GAP_NS = 1_000_000_000  # velocities further apart give no acceleration
_LARGEST_SPEED, _LARGEST_COMPONENT = 1e4, 1.1  # m/s, and of a unit quaternion: anything beyond is damaged
_GOOD_HEADING = 0.1  # rad: largest deviation of a navigator's heading that corrects the filter
_GOOD_LEVEL = 0.01  # rad: largest deviation of a navigator's tilt that corrects the accelerometer bias
_LEVEL_TAU = 60.0  # s: time constant of that correction, slow compared with the filter's own levelling
_MOST_BIAS = 0.5  # m/s^2: bound of the accelerometer bias
_HEADING_TAU = 20.0  # s: correlation time of the navigator's heading error while GNSS aids it
# rad: a filter with a larger heading deviation cannot resolve a velocity without orientation in its own axes.
_KNOWN_HEADING = 0.35


@dataclass
class Memory:
    """Everything that changes while the engine runs; ``state`` is the filter's (``core.attitude.layout``)."""

    state: np.ndarray
    last_ns: int | None = None
    started_ns: int = 0
    mag_ns: int | None = None
    disturbed: bool = False
    velocity: NavigatorVelocity | None = None
    body_velocity_ns: int | None = None

    @property
    def age(self) -> float:
        """Seconds of data since the start."""
        return ((self.last_ns or 0) - self.started_ns) * _NS

    @property
    def waiting_for(self) -> str:
        """What the engine is waiting for, one sentence for the user; empty once the attitude is level."""
        if self.last_ns is None:
            return "no IMU sample has come yet"
        return "levelling: the first second of data" if self.age < 1.0 else ""


def take_velocity(sample: NavigatorVelocity, memory: Memory) -> list[Event]:
    """Pass the change of the vehicle's velocity since the last sample to the filter, which is not gravity."""
    stamp, before = sample.stamp_ns, memory.velocity
    if not (is_within(sample.vel_enu, _LARGEST_SPEED) and is_within(sample.q_nb or (), _LARGEST_COMPONENT)):
        return [Event(stamp, "navigator_velocity.rejected.nan")]
    if memory.last_ns is None:
        return [Event(stamp, "navigator_velocity.rejected.no_attitude_yet")]
    if before is not None and stamp <= before.stamp_ns:
        return [Event(stamp, "navigator_velocity.rejected.stamp")]
    memory.velocity = sample
    if before is None or not (sample.valid and before.valid) or stamp - before.stamp_ns > _VELOCITY_GAP_NS:
        return []
    turn = _heading_from(sample, memory.state)
    if turn is None:
        return [Event(stamp, "navigator_velocity.ignored.heading_unknown")]
    dt, c, d = (stamp - before.stamp_ns) * _NS, math.cos(turn), math.sin(turn)
    if sample.q_nb is not None and not sample.drifting:
        _learn_from(sample, sample.q_nb, memory.state, turn, dt)
    east, north, up = (now - then for now, then in zip(sample.vel_enu, before.vel_enu, strict=True))
    change = (c * east - d * north, d * east + c * north, up)
    speed = -1.0 if sample.drifting else math.hypot(*sample.vel_enu)
    subtract_velocity_change(memory.state, change, dt, 2.0 * dt, speed)
    return []


def _learn_from(sample: NavigatorVelocity, q_nb: Sequence[float], s: np.ndarray, turn: float, dt: float) -> None:
    """Learn heading and accelerometer bias from a navigator that GNSS aids; after its loss both are only kept."""
    if sample.heading_sd < _GOOD_HEADING:
        s[at.NAV_HEADING] = math.remainder(-turn, 2.0 * math.pi)
        s[at.NAV_HEADING_VAR] = sample.heading_sd**2 * _HEADING_TAU / dt
    if sample.tilt_sd < _GOOD_LEVEL:
        # The filter's up (from the accelerometer) less the navigator's up, in b, is the bias over gravity.
        ups = zip(_up_in_b(*s[at.QUAT : at.QUAT + 4].tolist()), _up_in_b(*q_nb), strict=True)
        gain = min(dt / _LEVEL_TAU, 1.0) * float(s[at.GRAVITY])
        for i, (ours, theirs) in enumerate(ups, at.FORCE_BIAS):
            s[i] = min(max(float(s[i]) + gain * (ours - theirs), -_MOST_BIAS), _MOST_BIAS)


def _up_in_b(w: float, x: float, y: float, z: float) -> Vector3:
    return 2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y)


def _heading_from(sample: NavigatorVelocity, s: np.ndarray) -> float | None:
    """Angle [rad] about Up from the navigator's axes to those of the filter; None where it is unknown."""
    if sample.q_nb is None:
        return 0.0 if s[at.COV + 8] < _KNOWN_HEADING**2 else None
    (a, b, c, d), (w, x, y, z) = s[at.QUAT : at.QUAT + 4].tolist(), sample.q_nb
    return 2.0 * math.atan2(d * w - a * z + c * x - b * y, a * w + b * x + c * y + d * z)
