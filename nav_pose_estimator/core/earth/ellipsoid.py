"""WGS-84 ellipsoid, Earth rotation, normal gravity, and conversions between geodetic, ECEF and local ENU positions.

Latitude and longitude are in radians, height above the ellipsoid in metres. ``radii``, ``gravity`` and ``earth_rate_n``
are kernels for one point, ``radii_many`` and ``gravity_many`` their numpy forms for arrays. The conversions at the end
take scalars and arrays alike.

East and North are undefined at the poles. ``cos_latitude`` is therefore limited to ``MIN_COS_LAT``: within 0.64 km of
a pole results stay finite, but East rates are wrong.

Sources: NIMA TR8350.2 (WGS-84), third edition, chapters 3 and 4; P. Groves, "Principles of GNSS, Inertial and
Multisensor Integrated Navigation Systems", second edition, equations 2.105, 2.106, 2.112, 2.123, 2.134, 2.139, 5.44.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nav_pose_estimator.core.numerics.jit import inlined, kernel

Array = NDArray[np.float64]

A = 6378137.0
"""Semi-major axis, m."""
F = 1.0 / 298.257223563
"""Flattening."""
B = A * (1.0 - F)
"""Semi-minor axis, m."""
E2 = F * (2.0 - F)
"""First eccentricity squared."""
OMEGA = 7.292115e-5
"""Rate of rotation, rad/s."""
GM = 3.986004418e14
"""Geocentric gravitational constant, the mass of the atmosphere included, m^3/s^2."""
GAMMA_E = 9.7803253359
"""Normal gravity at the equator on the ellipsoid, m/s^2."""
SOMIGLIANA_K = 0.00193185265241
"""Constant of Somigliana's formula."""
GRAVITY_M = OMEGA * OMEGA * A * A * B / GM
"""Ratio of centrifugal acceleration to gravity at the equator (m of WGS-84)."""
MIN_COS_LAT = 1e-4
"""Lower limit of ``cos_latitude``."""


# --- kernels for one point -----------------------------------------------------------------------------------------
@inlined
def radii(lat):
    """(R_M, R_N): radii of curvature in the meridian and in the prime vertical [m]."""
    s = math.sin(lat)
    w2 = 1.0 - E2 * s * s
    R_N = A / math.sqrt(w2)
    return R_N * (1.0 - E2) / w2, R_N


@inlined
def cos_latitude(lat):
    """Cosine of the latitude, at least ``MIN_COS_LAT``."""
    return max(math.cos(lat), MIN_COS_LAT)


@inlined
def gravity(lat, h):
    """Normal gravity [m/s^2], positive down: Somigliana's formula with the free-air terms up to h^2."""
    s = math.sin(lat)
    return gravity_from_sine(s * s, h)


@inlined
def gravity_from_sine(s2, h):
    """``gravity`` from the squared sine of the latitude."""
    surface = GAMMA_E * (1.0 + SOMIGLIANA_K * s2) / math.sqrt(1.0 - E2 * s2)
    x = h / A
    return surface * (1.0 - 2.0 * (1.0 + F + GRAVITY_M - 2.0 * F * s2) * x + 3.0 * x * x)


@kernel
def earth_rate_n(lat):
    """w_ie_n (3,) [rad/s]: rotation of the Earth resolved in n."""
    return np.array((0.0, OMEGA * math.cos(lat), OMEGA * math.sin(lat)))


@inlined
def ecef_of(lat, lon, h):
    """``lla_to_ecef`` of one position as a tuple, for the inside of kernels."""
    _, R_N = radii(lat)
    p = (R_N + h) * math.cos(lat)
    return p * math.cos(lon), p * math.sin(lon), (R_N * (1.0 - E2) + h) * math.sin(lat)


@inlined
def enu_of(lat, lon, h, origin_lat, origin_lon, origin_h):
    """``lla_to_enu`` of one position as a tuple, for the inside of kernels."""
    x, y, z = ecef_of(lat, lon, h)
    x0, y0, z0 = ecef_of(origin_lat, origin_lon, origin_h)
    dx, dy, dz = x - x0, y - y0, z - z0
    sl, cl, so, co = math.sin(origin_lat), math.cos(origin_lat), math.sin(origin_lon), math.cos(origin_lon)
    outward = co * dx + so * dy
    return co * dy - so * dx, cl * dz - sl * outward, cl * outward + sl * dz


@inlined
def step_of(lat0, lon0, h0, lat, lon, h):
    """``step_enu`` as a tuple, for the inside of kernels."""
    r_m, r_n = radii(lat)
    east = lon - lon0
    if abs(east) > math.pi:  # across the 180th meridian
        east -= math.copysign(2.0 * math.pi, east)
    return east * (r_n + h) * math.cos(lat), (lat - lat0) * (r_m + h), h - h0


# --- numpy forms for arrays ----------------------------------------------------------------------------------------
def radii_many(lat: ArrayLike) -> tuple[Array, Array]:
    """``radii`` of latitudes (...)."""
    w2 = 1.0 - E2 * np.sin(lat) ** 2
    R_N = A / np.sqrt(w2)
    return R_N * (1.0 - E2) / w2, R_N


def gravity_many(lat: ArrayLike, h: ArrayLike) -> Array:
    """``gravity`` at latitudes and heights (...)."""
    s2 = np.sin(lat) ** 2
    surface = GAMMA_E * (1.0 + SOMIGLIANA_K * s2) / np.sqrt(1.0 - E2 * s2)
    x = np.asarray(h, dtype=float) / A
    return surface * (1.0 - 2.0 * (1.0 + F + GRAVITY_M - 2.0 * F * s2) * x + 3.0 * x * x)


# --- coordinate conversions ----------------------------------------------------------------------------------------
def lla_to_ecef(lat: ArrayLike, lon: ArrayLike, h: ArrayLike) -> Array:
    """ECEF positions (..., 3) [m] of geodetic positions: ``lat``, ``lon`` [rad], ``h`` [m] (...)."""
    _, R_N = radii_many(lat)
    h = np.asarray(h, dtype=float)
    p = (R_N + h) * np.cos(lat)
    x, y, z = np.broadcast_arrays(p * np.cos(lon), p * np.sin(lon), (R_N * (1.0 - E2) + h) * np.sin(lat))
    return np.stack((x, y, z), axis=-1)


def ecef_to_lla(position: ArrayLike) -> tuple[Array, Array, Array]:
    """Latitude, longitude [rad] and height [m] (...) of ECEF positions (..., 3) [m].

    Three iterations of Bowring's formula for the parametric latitude. The error is below 1e-8 m from 50 km under the
    ellipsoid to beyond geostationary orbit, poles included.
    """
    x, y, z = np.moveaxis(np.asarray(position, dtype=float), -1, 0)
    p = np.hypot(x, y)
    parametric = np.arctan2(z, (1.0 - F) * p)
    for _ in range(3):
        up = z + E2 / (1.0 - E2) * B * np.sin(parametric) ** 3
        out = p - E2 * A * np.cos(parametric) ** 3
        lat = np.arctan2(up, out)
        parametric = np.arctan2((1.0 - F) * np.sin(lat), np.cos(lat))
    h = p * np.cos(lat) + z * np.sin(lat) - A * np.sqrt(1.0 - E2 * np.sin(lat) ** 2)
    return lat, np.arctan2(y, x), h


def ecef_to_enu_matrix(lat: ArrayLike, lon: ArrayLike) -> Array:
    """C_ne (..., 3, 3): its rows are East, North and Up at (lat, lon) [rad] in ECEF axes."""
    lat, lon = np.broadcast_arrays(np.asarray(lat, dtype=float), np.asarray(lon, dtype=float))
    sl, cl, so, co = np.sin(lat), np.cos(lat), np.sin(lon), np.cos(lon)
    rows = ((-so, co, np.zeros_like(so)), (-sl * co, -sl * so, cl), (cl * co, cl * so, sl))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def lla_to_enu(
    lat: ArrayLike, lon: ArrayLike, h: ArrayLike, origin_lat: float, origin_lon: float, origin_h: float
) -> Array:
    """Positions (..., 3) [m] in the Cartesian East-North-Up frame tangent to the ellipsoid at the origin; exact."""
    offset = lla_to_ecef(lat, lon, h) - lla_to_ecef(origin_lat, origin_lon, origin_h)
    return offset @ ecef_to_enu_matrix(origin_lat, origin_lon).T


def enu_to_lla(enu: ArrayLike, origin_lat: float, origin_lon: float, origin_h: float) -> tuple[Array, Array, Array]:
    """Latitude, longitude [rad] and height [m] (...) of positions (..., 3) [m] in the frame of ``lla_to_enu``."""
    offset = np.asarray(enu, dtype=float) @ ecef_to_enu_matrix(origin_lat, origin_lon)
    return ecef_to_lla(offset + lla_to_ecef(origin_lat, origin_lon, origin_h))


def step_enu(before: Sequence[float] | Array, after: Sequence[float] | Array) -> Array:
    """Displacement (3,) [m, ENU] between two geodetic positions (3,) [rad, rad, m] that are close to each other."""
    return np.array(step_of(*map(float, before), *map(float, after)))
