"""Hard iron, soft iron and mounting of a magnetometer, from how its field turns against the gyroscope.

The field of the place is constant, so that seen from the vehicle it obeys dm/dt = -w x m: between two times the
calibrated field turns as the gyroscope does, whatever GNSS, declination and place are; and its strength stays. With
``b = R P (I + S) (m - h)`` (h hard iron, S symmetric and of trace zero, P one of the 48 ways to lay three axes along
three others, R a small rotation) the residuals are ``b_1 - C b_2`` and ``|b| - F``; weak priors keep what the recording
does not show, and the posterior deviations tell what that is.

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

from nav_pose_estimator.core.numerics.rotation import quat_from_rotvec, quat_to_matrix
from nav_pose_estimator.offline.calibration.field_pairs import LAG, FieldPairs

_PRIOR_SD = np.r_[np.full(3, 100.0), np.full(5, 0.15), np.full(3, 0.3), 15.0]  # h [uT], S, rotation [rad], F [uT]
_USUAL_STRENGTH = 48.0  # uT
_SEEN_IRON = 2.0  # uT: a tenth of a usual horizontal field
_SEEN_SHAPE = 0.05
_SEEN_ANGLE = math.radians(4.0)
_CLEARER = 1.3  # times: the second best way to lay the axes must fit worse than the best by this
_OVERLAP = LAG / 0.1  # pairs that share a time share its errors


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
        """Along which sensor axes (3,) the hard iron is known."""
        return np.asarray(self.iron_sd < _SEEN_IRON)

    @property
    def sees_shape(self) -> bool:
        """Whether the soft iron is known."""
        return self.shape_sd < _SEEN_SHAPE

    @property
    def sees_mounting(self) -> bool:
        """Whether the mounting is known."""
        return self.axes_are_clear and self.angle_sd < _SEEN_ANGLE


def fit_field(pairs: FieldPairs) -> FieldFit:
    """The calibration that ``pairs`` show best; what they do not show stays near none."""
    axes, clear = _axes(pairs)
    noise = 1.0
    start = np.r_[_hard_iron(pairs, axes), np.zeros(8), _USUAL_STRENGTH]
    for _ in range(2):
        found = least_squares(_residuals, start, args=(pairs, axes, noise), loss="soft_l1")
        start = found.x
        data = _residuals(found.x, pairs, axes, 1.0)[: -len(_PRIOR_SD)]
        noise = max(1.4826 * float(np.median(np.abs(data))), 0.05) * math.sqrt(_OVERLAP)
    h, shape, turn, strength = _unpacked(found.x)
    covariance = np.linalg.inv(found.jac.T @ found.jac)
    sd = np.sqrt(covariance.diagonal())
    mirror = bool(np.linalg.det(axes) < 0.0)
    flip = np.diag([1.0, 1.0, -1.0]) if mirror else np.eye(3)
    fit = FieldFit(
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
    return fit


def _ways() -> list[np.ndarray]:
    """The 48 signed permutation matrices (3, 3), the identity first."""
    signs = list(itertools.product((1.0, -1.0), repeat=3))
    return [np.diag(s) @ np.eye(3)[list(p)] for p in itertools.permutations(range(3)) for s in signs]


def _axes(pairs: FieldPairs) -> tuple[np.ndarray, bool]:
    """How the sensor's axes lie along the IMU's (3, 3), and whether no other way fits about as well.

    Gyroscope and dip decide among 48 ways, half of them mirror images, which are a driver's mistake.
    """
    misfits = []
    for way in _ways():
        if np.linalg.det(way) > 0.0:
            misfit = _turned_back(pairs, way) - _apart(pairs) @ way @ _hard_iron(pairs, way)
            misfits.append((float(np.sqrt(np.mean(misfit**2))), way))
    (best, way), (second, _) = sorted(misfits, key=lambda one: one[0])[:2]
    # a field reversed as a whole turns in the same way: the dip tells
    downward = np.sum((pairs.before - _hard_iron(pairs, way)) @ way.T * pairs.down)
    return (-way if downward < 0.0 else way), second > _CLEARER * best


def _turned_back(pairs: FieldPairs, way: np.ndarray) -> np.ndarray:
    return np.asarray(pairs.before @ way.T - np.einsum("nij,nj->ni", pairs.turn, pairs.after @ way.T))


def _apart(pairs: FieldPairs) -> np.ndarray:
    return np.asarray(np.eye(3) - pairs.turn)


def _hard_iron(pairs: FieldPairs, way: np.ndarray) -> np.ndarray:
    """Hard iron (3,) [uT], sensor axes, that fits best for axes that lie as ``way`` says: linear least squares."""
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
    """Rms angle [deg] by which the field turns otherwise than the gyroscope says."""
    before, after = (pairs.before - h) @ matrix.T, (pairs.after - h) @ matrix.T
    after = np.einsum("nij,nj->ni", pairs.turn, after)
    cosine = np.sum(before * after, axis=1) / np.linalg.norm(before, axis=1) / np.linalg.norm(after, axis=1)
    return math.degrees(math.sqrt(float(np.mean(np.arccos(np.clip(cosine, -1.0, 1.0)) ** 2))))
