"""Conversion of attitudes between ENU with body FLU and NED with body FRD, for the boundary to ROS."""

import numpy as np

from nav_pose_estimator.core.numerics.axes import FRD_FLU

_HALF = np.sqrt(0.5)


def attitude_in(world_frame: str, q_nb: np.ndarray, cov_n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Attitude ``q_nb`` (4,) (FLU to ENU) and its covariance (3, 3) about n axes, for ``world_frame`` enu or ned.

    For ned the quaternion is from FRD to NED (REP-145, ``imu_link_ned``). The conversion is its own inverse.
    """
    if world_frame == "enu":
        return q_nb, cov_n
    w, x, y, z = q_nb
    # q_ned = t (x) q_enu (x) r: t swaps East and North and inverts Up, r is the half turn FLU -> FRD about x.
    q = np.array([-_HALF * (w + z), -_HALF * (x + y), _HALF * (y - x), _HALF * (z - w)])
    order = [1, 0, 2]
    sign = np.array([1.0, 1.0, -1.0])
    return (q if q[0] >= 0.0 else -q), cov_n[np.ix_(order, order)] * np.outer(sign, sign)


def vector_in(world_frame: str, body: np.ndarray) -> np.ndarray:
    """A body vector in FLU for ``world_frame`` enu, in FRD for ned."""
    return body if world_frame == "enu" else body * FRD_FLU
