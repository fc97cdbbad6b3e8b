"""Outputs of the estimators. Messages are created once and refilled; rates are limited by stamp time."""

from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped, TwistWithCovarianceStamped, Vector3Stamped
from nav_msgs.msg import Odometry
from rclpy.node import Node
from sensor_msgs.msg import Imu, NavSatFix
from std_msgs.msg import Bool

from nav_pose_estimator.engine.navigator.modes import DENIED
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.imu import ImuParameters
from nav_pose_estimator.engine.solutions import AttitudeSolution, NavSolution, PredictedDrift
from nav_pose_estimator.ros import qos
from nav_pose_estimator.ros.messages import installed, outgoing
from nav_pose_estimator.ros.messages.steady_twist import SteadyTwist
from nav_pose_estimator.ros.pace import Pace


class ImuVariances:
    """Variances of the published rate and specific force: white noise over one interval, and the remaining bias."""

    def __init__(self, parameters: ImuParameters) -> None:
        self._parameters = parameters
        self._last_ns, self._interval = 0, 0.0

    def at(self, stamp_ns: int) -> tuple[float, float] | None:
        """Variances of one axis of rate [(rad/s)^2] and force [(m/s^2)^2]; None while the interval is unknown.

        Must be called with every sample: the mean over dt of white noise of density N has the variance N^2 / dt.
        """
        p, dt = self._parameters, 1e-9 * (stamp_ns - self._last_ns)
        self._last_ns = stamp_ns
        if 0.0 < dt <= p.gap:
            self._interval = dt
        if self._interval == 0.0:
            return None
        rate = p.gyro_noise**2 / self._interval + p.gyro_bias_sd**2
        return rate, p.accel_noise**2 / self._interval + p.accel_bias_sd**2


class AttitudeOutput:
    """The topic imu/data."""

    def __init__(self, node: Node, parameters: Parameters) -> None:
        self._variances = ImuVariances(parameters.imu)
        self._world_frame = parameters.attitude.world_frame
        self._pace = Pace(parameters.ros.output.attitude_rate)
        self._publisher = qos.advertise(node, Imu, "imu/data")
        self._message = Imu()
        self._message.header.frame_id = parameters.ros.frames.base_link

    def publish(self, solution: AttitudeSolution) -> None:
        """Publish ``solution`` if it is due."""
        variances = self._variances.at(solution.stamp_ns)
        if self._pace.is_due(solution.stamp_ns) and qos.has_subscriber(self._publisher):
            outgoing.fill_imu(self._message, solution, self._world_frame, variances)
            self._publisher.publish(self._message)


class NavigationOutput:
    """The topics odometry/filtered, gps/filtered, ~/pose, ~/origin, ~/bias/*, gnss/denied and /tf."""

    def __init__(self, node: Node, parameters: Parameters) -> None:
        frames, rates = parameters.ros.frames, parameters.ros.output
        self._odometry = qos.advertise(node, Odometry, "odometry/filtered")
        self._pose = qos.advertise(node, PoseWithCovarianceStamped, "~/pose")
        self._fix = qos.advertise(node, NavSatFix, "gps/filtered")
        self._origin = qos.advertise(node, NavSatFix, "~/origin", qos.latched())
        self._denied = qos.advertise(node, Bool, "gnss/denied", qos.latched())
        self._gyro_bias = qos.advertise(node, Vector3Stamped, "~/bias/gyro")
        self._accel_bias = qos.advertise(node, Vector3Stamped, "~/bias/accel")
        self._tf = Transforms(node, frames) if frames.publish_tf else None
        self._odometry_pace = Pace(rates.odometry_rate)
        self._twist = SteadyTwist(rates.velocity_slew)
        self._fix_pace, self._bias_pace = Pace(rates.fix_rate), Pace(rates.bias_rate)
        self._odometry_message = Odometry(child_frame_id=frames.base_link)
        self._odometry_message.header.frame_id = frames.odom
        self._pose_message, self._fix_message = PoseWithCovarianceStamped(), NavSatFix()
        self._pose_message.header.frame_id = self._map = frames.map
        self._bias_message = Vector3Stamped()
        self._fix_message.header.frame_id = self._bias_message.header.frame_id = frames.base_link
        self._published_origin: tuple[float, float, float] | None = None
        self._is_denied: bool | None = None

    def publish(self, solution: NavSolution) -> None:
        """Publish ``solution`` on every topic where it is due."""
        stamp = solution.stamp_ns
        self._publish_denied(solution.mode in DENIED)
        self._twist.take(solution)
        if self._odometry_pace.is_due(stamp):
            if qos.has_subscriber(self._odometry):
                outgoing.fill_odometry(self._odometry_message, solution, self._twist.offset)
                self._odometry.publish(self._odometry_message)
            if qos.has_subscriber(self._pose):
                outgoing.fill_pose(self._pose_message, solution)
                self._pose.publish(self._pose_message)
            if self._tf is not None:
                self._tf.publish(solution)
        if self._fix_pace.is_due(stamp) and qos.has_subscriber(self._fix):
            outgoing.fill_fix(self._fix_message, solution)
            self._fix.publish(self._fix_message)
        if self._bias_pace.is_due(stamp):
            for publisher, bias in ((self._gyro_bias, solution.gyro_bias), (self._accel_bias, solution.accel_bias)):
                outgoing.fill_vector_stamped(self._bias_message, stamp, bias)
                publisher.publish(self._bias_message)

    def publish_origin(self, stamp_ns: int, origin: tuple[float, float, float] | None) -> None:
        """Publish the origin of map (latitude, longitude [rad], ellipsoid height [m]) if it is new."""
        if origin is None or origin == self._published_origin:
            return
        self._published_origin = origin
        message = NavSatFix()
        message.header.frame_id = self._map
        outgoing.fill_origin(message, stamp_ns, origin)
        self._origin.publish(message)

    def _publish_denied(self, denied: bool) -> None:
        if denied != self._is_denied:
            self._is_denied = denied
            self._denied.publish(Bool(data=denied))


class LearnerOutput:
    """The topics outage/velocity_error and outage/position_error."""

    def __init__(self, node: Node, parameters: Parameters) -> None:
        self._velocity = qos.advertise(node, TwistWithCovarianceStamped, "outage/velocity_error")
        self._position = qos.advertise(node, Vector3Stamped, "outage/position_error")
        self._velocity_message, self._position_message = TwistWithCovarianceStamped(), Vector3Stamped()
        self._velocity_message.header.frame_id = self._position_message.header.frame_id = parameters.ros.frames.odom

    def publish(self, drift: PredictedDrift) -> None:
        """Publish a predicted velocity error and the position error accumulated in this outage."""
        outgoing.fill_velocity_error(self._velocity_message, drift)
        self._velocity.publish(self._velocity_message)
        outgoing.fill_vector_stamped(self._position_message, drift.stamp_ns, np.array(drift.dp_n))
        self._position.publish(self._position_message)


class Transforms:
    """The transforms map -> odom -> base_link on /tf."""

    def __init__(self, node: Node, frames: Any) -> None:
        wanted = "ros.frames.publish_tf is true"
        self._kind = installed.message_class("tf2_msgs/msg/TFMessage", wanted, "set it to false")
        self._publisher = qos.advertise(node, self._kind, "/tf")
        self._jumps, self._motion = TransformStamped(), TransformStamped()
        self._jumps.header.frame_id, self._jumps.child_frame_id = frames.map, frames.odom
        self._motion.header.frame_id, self._motion.child_frame_id = frames.odom, frames.base_link

    def publish(self, solution: NavSolution) -> None:
        """Publish both transforms of ``solution``."""
        moved = solution.position_enu - solution.correction_enu
        outgoing.fill_transform(self._jumps, solution.stamp_ns, np.asarray(solution.correction_enu))
        outgoing.fill_transform(self._motion, solution.stamp_ns, moved, solution.q_nb)
        self._publisher.publish(self._kind(transforms=[self._jumps, self._motion]))
