"""Conversion of velocity and attitude to the axes of autopilots, NED and FRD, and PX4's map projection."""

import math

import numpy as np

from nav_pose_estimator.core.numerics.axes import Q_FRD_FLU, Q_NED_ENU
from nav_pose_estimator.core.numerics.rotation import quat_multiply

NED_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Matrix (3, 3) from ENU to NED and back."""
_PX4_RADIUS = 6_371_000.0  # m: radius of the sphere that PX4 projects on


def attitude_frd_to_ned(q_nb: np.ndarray) -> np.ndarray:
    """Unit quaternion (4,), scalar first and not negative, from FRD to NED, for ``q_nb`` from FLU to ENU."""
    q = quat_multiply(quat_multiply(Q_NED_ENU, q_nb), Q_FRD_FLU)
    return np.asarray(q / math.copysign(float(np.linalg.norm(q)), q[0]))


def px4_north_east(lat: float, lon: float, ref_lat: float, ref_lon: float) -> tuple[float, float]:
    """North and East [m] of a position in PX4's local frame with the reference ``ref_lat``, ``ref_lon`` [rad].

    Azimuthal equidistant projection of the sphere (Snyder, Map Projections, 1987, equations 22-4, 22-5, 25-2). PX4
    converts local positions back to latitude and longitude with the same projection. Distances on the ellipsoid would
    therefore be wrong by up to 0.5 %.
    """
    cos_c = math.sin(ref_lat) * math.sin(lat) + math.cos(ref_lat) * math.cos(lat) * math.cos(lon - ref_lon)
    c = math.acos(min(max(cos_c, -1.0), 1.0))
    if c < 1e-7:  # acos is inaccurate near 1, and the tangent plane is accurate to nanometres
        return _PX4_RADIUS * (lat - ref_lat), _PX4_RADIUS * math.cos(ref_lat) * (lon - ref_lon)
    k = _PX4_RADIUS * c / math.sin(c)
    north = math.cos(ref_lat) * math.sin(lat) - math.sin(ref_lat) * math.cos(lat) * math.cos(lon - ref_lon)
    return k * north, k * math.cos(lat) * math.sin(lon - ref_lon)
