"""Conversion of solutions to the messages of autopilots. Independent of rclpy: the caller creates and publishes them.

Every channel reuses one message. ``begin`` is called with the first solution after every pause in sending.
"""

import math
from typing import Any, Protocol

import numpy as np

from nav_pose_estimator.core.earth.gps_time import week_and_milliseconds
from nav_pose_estimator.core.filter.layout import DPOS, DVEL, PHI
from nav_pose_estimator.core.numerics.axes import FRD_FLU
from nav_pose_estimator.core.numerics.rotation import quat_to_matrix
from nav_pose_estimator.engine.parameters.ros import RosParameters
from nav_pose_estimator.engine.solutions import NavSolution
from nav_pose_estimator.ros.autopilot.frames import NED_ENU, attitude_frd_to_ned, px4_north_east
from nav_pose_estimator.ros.autopilot.px4_clock import Px4Clock, Px4Reference
from nav_pose_estimator.ros.messages.outgoing import fill_odometry, fill_stamp

_FIX_3D, _SATELLITES_UNKNOWN = 3, 255  # mavros_msgs/GPSINPUT
_IGNORE_HDOP, _IGNORE_VDOP = 2, 4  # GPS_INPUT_IGNORE_FLAGS of MAVLink
_DOP_UNKNOWN = 99.99  # a value that no reader takes for a good DOP, even if it overlooks the flags
_NED = 1  # POSE_FRAME_NED and VELOCITY_FRAME_NED of px4_msgs/VehicleOdometry
_UNKNOWN_HEIGHT_VAR = 1e4  # m^2: variance of the height where the height of PX4's reference is unknown


class Channel(Protocol):
    """A kind of message to an autopilot."""

    message: Any

    def begin(self, solution: NavSolution) -> None:
        """Start sending with ``solution``, for the first time or after a pause."""

    def fill(self, solution: NavSolution) -> None:
        """Write ``solution`` into ``message``."""


class MavrosOdometry:
    """nav_msgs/Odometry for the plugin ``odometry`` of MAVROS, which converts it to NED and FRD itself.

    MAVROS looks up the transforms FRAME -> FRAME_ned and CHILD -> CHILD_frd, so the frame names must be those of
    MAVROS. The twist is in the child frame. MAVROS transmits neither a reset counter nor a quality. Therefore the
    position starts at the best estimate (map), and does not jump until sending stops (odom).
    """

    def __init__(self, message: Any, parameters: RosParameters) -> None:
        self.message = message
        message.header.frame_id = parameters.frames.odom
        message.child_frame_id = parameters.frames.base_link
        self._begun_at = np.zeros(3)

    def begin(self, solution: NavSolution) -> None:
        """Start at the corrected position; later corrections are not applied."""
        self._begun_at = np.array(solution.correction_enu)

    def fill(self, solution: NavSolution) -> None:
        """Write the pose in a frame without jumps while sending, and the twist in the body, both with covariance."""
        fill_odometry(self.message, solution)
        position = self.message.pose.pose.position
        east, north, up = self._begun_at.tolist()
        position.x, position.y, position.z = position.x + east, position.y + north, position.z + up


class MavrosGps:
    """mavros_msgs/GPSINPUT for the plugin ``gps_input`` of MAVROS, which ArduPilot reads as a receiver of type 14."""

    def __init__(self, message: Any, parameters: RosParameters) -> None:
        self.message = message
        message.header.frame_id = parameters.frames.base_link
        message.gps_id = parameters.output.autopilot_gps_id
        message.fix_type, message.satellites_visible = _FIX_3D, _SATELLITES_UNKNOWN
        message.ignore_flags = _IGNORE_HDOP | _IGNORE_VDOP
        message.hdop = message.vdop = _DOP_UNKNOWN
        message.yaw = 0  # not given
        self._geoid = parameters.output.autopilot_geoid

    def begin(self, solution: NavSolution) -> None:
        """Do nothing: the message has no reset counter, and its position may jump."""

    def fill(self, solution: NavSolution) -> None:
        """Write position, height above sea level, velocity NED, accuracies (root of summed variances), GPS time."""
        message = self.message
        fill_stamp(message.header.stamp, solution.stamp_ns)
        message.time_week, message.time_week_ms = week_and_milliseconds(solution.stamp_ns)
        message.lat = round(math.degrees(solution.lat) * 1e7)
        message.lon = round(math.degrees(solution.lon) * 1e7)
        message.alt = solution.alt - self._geoid
        message.vn, message.ve, message.vd = (NED_ENU @ solution.vel_n).tolist()
        position_var, velocity_var = _variances(solution, DPOS), _variances(solution, DVEL)
        message.horiz_accuracy = math.sqrt(float(position_var[0] + position_var[1]))
        message.vert_accuracy = math.sqrt(float(position_var[2]))
        message.speed_accuracy = math.sqrt(float(velocity_var.sum()))


class Px4Odometry:
    """px4_msgs/VehicleOdometry for /fmu/in/vehicle_visual_odometry: NED and FRD in PX4's own local frame and time.

    Until PX4 has published the reference of its local frame, the position is NaN, which the message defines as unknown,
    and only velocity and attitude are valid. The reset counter increases with every start of sending, every reset of
    the position and every new reference of PX4.
    """

    def __init__(self, message: Any, parameters: RosParameters) -> None:
        self.message = message
        message.pose_frame = message.velocity_frame = _NED
        self.clock = Px4Clock()
        self.reference: Px4Reference | None = None
        self._used: Px4Reference | None = None
        geoid = parameters.output.autopilot_geoid
        self._geoid = geoid if parameters.output.knows_geoid else None
        self._own_resets = 0

    def begin(self, solution: NavSolution) -> None:
        """Announce a reset, so that EKF2 does not compare the new position with the one before the pause."""
        self._own_resets += 1

    def fill(self, solution: NavSolution) -> None:
        """Write position, attitude, velocity and angular rate with their variances."""
        message = self.message
        message.timestamp = message.timestamp_sample = self.clock.stamp_us(solution.stamp_ns)
        if self.reference != self._used:
            self._used = self.reference
            self._own_resets += 1
        message.reset_counter = (solution.reset_count + self._own_resets) % 256
        self._fill_position(solution)
        message.q[:] = attitude_frd_to_ned(solution.q_nb)
        message.velocity[:] = NED_ENU @ solution.vel_n
        message.angular_velocity[:] = FRD_FLU * solution.rate_b
        C_nb = quat_to_matrix(solution.q_nb)
        message.orientation_variance[:] = np.diag(C_nb.T @ solution.cov[PHI : PHI + 3, PHI : PHI + 3] @ C_nb)
        message.velocity_variance[:] = _variances(solution, DVEL)[[1, 0, 2]]

    def _fill_position(self, solution: NavSolution) -> None:
        message, at = self.message, self.reference
        variance = _variances(solution, DPOS)[[1, 0, 2]]
        message.quality = quality(math.sqrt(float(variance[0] + variance[1])))
        if at is None:
            message.position[:] = message.position_variance[:] = math.nan
            return
        ref = math.radians(at.lat_deg), math.radians(at.lon_deg)
        if self._geoid is None or at.height_amsl is None:
            down = -float(solution.position_enu[2])
            variance[2] += _UNKNOWN_HEIGHT_VAR
        else:
            down = at.height_amsl - (solution.alt - self._geoid)
        message.position[:] = (*px4_north_east(solution.lat, solution.lon, *ref), down)
        message.position_variance[:] = variance


def quality(horizontal_sigma: float) -> int:
    """Quality for EKF2_EV_QMIN, from 1 (worst) to 100: 100 divided by sigma in metres. Zero would mean unknown."""
    return int(min(max(100.0 / max(horizontal_sigma, 1e-3), 1.0), 100.0))


def _variances(solution: NavSolution, first: int) -> np.ndarray:
    """Copy (3,) of the variances East, North, Up from index ``first`` of the covariance."""
    return np.array(np.diag(solution.cov)[first : first + 3])
