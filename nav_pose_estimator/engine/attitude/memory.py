"""State of an attitude engine, and the aiding of its filter by the navigator's velocity."""

import math
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.attitude.navigator_aid import follow_navigator
from nav_pose_estimator.engine.number_checks import is_within
from nav_pose_estimator.engine.samples import NavigatorVelocity
from nav_pose_estimator.engine.solutions import Event

_NS = 1e-9
_VELOCITY_GAP_NS = 1_000_000_000  # velocities further apart give no acceleration
_LARGEST_SPEED, _LARGEST_COMPONENT = 1e4, 1.1  # m/s, and of a unit quaternion: anything beyond is damaged
_GOOD_HEADING = 0.1  # rad: largest deviation of a navigator's heading that corrects the filter
_GOOD_LEVEL = 0.01  # rad: largest deviation of a navigator's tilt that corrects the accelerometer bias
_LEVEL_TAU = 60.0  # s: time constant of that correction, slow compared with the filter's own levelling
_HEADING_TAU = 20.0  # s: correlation time of the navigator's heading error while GNSS aids it
_NO_ATTITUDE = (0.0, 0.0, 0.0, 0.0)


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
    events, aid = judge_velocity(sample, memory)
    if aid is not None and not follow_navigator(memory.state, np.array(aid)):
        return [Event(sample.stamp_ns, "navigator_velocity.ignored.heading_unknown")]
    return events


def judge_velocity(sample: NavigatorVelocity, memory: Memory) -> tuple[list[Event], list[float] | None]:
    """Store a velocity; returns the event of a rejection, and the aid (``core.attitude.navigator_aid``) or None."""
    stamp, before = sample.stamp_ns, memory.velocity
    if not (is_within(sample.vel_enu, _LARGEST_SPEED) and is_within(sample.q_nb or (), _LARGEST_COMPONENT)):
        return [Event(stamp, "navigator_velocity.rejected.nan")], None
    if memory.last_ns is None:
        return [Event(stamp, "navigator_velocity.rejected.no_attitude_yet")], None
    if before is not None and stamp <= before.stamp_ns:
        return [Event(stamp, "navigator_velocity.rejected.stamp")], None
    memory.velocity = sample
    if before is None or not (sample.valid and before.valid) or stamp - before.stamp_ns > _VELOCITY_GAP_NS:
        return [], None
    dt = (stamp - before.stamp_ns) * _NS
    change = [now - then for now, then in zip(sample.vel_enu, before.vel_enu, strict=True)]
    speed = -1.0 if sample.drifting else math.hypot(*sample.vel_enu)
    heading_var = levelling = 0.0
    if not sample.drifting:  # after the loss of GNSS, heading and accelerometer bias are only kept
        heading_var = sample.heading_sd**2 * _HEADING_TAU / dt if sample.heading_sd < _GOOD_HEADING else 0.0
        levelling = min(dt / _LEVEL_TAU, 1.0) if sample.tilt_sd < _GOOD_LEVEL else 0.0
    return [], [dt, *change, speed, *(sample.q_nb or _NO_ATTITUDE), heading_var, levelling]
