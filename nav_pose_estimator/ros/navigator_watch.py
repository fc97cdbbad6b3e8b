"""The navigator as another node sees it: odometry, biases, origin and IMU put together to navigation solutions again.

What the topics do not say is stated wide: the deviation of the accelerometer bias is its steady state, correlations
between groups of states are zero but for those of position and attitude.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import enu_to_lla
from nav_pose_estimator.core.filter.layout import BASE_STATES, D_ACCEL_BIAS, D_GYRO_BIAS, DPOS, DVEL, PHI
from nav_pose_estimator.core.numerics.rotation import quat_to_matrix
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import ImuSample, Vector3
from nav_pose_estimator.engine.sensors.imu import ImuInput
from nav_pose_estimator.engine.solutions import Event, Level, Mode, NavSolution
from nav_pose_estimator.ros.messages import covariance
from nav_pose_estimator.ros.messages.convert import quaternion, stamp_ns, vector


@dataclass(frozen=True, slots=True)
class OdometrySample:
    """A nav_msgs/Odometry: position in odom, attitude, velocity and rate in the body; covariances (6, 6)."""

    stamp_ns: int
    position: Vector3
    q_nb: tuple[float, float, float, float]
    velocity_b: Vector3
    rate_b: Vector3
    pose_cov: np.ndarray
    twist_cov: np.ndarray


def odometry(message: Any) -> tuple[OdometrySample | Event, ...]:
    """nav_msgs/Odometry to :class:`OdometrySample`; an event where it lacks orientation, numbers or covariances."""
    stamp, pose, twist = stamp_ns(message), message.pose, message.twist
    q_nb = quaternion(pose.pose.orientation)
    position, velocity, rate = vector(pose.pose.position), vector(twist.twist.linear), vector(twist.twist.angular)
    covs = covariance.read(pose.covariance, 6).matrix, covariance.read(twist.covariance, 6).matrix
    if q_nb is None or covs[0] is None or covs[1] is None or not all(map(math.isfinite, position + velocity + rate)):
        text = "an odometry message lacks its orientation, its covariance or a number; not used"
        return (Event(stamp, "odometry.rejected.incomplete", Level.WARN, text),)
    return (OdometrySample(stamp, position, q_nb, velocity, rate, covs[0], covs[1]),)


class NavigatorWatch:
    """Collects what the topics say and gives one solution for each odometry, as soon as all is known that it needs."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self.origin: tuple[float, float, float] | None = None
        self.gyro_bias: np.ndarray | None = None
        self.accel_bias: np.ndarray | None = None
        self.denied = True  # until the navigator says that GNSS aids it
        self.reset()

    def reset(self) -> None:
        """Forget the stream of samples; what the navigator said for good stays."""
        self._door = ImuInput(self._parameters.imu)
        self._forces: list[Vector3] = []
        self._last_ns = 0

    @property
    def waiting_for(self) -> str:
        """The topic that is still missing; empty when none is."""
        missing = (
            ("the origin of the navigator", self.origin is None),
            ("the navigator's biases", self.gyro_bias is None or self.accel_bias is None),
            ("odometry/filtered", self._last_ns == 0),
        )
        return next((name for name, is_missing in missing if is_missing), "")

    def imu(self, sample: ImuSample) -> list[Event]:
        """Keep a specific force until the next odometry."""
        events: list[Event] = []
        for item in self._door.accept(sample):
            if isinstance(item, Event):
                events.append(item)
            else:
                self._forces.append(item.accel)
        return events

    def odometry(self, sample: OdometrySample) -> NavSolution | None:
        """The solution at ``sample``; None while something is missing, or for a stamp that is not newer.

        Its specific force is the mean since the last odometry: what an integrating accelerometer would say.
        """
        is_newer, self._last_ns = sample.stamp_ns > self._last_ns, max(sample.stamp_ns, self._last_ns)
        forces, self._forces = self._forces, []
        if not (is_newer and forces) or self.origin is None or self.gyro_bias is None or self.accel_bias is None:
            return None
        q_nb, position = np.array(sample.q_nb), np.array(sample.position)
        C_nb = quat_to_matrix(q_nb)
        lat, lon, alt = (float(x) for x in enu_to_lla(position, *self.origin))
        return NavSolution.of(
            stamp_ns=sample.stamp_ns,
            mode=Mode.DEAD_RECKONING if self.denied else Mode.AIDED,
            lat=lat,
            lon=lon,
            alt=alt,
            vel_n=C_nb @ np.array(sample.velocity_b),
            q_nb=q_nb,
            rate_b=np.array(sample.rate_b),
            force_b=np.mean(forces, axis=0) - self.accel_bias,
            gyro_bias=self.gyro_bias.copy(),
            accel_bias=self.accel_bias.copy(),
            cov=self._covariance(sample, C_nb),
            position_enu=position,
            correction_enu=np.zeros(3),
            reset_count=0,
        )

    def _covariance(self, sample: OdometrySample, C_nb: np.ndarray) -> np.ndarray:
        P, pose, twist = np.zeros((BASE_STATES, BASE_STATES)), sample.pose_cov, sample.twist_cov
        P[DPOS : DPOS + 3, DPOS : DPOS + 3] = pose[:3, :3]
        P[PHI : PHI + 3, PHI : PHI + 3] = pose[3:, 3:]
        P[DPOS : DPOS + 3, PHI : PHI + 3] = -pose[:3, 3:]
        P[PHI : PHI + 3, DPOS : DPOS + 3] = -pose[3:, :3]
        P[DVEL : DVEL + 3, DVEL : DVEL + 3] = C_nb @ twist[:3, :3] @ C_nb.T
        P[D_GYRO_BIAS : D_GYRO_BIAS + 3, D_GYRO_BIAS : D_GYRO_BIAS + 3] = twist[3:, 3:]
        accel = slice(D_ACCEL_BIAS, D_ACCEL_BIAS + 3)
        P[accel, accel] = self._parameters.imu.accel_bias_sd**2 * np.eye(3)
        return P
