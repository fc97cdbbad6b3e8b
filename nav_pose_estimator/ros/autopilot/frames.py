"""ENU and FLU (REP-103) to NED and FRD, the axes of autopilots, and PX4's own map projection. Each turn is its own
inverse."""

import math

import numpy as np

from nav_pose_estimator.core.numerics.rotation import quat_multiply

NED_ENU = np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""Turns vectors from ENU to NED and back: half a turn about the axis between East and North."""
FRD_FLU = np.diag([1.0, -1.0, -1.0])
"""Turns vectors from FLU to FRD and back: half a turn about the nose."""
_Q_NED_ENU = np.array([0.0, math.sqrt(0.5), math.sqrt(0.5), 0.0])
_Q_FRD_FLU = np.array([0.0, 1.0, 0.0, 0.0])
_PX4_RADIUS = 6_371_000.0  # m: PX4 projects on a sphere


def attitude_frd_to_ned(q_nb: np.ndarray) -> np.ndarray:
    """(4,) scalar first, unit, w >= 0: from FRD to NED, of ``q_nb`` from FLU to ENU."""
    q = quat_multiply(quat_multiply(_Q_NED_ENU, q_nb), _Q_FRD_FLU)
    return np.asarray(q / math.copysign(float(np.linalg.norm(q)), q[0]))


def px4_north_east(lat: float, lon: float, ref_lat: float, ref_lon: float) -> tuple[float, float]:
    """North and East [m] of a position in PX4's local frame with the reference ``ref_lat``, ``ref_lon`` [rad].

    PX4's azimuthal equidistant projection of the sphere (Snyder, Map Projections, 1987, equations 22-4, 22-5, 25-2).
    PX4 turns its local position back to latitude and longitude with the same one; metres on the ellipsoid would come
    out up to 0.5 % off there.
    """
    cos_c = math.sin(ref_lat) * math.sin(lat) + math.cos(ref_lat) * math.cos(lat) * math.cos(lon - ref_lon)
    c = math.acos(min(max(cos_c, -1.0), 1.0))
    if c < 1e-7:  # acos has lost its digits: the plane is exact to nanometres
        return _PX4_RADIUS * (lat - ref_lat), _PX4_RADIUS * math.cos(ref_lat) * (lon - ref_lon)
    k = _PX4_RADIUS * c / math.sin(c)
    north = math.cos(ref_lat) * math.sin(lat) - math.sin(ref_lat) * math.cos(lat) * math.cos(lon - ref_lon)
    return k * north, k * math.cos(lat) * math.sin(lon - ref_lon)
