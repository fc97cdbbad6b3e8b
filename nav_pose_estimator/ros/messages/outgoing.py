"""Conversion of solutions to messages. Each function fills a message, of rclpy or rosbags, that the caller reuses.

REP-105: odometry is in odom, where base_link moves without jumps; all corrections of the position are in the transform
from map to odom. REP-103: East-North-Up and Forward-Left-Up; covariances are row-major in x, y, z and rotations about
the fixed axes.
"""

import math
from typing import Any

import numpy as np

from nav_pose_estimator.core.filter.layout import BASE_STATES, D_GYRO_BIAS, DPOS, DVEL, PHI
from nav_pose_estimator.core.numerics.rotation import quat_to_matrix, skew
from nav_pose_estimator.engine.solutions import AttitudeSolution, Mode, NavSolution, PredictedDrift
from nav_pose_estimator.engine.world_frame import attitude_in, vector_in
from nav_pose_estimator.ros.messages import steady_twist
from nav_pose_estimator.ros.messages.cdr import NS_PER_S

_STATUS_FIX, _STATUS_NO_FIX, _SERVICE_GPS = 0, -1, 1  # sensor_msgs/NavSatStatus
_COVARIANCE_UNKNOWN, _COVARIANCE_KNOWN = 0, 3  # sensor_msgs/NavSatFix
_NO_ROTATION = np.array([1.0, 0.0, 0.0, 0.0])


def fill_stamp(stamp: Any, stamp_ns: int) -> None:
    """Fill a builtin_interfaces/Time."""
    stamp.sec, stamp.nanosec = divmod(int(stamp_ns), NS_PER_S)


def fill_imu(
    message: Any,
    solution: AttitudeSolution,
    world_frame: str = "enu",
    variances: tuple[float, float] | None = None,
) -> None:
    """Fill a sensor_msgs/Imu: orientation, bias-corrected angular rate and specific force (REP-145).

    ``variances`` per axis of rate [(rad/s)^2] and of specific force [(m/s^2)^2]; None leaves them unknown (zeros).
    """
    fill_stamp(message.header.stamp, solution.stamp_ns)
    q_nb, cov_n = attitude_in(world_frame, solution.q_nb, solution.cov_n)
    _fill_quaternion(message.orientation, q_nb)
    message.orientation_covariance[:] = cov_n.ravel()
    _fill_vector(message.angular_velocity, vector_in(world_frame, solution.rate_b))
    _fill_vector(message.linear_acceleration, vector_in(world_frame, solution.accel_b))
    if variances is not None:  # equal on all axes, and so in every frame
        rate, force = variances
        message.angular_velocity_covariance[0::4] = [rate] * 3
        message.linear_acceleration_covariance[0::4] = [force] * 3


def fill_odometry(message: Any, solution: NavSolution, velocity_offset: np.ndarray | None = None) -> None:
    """Fill a nav_msgs/Odometry: pose in odom with the covariance of the pose in map, twist in base_link.

    ``velocity_offset`` (3,) [m/s] in b is added to the velocity, and its outer product to the covariance.
    """
    fill_stamp(message.header.stamp, solution.stamp_ns)
    C_nb = quat_to_matrix(solution.q_nb)
    _fill_vector(message.pose.pose.position, solution.position_enu - solution.correction_enu)
    _fill_quaternion(message.pose.pose.orientation, solution.q_nb)
    message.pose.covariance[:] = pose_covariance(solution.cov).ravel()
    velocity, cov = C_nb.T @ solution.vel_n, twist_covariance(solution.cov, C_nb, solution.vel_n)
    if velocity_offset is not None:
        velocity += velocity_offset
        cov[:3, :3] += np.outer(velocity_offset, velocity_offset)
    _fill_vector(message.twist.twist.linear, velocity)
    _fill_vector(message.twist.twist.angular, solution.rate_b)
    message.twist.covariance[:] = cov.ravel()


def fill_pose(message: Any, solution: NavSolution) -> None:
    """Fill a geometry_msgs/PoseWithCovarianceStamped in map: the best estimate, including jumps."""
    fill_stamp(message.header.stamp, solution.stamp_ns)
    _fill_vector(message.pose.pose.position, solution.position_enu)
    _fill_quaternion(message.pose.pose.orientation, solution.q_nb)
    message.pose.covariance[:] = pose_covariance(solution.cov).ravel()


def fill_fix(message: Any, solution: NavSolution) -> None:
    """Fill a sensor_msgs/NavSatFix with the position of base_link, which continues in an outage.

    The status is FIX while GNSS aids the navigator. Otherwise it is NO_FIX without a satellite service; the covariance
    remains valid until the mode is EXPIRED, from where on it is marked as unknown.
    """
    fill_stamp(message.header.stamp, solution.stamp_ns)
    status = message.status
    status.status, status.service = (_STATUS_FIX, _SERVICE_GPS) if solution.mode is Mode.AIDED else (_STATUS_NO_FIX, 0)
    message.latitude, message.longitude = math.degrees(solution.lat), math.degrees(solution.lon)
    message.altitude = float(solution.alt)
    message.position_covariance[:] = solution.cov[DPOS : DPOS + 3, DPOS : DPOS + 3].ravel()
    expired = solution.mode is Mode.EXPIRED
    message.position_covariance_type = _COVARIANCE_UNKNOWN if expired else _COVARIANCE_KNOWN


def fill_origin(message: Any, stamp_ns: int, origin: tuple[float, float, float]) -> None:
    """Fill a sensor_msgs/NavSatFix with the origin of map (latitude, longitude [rad], ellipsoid height [m])."""
    fill_stamp(message.header.stamp, stamp_ns)
    message.status.status, message.status.service = _STATUS_FIX, _SERVICE_GPS
    message.latitude, message.longitude, message.altitude = math.degrees(origin[0]), math.degrees(origin[1]), origin[2]


def fill_vector_stamped(message: Any, stamp_ns: int, values: np.ndarray) -> None:
    """Fill a geometry_msgs/Vector3Stamped with ``values`` (3,)."""
    fill_stamp(message.header.stamp, stamp_ns)
    _fill_vector(message.vector, values)


def fill_transform(message: Any, stamp_ns: int, translation: np.ndarray, q: np.ndarray | None = None) -> None:
    """Fill a geometry_msgs/TransformStamped; ``q`` (4,) scalar first, None for no rotation."""
    fill_stamp(message.header.stamp, stamp_ns)
    _fill_vector(message.transform.translation, translation)
    _fill_quaternion(message.transform.rotation, _NO_ROTATION if q is None else q)


def pose_covariance(P: np.ndarray) -> np.ndarray:
    """Covariance (6, 6) of position and rotation about the axes of map, from the filter's covariance ``P``.

    The filter's attitude error phi has the opposite sign of the rotation error, so that the cross terms change sign.
    """
    cov = np.empty((6, 6))
    cov[:3, :3] = P[DPOS : DPOS + 3, DPOS : DPOS + 3]
    cov[3:, 3:] = P[PHI : PHI + 3, PHI : PHI + 3]
    cov[:3, 3:] = -P[DPOS : DPOS + 3, PHI : PHI + 3]
    cov[3:, :3] = cov[:3, 3:].T
    return cov


def twist_covariance(P: np.ndarray, C_nb: np.ndarray, vel_n: np.ndarray) -> np.ndarray:
    """Covariance (6, 6) of velocity and angular rate in b, from the filter's covariance ``P``.

    v_b = C' v_n gives dv_b = C' (dv - [v x] phi), and the error of the rate is that of the gyroscope bias. The white
    noise of the gyroscope is not included.
    """
    turn, bias = C_nb.T @ skew(vel_n), slice(D_GYRO_BIAS, D_GYRO_BIAS + 3)
    half = C_nb.T @ P[DVEL : DVEL + 3] - turn @ P[PHI : PHI + 3]  # covariance of dv_b with every state
    cov = np.empty((6, 6))
    cov[:3, :3] = half[:, DVEL : DVEL + 3] @ C_nb - half[:, PHI : PHI + 3] @ turn.T
    cov[:3, 3:] = half[:, bias]
    cov[3:, :3] = cov[:3, 3:].T
    cov[3:, 3:] = P[bias, bias]
    return cov


def warm_up() -> None:
    """Call the kernels that messages need, so that they are compiled."""
    pose_covariance(np.eye(BASE_STATES))
    twist_covariance(np.eye(BASE_STATES), quat_to_matrix(_NO_ROTATION), np.zeros(3))
    steady_twist.warm_up()


def fill_velocity_error(message: Any, error: PredictedDrift) -> None:
    """Fill a geometry_msgs/TwistWithCovarianceStamped, ENU; the angular part is marked as unknown."""
    fill_stamp(message.header.stamp, error.stamp_ns)
    _fill_vector(message.twist.twist.linear, np.array(error.dv_n))
    cov = np.zeros((6, 6))
    cov[:3, :3] = error.cov
    cov[3, 3] = -1.0
    message.twist.covariance[:] = cov.ravel()


def is_finite(solution: NavSolution | AttitudeSolution | PredictedDrift) -> bool:
    """Whether all numbers for the messages are finite; a node publishes no others."""
    if isinstance(solution, PredictedDrift):
        return math.isfinite(sum(solution.dv_n + solution.dp_n) + float(solution.cov.sum()))
    few: tuple[np.ndarray, ...]
    if isinstance(solution, AttitudeSolution):
        few, cov = (solution.q_nb, solution.rate_b, solution.accel_b), solution.cov_n
    else:
        few, cov = (solution.position_enu, solution.vel_n, solution.q_nb, solution.rate_b), solution.cov
    # for three numbers the sum of a list takes a tenth of numpy's time
    return math.isfinite(float(cov.sum()) + sum(sum(part.tolist()) for part in few))


def _fill_vector(target: Any, values: np.ndarray) -> None:
    target.x, target.y, target.z = values.tolist()


def _fill_quaternion(target: Any, q: np.ndarray) -> None:
    target.w, target.x, target.y, target.z = q.tolist()
