"""A velocity measured in the vehicle (wheels, Doppler log) on its way into the attitude filter.

What such a velocity changes by, turned into n, is the part of the specific force that is not gravity: the vehicle's
acceleration and the centripetal one. GNSS has no part in it, so it helps as well where there is none.
"""

import numpy as np

from nav_pose_estimator.core.attitude import layout as at
from nav_pose_estimator.core.attitude.motion import take_body_velocity
from nav_pose_estimator.engine.attitude.memory import Memory
from nav_pose_estimator.engine.imu.mounting import rotation_from_rpy
from nav_pose_estimator.engine.number_checks import is_within
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import BodyVelocity
from nav_pose_estimator.engine.solutions import Event

_LARGEST_SPEED = 1e3  # m/s
_GAP_NS = 1_000_000_000


class BodyVelocityInput:
    """Takes body velocities for one attitude filter, mounted as ``aids.body_velocity_*`` says."""

    def __init__(self, parameters: Parameters) -> None:
        aids = parameters.aids
        self._enabled = aids.body_velocity
        self._axes, self._lever = rotation_from_rpy(aids.body_velocity_rpy), np.array(aids.body_velocity_lever)

    def take(self, sample: BodyVelocity, memory: Memory) -> list[Event]:
        """Let one sample act on the filter of ``memory``; returns why it does not."""
        stamp = sample.stamp_ns
        if not self._enabled or memory.last_ns is None or _navigator_helps(memory):
            return []
        if not is_within(sample.velocity, _LARGEST_SPEED):
            return [Event(stamp, "attitude.body_velocity.incomplete")]
        before, memory.body_velocity_ns = memory.body_velocity_ns, stamp
        if before is not None and stamp <= before:
            memory.body_velocity_ns = before
            return [Event(stamp, "attitude.body_velocity.stamp")]
        arm = np.cross(memory.state[at.RATE : at.RATE + 3], self._lever)
        x, y, z = (self._axes @ np.array(sample.velocity) - arm).tolist()
        dt_ns = 0 if before is None or stamp - before > _GAP_NS else stamp - before
        take_body_velocity(memory.state, x, y, z, dt_ns * 1e-9, 2e-9 * dt_ns)
        return []


def _navigator_helps(memory: Memory) -> bool:
    """A navigator of which GNSS or this very sensor is a part already says how the velocity changes."""
    said = memory.velocity
    return said is not None and said.valid and (memory.last_ns or 0) - said.stamp_ns < _GAP_NS
