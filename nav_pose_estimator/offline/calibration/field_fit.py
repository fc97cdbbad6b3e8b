"""Hard iron, soft iron and mounting of a magnetometer, estimated by comparison with the rotation of the gyroscope.

The local magnetic field is constant, so that in the body frame it obeys dm/dt = -w x m. Between two times the
calibrated field rotates as the gyroscope measures, and its strength is constant, independently of GNSS, declination and
place. With ``b = R P (I + S) (m - h)`` (h hard iron, S symmetric and of trace zero, P one of the 48 signed permutations
of the axes, R a small rotation) the residuals are ``b_1 - C b_2`` and ``|b| - F``. Weak priors determine what the
recording does not make observable, which the posterior standard deviations reveal.

Published ideas: V. Renaudin et al., Complete triaxis magnetometer calibration in the magnetic domain, Journal of
Sensors, 2010 (ellipsoid); M. Kok and T. Schoen, Magnetometer calibration using inertial sensors, IEEE Sensors Journal
16(14), 2016.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import least_squares

from nav_pose_estimator.core.numerics.order import MAD_TO_SD
from nav_pose_estimator.core.numerics.rotation import quat_from_rotvec, quat_to_matrix
from nav_pose_estimator.offline.calibration.field_pairs import LAG, FieldPairs

_PRIOR_SD = np.r_[np.full(3, 100.0), np.full(5, 0.15), np.full(3, 0.3), 15.0]  # h [uT], S, rotation [rad], F [uT]
_USUAL_STRENGTH = 48.0  # uT: prior of the strength
# Standard deviations below which a part of the calibration counts as observed
_SEEN_IRON = 2.0  # uT: a tenth of a usual horizontal field
_SEEN_SHAPE = 0.05  # elements of S
_SEEN_ANGLE = math.radians(4.0)
_CLEARER = 1.3  # smallest ratio of the second best residual to the best for an unambiguous permutation of the axes
_OVERLAP = LAG / 0.1  # number of pairs that overlap in time, and so have correlated errors


@dataclass(frozen=True)
class FieldFit:
    """``matrix`` (3, 3) and ``hard_iron`` (3,) [uT] in ``b = matrix (m - h)``, in the IMU's axes as published.

    ``soft_iron`` (3, 3) and ``rotation`` (3, 3) are its factors (rotation soft_iron), the second one proper.
    Deviations: ``iron_sd`` (3,) [uT] of h along the sensor's axes, ``shape_sd`` of S, ``angle_sd`` [rad] of R.
    """

    hard_iron: np.ndarray
    soft_iron: np.ndarray
    rotation: np.ndarray
    strength: float
    iron_sd: np.ndarray
    shape_sd: float
    angle_sd: float
    axes_are_clear: bool
    is_mirror: bool
    before_deg: float
    after_deg: float

    @property
    def sees_iron(self) -> np.ndarray:
        """Whether the hard iron is observed along each axis of the sensor (3,)."""
        return np.asarray(self.iron_sd < _SEEN_IRON)

    @property
    def sees_shape(self) -> bool:
        """Whether the soft iron is observed."""
        return self.shape_sd < _SEEN_SHAPE

    @property
    def sees_mounting(self) -> bool:
        """Whether the mounting is observed."""
        return self.axes_are_clear and self.angle_sd < _SEEN_ANGLE


def fit_field(pairs: FieldPairs) -> FieldFit:
    """Estimate the calibration from ``pairs``; what they do not make observable stays close to zero."""
    axes, clear = _axes(pairs)
    noise = 1.0
    start = np.r_[_hard_iron(pairs, axes), np.zeros(8), _USUAL_STRENGTH]
    for _ in range(2):
        found = least_squares(_residuals, start, args=(pairs, axes, noise), loss="soft_l1")
        start = found.x
        data = _residuals(found.x, pairs, axes, 1.0)[: -len(_PRIOR_SD)]
        noise = max(MAD_TO_SD * float(np.median(np.abs(data))), 0.05) * math.sqrt(_OVERLAP)
    h, shape, turn, strength = _unpacked(found.x)
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    sd = np.sqrt(covariance.diagonal())
    mirror = bool(np.linalg.det(axes) < 0.0)
    flip = np.diag([1.0, 1.0, -1.0]) if mirror else np.eye(3)
    return FieldFit(
        hard_iron=h,
        soft_iron=flip @ shape,
        rotation=turn @ axes @ flip,
        strength=strength,
        iron_sd=sd[:3],
        shape_sd=float(sd[3:8].max()),
        angle_sd=float(sd[8:11].max()),
        axes_are_clear=clear,
        is_mirror=mirror,
        before_deg=_direction_error(pairs, np.eye(3), np.zeros(3)),
        after_deg=_direction_error(pairs, turn @ axes @ shape, h),
    )


def _ways() -> list[np.ndarray]:
    """The 48 signed permutation matrices (3, 3), the identity first."""
    signs = list(itertools.product((1.0, -1.0), repeat=3))
    return [np.diag(s) @ np.eye(3)[list(p)] for p in itertools.permutations(range(3)) for s in signs]


def _axes(pairs: FieldPairs) -> tuple[np.ndarray, bool]:
    """Signed permutation (3, 3) from the sensor's axes to those of the IMU, and whether it is unambiguous.

    Gyroscope and dip select one of 48, half of which are mirror images, due to a mistake in a driver.
    """
    misfits = []
    for way in _ways():
        if np.linalg.det(way) > 0.0:
            misfit = _turned_back(pairs, way) - _apart(pairs) @ way @ _hard_iron(pairs, way)
            misfits.append((float(np.sqrt(np.mean(misfit**2))), way))
    (best, way), (second, _) = sorted(misfits, key=lambda one: one[0])[:2]
    # a reversed field rotates in the same way; only the dip distinguishes it
    downward = np.sum((pairs.before - _hard_iron(pairs, way)) @ way.T * pairs.down)
    return (-way if downward < 0.0 else way), second > _CLEARER * best


def _turned_back(pairs: FieldPairs, way: np.ndarray) -> np.ndarray:
    return np.asarray(pairs.before @ way.T - np.einsum("nij,nj->ni", pairs.turn, pairs.after @ way.T))


def _apart(pairs: FieldPairs) -> np.ndarray:
    return np.asarray(np.eye(3) - pairs.turn)


def _hard_iron(pairs: FieldPairs, way: np.ndarray) -> np.ndarray:
    """Hard iron (3,) [uT] in sensor axes by linear least squares, for the permutation ``way`` of the axes."""
    apart, difference = _apart(pairs), _turned_back(pairs, way)
    normal = np.einsum("nij,nik->jk", apart, apart) + np.eye(3) * len(pairs) / _PRIOR_SD[0] ** 2
    return np.asarray(way.T @ np.linalg.solve(normal, np.einsum("nij,ni->j", apart, difference)))


def _unpacked(x: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """h (3,) [uT], I + S (3, 3), R (3, 3), F [uT]."""
    xx, yy, xy, xz, yz = x[3:8]
    shape = np.eye(3) + np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, -xx - yy]])
    return x[:3], shape, quat_to_matrix(quat_from_rotvec(x[8:11])), float(x[11])


def _residuals(x: np.ndarray, pairs: FieldPairs, axes: np.ndarray, noise: float) -> np.ndarray:
    h, shape, turn, strength = _unpacked(x)
    matrix = turn @ axes @ shape
    before, after = (pairs.before - h) @ matrix.T, (pairs.after - h) @ matrix.T
    difference = before - np.einsum("nij,nj->ni", pairs.turn, after)
    norm = np.linalg.norm(before, axis=1) - strength
    prior = (x - np.r_[np.zeros(11), _USUAL_STRENGTH]) / _PRIOR_SD
    return np.r_[difference.ravel() / noise, norm / noise, prior]


def _direction_error(pairs: FieldPairs, matrix: np.ndarray, h: np.ndarray) -> float:
    """Rms angle [deg] between the rotation of the calibrated field and that of the gyroscope."""
    before, after = (pairs.before - h) @ matrix.T, (pairs.after - h) @ matrix.T
    after = np.einsum("nij,nj->ni", pairs.turn, after)
    cosine = np.sum(before * after, axis=1) / np.linalg.norm(before, axis=1) / np.linalg.norm(after, axis=1)
    return math.degrees(math.sqrt(float(np.mean(np.arccos(np.clip(cosine, -1.0, 1.0)) ** 2))))
