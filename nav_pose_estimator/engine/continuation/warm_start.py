"""Warm start: first state of the filter from a saved state, after a restart in flight or a gap in the IMU data.

The motion during the gap is unknown.

* Position and velocity come from the first fix, which must lie where the vehicle can have moved. In an outage the saved
  ones are used, with a covariance enlarged by an unknown acceleration and an unknown turn.
* Tilt is found anew: from a specific force that is level, else from one that the acceleration by GNSS explains. In an
  outage, from a force that is not too far from level, with a deviation derived from its norm.
* Heading is the saved one with a covariance enlarged by an unknown turn, or that of a magnetometer with a known offset,
  or the present estimate of the heading hypotheses. It remains on trial, like every heading that motion has not
  confirmed. Where nothing gives a heading, a vehicle in calm flight starts without one, because GNSS gives its
  position; the covariance says so, and the trial ends with the first motion.
* Of an old state only the origin is used, so that the map stays the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.alignment.aligner import Aligner
from nav_pose_estimator.core.alignment.first_states import STEEPEST, in_motion, inclined
from nav_pose_estimator.core.alignment.heading_hypotheses import HeadingHypotheses
from nav_pose_estimator.core.alignment.levelling import (
    dipole_dip,
    field_doubt,
    level_in_motion,
    turned,
    unlevel,
)
from nav_pose_estimator.core.alignment.recent_rows import RecentRows
from nav_pose_estimator.core.alignment.types import Alignment, Fix
from nav_pose_estimator.core.earth.ellipsoid import cos_latitude, radii, step_enu
from nav_pose_estimator.core.filter.layout import BASE_STATES, D_GYRO_BIAS, DPOS, DVEL, IMU_T, PHI
from nav_pose_estimator.core.numerics.rotation import euler_from_quat, quat_rotate
from nav_pose_estimator.engine.continuation.saved_state import SavedState
from nav_pose_estimator.engine.parameters import Parameters

Array = NDArray[np.float64]

LONGEST = 60.0
"""s: longest gap in the IMU data over which a navigator continues."""
_SAME_MAP = 100e3  # m: an old origin is used within this distance
_LEVEL_TIME = 1.0  # s of IMU data that are averaged for a level in motion ...
_LEAST_LEVEL_TIME = 0.7  # ... and the part of it that must be present
_PATIENCE = 2.0  # s to wait for a fix before a start without one
_CALM = 0.2  # rad: within this apparent tilt a vehicle may start with an unknown heading ...
_LONGEST_SILENCE = 2.2  # s: ... after this time without a better one
_RETRY = 0.1  # s between two attempts
_GIVEN_UP = 5.0  # s after which a start with fixes is left to the ordinary alignment
_STEEPEST_UNAIDED = 0.8  # rad: beyond this apparent tilt there is no start in an outage
_FIELD_WINDOW = 0.15  # s of magnetometer data that are averaged: short, because the vehicle may turn
_LEAST_MOTION = 1.0  # s of GNSS before the estimate of the heading hypotheses is used
WIDEST_HEADING = 0.7
"""rad: largest standard deviation of a heading with which the filter normally starts."""
_MOVED, _BIASES = slice(DVEL, DPOS + 3), slice(D_GYRO_BIAS, BASE_STATES)
_UNKNOWN_HEADING = math.pi / math.sqrt(3.0)  # rad: standard deviation of a uniformly distributed heading


class _Attitude(NamedTuple):
    """``q`` (4,), the deviations of its tilt and heading [rad], and whether the magnetometer gave the heading."""

    q: Array
    tilt_sd: float
    yaw_sd: float
    from_magnetometer: bool


@dataclass(init=False, eq=False)
class WarmStart:
    """The warm start. It receives the alignment's data from the first IMU sample on; times are s since the epoch."""

    saved: SavedState
    is_own: bool
    """Whether the same process saved the state: an IMU gap and not a restart."""

    def __init__(self, saved: SavedState, t: float, parameters: Parameters, is_own: bool = False) -> None:
        """``t`` [s]: time of ``saved``."""
        self.saved, self._t, self.is_own = saved, t, is_own
        self.is_fresh = 0.0 < -t <= LONGEST  # else old, or of another clock and so of unknown age
        self._parameters = parameters
        self._rows = RecentRows()
        self._begun = math.inf  # time of the first IMU sample
        self._tried = -math.inf  # time of the last attempt
        self._biases = saved.biases

    def imu(self, row: Array) -> None:
        """Add one IMU row (7,)."""
        t = float(row[IMU_T])
        self._begun = min(self._begun, t)
        self._rows.rows.append(tuple(row.tolist()))
        self._rows.forget_before(t - 2.0 * _LEVEL_TIME)

    def contradiction(self, t: float, place: tuple[float, ...], sd: float) -> str:
        """Why the vehicle cannot have moved to ``place`` by ``t`` [s], one clause for the user; empty if it can.

        ``place`` is latitude, longitude [rad], height [m]; ``sd`` [m] its standard deviation.
        """
        limits = self._parameters.gnss.reacquisition
        gap = t - self._t
        apart = math.hypot(*step_enu(np.array(self.saved.position), np.array(place)).tolist())
        if not self.is_fresh:
            return f"GNSS is {1e-3 * apart:.0f} km from where it was saved" if apart > _SAME_MAP else ""
        own_sd = math.sqrt(self.saved.cov.diagonal()[DPOS : DPOS + 3].max())
        if apart <= limits.max_speed * gap + limits.sigmas * math.hypot(sd, own_sd):
            return ""
        return f"GNSS is {apart:.0f} m from where the vehicle was {gap:.1f} s before"

    def result(self, aligner: Aligner) -> Alignment | None:
        """The first state, None while there is none yet."""
        if not (self.is_fresh and self._rows.rows):
            return None
        own = self._own(aligner) if self.saved.is_sound else None
        if own is not None:
            return own
        return self._so_far(aligner.bank)

    def _so_far(self, bank: HeadingHypotheses | None) -> Alignment | None:
        """The estimate of the alignment's heading hypotheses, once its heading is good enough for the filter."""
        if bank is None or bank.time - bank.began < _LEAST_MOTION:
            return None
        if not bank.heading()[1] * math.sqrt(max(bank.nis, 1.0)) <= WIDEST_HEADING:
            return None
        nav, P = bank.merged()
        how = f"continues after {bank.time - self._t:.1f} s, heading from the motion so far"
        return Alignment(bank.time, nav, 0.5 * (P + P.T), how, continues=True, nis=bank.nis)

    def _own(self, aligner: Aligner) -> Alignment | None:
        """First state from the saved state and the present level."""
        now, fix = float(self._rows.rows[-1][IMU_T]), aligner.last_fix
        was_aided = self.saved.unaided <= self._parameters.navigator.lost_after
        waits = was_aided and now - self._begun < _LEVEL_TIME + _PATIENCE
        if was_aided and fix is not None and fix.t <= now:
            there, last_fix = self._completed(fix), None
        elif waits:
            return None
        else:
            there, last_fix = self._predicted(now), self._t - self.saved.unaided
        patience = _GIVEN_UP if last_fix is None else LONGEST + self._t - self._begun
        if there.t - self._tried < _RETRY or now - self._begun > patience:
            return None
        self._tried = there.t
        return self._first_state(there, aligner, last_fix)

    def _completed(self, fix: Fix) -> Fix:
        """``fix`` with the predicted velocity where it has none."""
        if fix.velocity is not None:
            return fix
        predicted = self._predicted(fix.t)
        return replace(fix, velocity=predicted.velocity, velocity_sd=predicted.velocity_sd)

    def _predicted(self, t: float) -> Fix:
        """Predicted position and velocity at ``t`` [s] of a vehicle with constant velocity, and their deviations."""
        saved, gap = self.saved, t - self._t
        deviations = np.sqrt(self._moved(t).diagonal())
        (lat, lon, alt), (east, north, up) = saved.position, (gap * v for v in saved.velocity)
        r_m, r_n = radii(lat)
        place = (lat + north / (r_m + alt), lon + east / ((r_n + alt) * cos_latitude(lat)), alt + up)
        return Fix(t, place, np.array(saved.velocity), deviations[3:], deviations[:3])

    def _moved(self, t: float) -> Array:
        """Covariance (6, 6) of velocity and position, ENU, predicted to ``t`` [s] with unknown motion in between.

        An unknown acceleration changes the velocity, and an unknown turn its direction. The change is limited by the
        vehicle's maximum speed. The position variance is that of a change at the beginning of the gap, the
        cross-covariance that of a change in its middle, as for a change at an unknown time.
        """
        saved, gap, navigator = self.saved, t - self._t, self._parameters.navigator
        transition = np.eye(6)
        transition[3:, :3] = gap * np.eye(3)
        turn = math.hypot(*saved.velocity[:2]) * min(navigator.gap_rate_sd * gap, 1.0)
        push = navigator.gap_force_sd * gap
        changed = np.minimum(np.hypot(push, [turn, turn, 0.0]), self._parameters.gnss.reacquisition.max_speed) ** 2
        added = np.kron([[1.0, 0.5 * gap], [0.5 * gap, gap**2]], np.diag(changed))
        return np.asarray(transition @ saved.cov[_MOVED, _MOVED] @ transition.T + added)

    def _wandered(self, t: float) -> Array:
        """Covariance (6, 6) of the IMU's biases, predicted to ``t`` [s] by their Gauss-Markov processes."""
        imu, gap = self._parameters.imu, t - self._t
        gyro, accel = (
            sd**2 * -math.expm1(-2.0 * gap / tau)
            for sd, tau in ((imu.gyro_bias_sd, imu.gyro_bias_tau), (imu.accel_bias_sd, imu.accel_bias_tau))
        )
        return self.saved.cov[_BIASES, _BIASES] + np.diag([gyro] * 3 + [accel] * 3)

    def _first_state(self, there: Fix, aligner: Aligner, last_fix: float | None) -> Alignment | None:
        rows = self._rows.between(there.t - _LEVEL_TIME, there.t)
        if len(rows) < 3 or rows[0, IMU_T] > there.t - _LEAST_LEVEL_TIME:
            return None
        off_level = unlevel(rows, self._biases.accel)
        if off_level <= (STEEPEST if last_fix is None else _STEEPEST_UNAIDED):
            found: _Attitude | None = self._levelled(there, rows, off_level, aligner)
        else:
            found = self._inclined(there, aligner)
        if found is None:
            return None
        # With fixes, an unknown heading makes the filter diverge in manoeuvres: wait, and accept it in calm flight.
        patience = math.inf if off_level > _CALM else _LONGEST_SILENCE
        silent = float(self._rows.rows[-1][IMU_T]) - self._begun
        if found.yaw_sd > WIDEST_HEADING and last_fix is None and silent < patience:
            return None
        q, tilt_sd, yaw_sd, from_magnetometer = found
        nav, P = in_motion(q, tilt_sd, there, self._biases, self._rows.at(there.t), False)
        P[PHI + 2, PHI + 2] = min(yaw_sd, _UNKNOWN_HEADING) ** 2
        P[_BIASES, _BIASES] = self._wandered(there.t)
        unseen = 0.0
        if last_fix is not None:
            P[_MOVED, _MOVED], unseen = self._moved(there.t), there.t - self._t
        how = f"continues after {there.t - self._t:.1f} s" + (
            ", heading from the magnetometer" if from_magnetometer else ""
        )
        return Alignment(there.t, nav, P, how, True, from_magnetometer, True, last_fix, unseen=unseen)

    def _levelled(self, there: Fix, rows: Array, off_level: float, aligner: Aligner) -> _Attitude:
        """Attitude from the mean force taken as vertical, with ``off_level`` [rad] as a deviation of the tilt."""
        # not the deviation that an attitude filter states, which is optimistic just after a start in flight
        tilt_sd = max(aligner.settings.tilt_sd, off_level)
        outside = aligner.outside.near(there.t, tilt_sd)
        q, stated_sd = outside or (level_in_motion(rows), tilt_sd)
        yaw, yaw_sd, from_magnetometer = self._heading(there, q, stated_sd, aligner)
        return _Attitude(turned(q, yaw), tilt_sd, yaw_sd, from_magnetometer)

    def _inclined(self, there: Fix, aligner: Aligner) -> _Attitude | None:
        """Attitude from the mean force and the acceleration by GNSS; None where these, or a heading, are not available.

        They leave a rotation about the force open. It is chosen so that the magnetic field agrees with the Earth's, or,
        where the saved heading is known better, so that the heading agrees with it.
        """
        attitudes = inclined(aligner.recent, self._rows, there, self._biases.accel)
        if attitudes is None:
            return None
        tilt_sd = aligner.settings.tilt_sd
        saved_sd, magnetic_sd = self._saved_heading_sd(there.t), aligner.settings.mag_heading_sd
        if saved_sd <= magnetic_sd or math.isnan(self.saved.compass_offset):
            saved = float(euler_from_quat(np.array(self.saved.q_nb))[2])
            away = [abs(math.remainder(float(euler_from_quat(q)[2]) - saved, 2.0 * math.pi)) for q in attitudes]
            return _Attitude(attitudes[int(np.argmin(away))], tilt_sd, math.hypot(saved_sd, tilt_sd), False)
        field = aligner.compass.field(there.t, _FIELD_WINDOW)
        if field is None:
            return None
        dip = dipole_dip(*there.position[:2])
        azimuth = 0.5 * math.pi - aligner.compass.declination - self.saved.compass_offset
        earth = (math.cos(dip) * math.cos(azimuth), math.cos(dip) * math.sin(azimuth), -math.sin(dip))
        q = max(attitudes, key=lambda q: float(quat_rotate(q, field) @ earth))
        if field_doubt(q, field, *there.position[:2]):
            return None
        return _Attitude(q, tilt_sd, math.hypot(magnetic_sd, tilt_sd * abs(math.tan(dip))), True)

    def _saved_heading_sd(self, t: float) -> float:
        """Standard deviation [rad] of the saved heading at ``t`` [s], after an unknown turn."""
        turn = self._parameters.navigator.gap_rate_sd * (t - self._t)
        return math.hypot(math.sqrt(self.saved.cov[PHI + 2, PHI + 2]), turn)

    def _heading(self, there: Fix, q_level: Array, tilt_sd: float, aligner: Aligner) -> tuple[float, float, bool]:
        """(yaw, its deviation [rad], whether it is from the magnetometer): the saved or the magnetic heading.

        A tilt error projects the vertical field into the horizontal plane, which adds to the magnetic heading's error.
        """
        saved, sd = self.saved, self._saved_heading_sd(there.t)
        magnetic_sd = aligner.settings.mag_heading_sd
        if sd > magnetic_sd and math.isfinite(saved.compass_offset):
            magnetic = aligner.compass.yaw(there.t, q_level, *there.position[:2], window=_FIELD_WINDOW)
            if magnetic is not None:
                by_tilt = tilt_sd * abs(math.tan(dipole_dip(*there.position[:2])))
                return magnetic - saved.compass_offset, math.hypot(magnetic_sd, by_tilt), True
        return float(euler_from_quat(np.array(saved.q_nb))[2]), sd, False
