"""Body velocity input of the attitude filter: wheel odometry or a Doppler log separates acceleration from gravity.

The change of such a velocity, resolved in n, is the vehicle's acceleration including the centripetal part: the specific
force without the reaction to gravity. It needs no GNSS.
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

_LARGEST_SPEED = 1e3  # m/s: a larger velocity is not used
_GAP_NS = 1_000_000_000  # velocities further apart give no acceleration; an older navigator velocity no longer counts


class BodyVelocityInput:
    """Receives body velocities for one attitude filter, with the mounting of ``aids.body_velocity_*``."""

    def __init__(self, parameters: Parameters) -> None:
        aids = parameters.aids
        self._enabled = aids.body_velocity
        self._axes, self._lever = rotation_from_rpy(aids.body_velocity_rpy), np.array(aids.body_velocity_lever)

    def take(self, sample: BodyVelocity, memory: Memory) -> list[Event]:
        """Pass one sample to the filter of ``memory``; returns the event of a rejection."""
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
    """Whether the navigator provides the velocity change; its velocity already includes GNSS or this very sensor."""
    velocity = memory.velocity
    return velocity is not None and velocity.valid and (memory.last_ns or 0) - velocity.stamp_ns < _GAP_NS
