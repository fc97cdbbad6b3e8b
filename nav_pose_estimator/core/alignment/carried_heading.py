"""Attitude propagated by the gyroscope alone: the heading of a start, without the corrections that came later."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.numerics.rotation import euler_from_quat, quat_from_rotvec, quat_multiply

Array = NDArray[np.float64]


@dataclass(slots=True)
class CarriedHeading:
    """Attitude ``q`` (4,), body to ENU, at ``t`` [s], and whether its heading came from the magnetometer."""

    t: float
    q: Array
    from_magnetometer: bool = True

    def hold(self, t: float, q: Array) -> None:
        """Set the attitude at ``t`` [s] to ``q`` (4,)."""
        self.t, self.q = t, q

    def carry(self, t: float, rate: Array) -> None:
        """Propagate to ``t`` [s] with the bias-free angular rate ``rate`` (3,) [rad/s] in b."""
        self.q = quat_multiply(self.q, quat_from_rotvec(rate * (t - self.t)))
        self.t = t

    @property
    def yaw(self) -> float:
        """Yaw [rad], counter-clockwise from East."""
        return float(euler_from_quat(self.q)[2])
