"""A heading that the gyroscope alone carries along: what a start believed, whatever corrections have come since."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.numerics.rotation import euler_from_quat, quat_from_rotvec, quat_multiply

Array = NDArray[np.float64]


@dataclass(slots=True)
class CarriedHeading:
    """Attitude ``q`` (4,), body to ENU, at ``t`` [s]; whether it was the magnetometer's in the beginning."""

    t: float
    q: Array
    from_magnetometer: bool = True

    def hold(self, t: float, q: Array) -> None:
        """At ``t`` the attitude is ``q``."""
        self.t, self.q = t, q

    def carry(self, t: float, rate: Array) -> None:
        """Up to ``t`` the body turned at ``rate`` (3,) [rad/s], its own axes, bias taken off."""
        self.q = quat_multiply(self.q, quat_from_rotvec(rate * (t - self.t)))
        self.t = t

    @property
    def yaw(self) -> float:
        """Counter-clockwise from East [rad]."""
        return float(euler_from_quat(self.q)[2])
