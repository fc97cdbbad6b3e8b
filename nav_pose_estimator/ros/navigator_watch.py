"""Conversion of a navigator's nav_msgs/Odometry to the input of a learner in another node."""

import math
from typing import Any

from nav_pose_estimator.engine.outage.remote import OdometrySample
from nav_pose_estimator.engine.solutions import Event, Level
from nav_pose_estimator.ros.messages import covariance
from nav_pose_estimator.ros.messages.convert import quaternion, stamp_ns, vector


def odometry(message: Any) -> tuple[OdometrySample | Event, ...]:
    """nav_msgs/Odometry to :class:`OdometrySample`; an event where it lacks orientation, numbers or covariances."""
    stamp, pose, twist = stamp_ns(message), message.pose, message.twist
    q_nb = quaternion(pose.pose.orientation)
    position, velocity, rate = vector(pose.pose.position), vector(twist.twist.linear), vector(twist.twist.angular)
    covs = covariance.read(pose.covariance, 6).matrix, covariance.read(twist.covariance, 6).matrix
    if q_nb is None or covs[0] is None or covs[1] is None or not all(map(math.isfinite, position + velocity + rate)):
        text = "an odometry message has no orientation, no covariance, or values that are not finite; not used"
        return (Event(stamp, "odometry.rejected.incomplete", Level.WARN, text),)
    return (OdometrySample(stamp, position, q_nb, velocity, rate, covs[0], covs[1]),)
