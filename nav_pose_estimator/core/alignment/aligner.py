"""Start-up alignment: first navigation state and covariance from raw IMU, GNSS and magnetometer data.

There are three procedures; the data decide which one applies:

* at rest: roll and pitch from the mean specific force, gyroscope bias from the mean rate, heading from the
  magnetometer when its field is plausible;
* at rest without a magnetometer: level and gyroscope bias are kept, and the heading comes from the first motion;
* in motion: a coarse level from the mean specific force, or the tilt of an attitude filter where one is available. A
  bank of heading hypotheses (``heading_hypotheses``) then processes the fixes until its heading is known well enough.
  A plausible magnetometer only sets the prior of the bank: without calibration it may be wrong by any angle.

A fix is processed at its time of validity, which may lie in the past. The result is valid at the last fix (in motion)
or at the last IMU sample (at rest); a navigator that starts from it replays the IMU from there.
"""

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.alignment.first_states import STEEPEST, from_level, heading_prior, in_motion, inclined
from nav_pose_estimator.core.alignment.fix_motion import FixMotion
from nav_pose_estimator.core.alignment.heading_hypotheses import HeadingHypotheses
from nav_pose_estimator.core.alignment.levelling import (
    Compass,
    OutsideLevels,
    level_attitude,
    level_covariance,
    level_in_motion,
    unlevel,
)
from nav_pose_estimator.core.alignment.recent_rows import RecentRows
from nav_pose_estimator.core.alignment.rest import RestDetector, RestSettings
from nav_pose_estimator.core.alignment.types import (
    VERTICAL_SHARE,
    Alignment,
    AlignmentSettings,
    Fix,
    FixNoise,
    KnownBiases,
    RestLevel,
    fix_velocity,
)
from nav_pose_estimator.core.filter.constants import make_constants
from nav_pose_estimator.core.filter.layout import (
    ALT,
    DPOS,
    IMU_T,
    LAT,
    PHI,
)
from nav_pose_estimator.core.filter.measurement_noise import Fixed

Array = NDArray[np.float64]

_LEVEL_WINDOW = 1.0  # s of IMU data over which the specific force is averaged for a level in motion
_LEVEL_AGE = 20.0  # s: an older levelling at rest is dropped, because the IMU rows since then have to be kept
_FILLED = 0.7  # smallest part of that window that has to hold data
_RENEWAL = 0.1  # part of the levelling window after which a level at rest is computed again
_NOISE_LEFT = 0.2  # part of the rate's scatter at rest that its mean over the window still has
_AWAY = 5.0  # m: how far the vehicle may have moved since the level at rest
_FIX_AGE = 2.0  # s: an older fix does not give the position of a resting vehicle
_RECENT = 20  # fixes with a velocity that are kept, more than one second of them
_ZERO = (0.0, 0.0, 0.0)
_REST_FORCE = 0.8  # m/s^2: largest difference of the mean force's norm from gravity at rest
# rad/s: largest mean rate at rest beside a known bias. A bias does not drift this far; a smooth circle turns faster.
_KNOWN_RATE = 0.03
_RESIDUAL_RATE_SD = 2e-4  # rad/s: standard deviation of the gyroscope bias after a levelling at rest
_LOST_NIS = 12.0  # mean NIS per degree of freedom above which the bank has diverged and is restarted
_LOST_UPDATES = 25  # fixes before that test applies
_bank_constants = partial(
    make_constants,
    gyro_bias_sd=1e-4,
    gyro_bias_tau=300.0,
    accel_bias_sd=0.02,
    accel_bias_tau=300.0,
    covariance_period=0.05,
    gap_dt=0.1,
    gap_rate_sd=0.3,
    gap_accel_sd=2.0,
)
"""Constants of the bank's filters, whose biases hardly change until the heading is known."""


@dataclass(init=False, eq=False, slots=True)
class Aligner:
    """The alignment. It takes samples in order of arrival until ``result`` returns one; times are s since the epoch."""

    settings: AlignmentSettings
    noise: FixNoise
    restarts: int
    """How often the bank of hypotheses diverged and was restarted."""
    compass: Compass
    """Receives the magnetic field."""
    outside: OutsideLevels
    """Receives the attitudes of another estimator, whose tilt improves a start in motion."""
    last_fix: Fix | None
    recent: deque[Fix]
    """The latest fixes with a velocity, oldest first."""
    _constants: Array
    _lever: Array
    _biases: KnownBiases
    _rest: RestDetector
    _rows: RecentRows
    _fixes: deque[Fix]
    _motion: FixMotion
    _now: float
    _level: RestLevel | None
    bank: HeadingHypotheses | None
    """The heading hypotheses; None before a start in motion."""
    _from_rest: bool
    _done: Alignment | None

    def __init__(self, settings: AlignmentSettings, noise: FixNoise | None = None) -> None:
        """``noise``: noise models of the fixes; without it their stated deviations are used as they are."""
        s = self.settings = settings
        self.noise = noise or FixNoise(Fixed(), Fixed())
        self._constants = _bank_constants(gyro_noise=s.gyro_noise, accel_noise=s.accel_noise)
        self._lever = np.array(s.lever_arm, dtype=float)
        self._biases = s.known or KnownBiases(_ZERO, _ZERO, s.gyro_bias_sd, s.accel_bias_sd)
        rate = s.rest_rate if s.known is None else _KNOWN_RATE
        self._rest = RestDetector(
            RestSettings(s.static_window, s.rest_gyro_sd, s.rest_accel_sd, rate, _REST_FORCE, offset=self._biases.gyro)
        )
        self._rows = RecentRows()
        self._fixes = deque()
        self.recent = deque(maxlen=_RECENT)
        self._motion = FixMotion(s.rest_speed)
        self.compass = Compass(s.declination)
        self.outside = OutsideLevels()
        self._now = -math.inf
        self.last_fix = self._level = self.bank = self._done = None
        self._from_rest = False
        self.restarts = 0

    # --- samples -----------------------------------------------------------------------------------------------------

    def imu(self, t: float, gyro: np.ndarray, accel: np.ndarray) -> None:
        """One IMU sample: rate [rad/s] and specific force [m/s^2] in b."""
        if t <= self._now or self.is_complete:
            return
        self._now = t
        wx, wy, wz, fx, fy, fz = *map(float, gyro), *map(float, accel)
        row = (float(t), wx, wy, wz, fx, fy, fz)
        self._rows.rows.append(row)
        self._rest.update(t, gyro, accel)
        while self._fixes and self._fixes[0].t <= t:
            self._take(self._fixes.popleft())
        if self.is_complete:
            return
        if self._is_resting():
            self._learn_from_rest()
        else:
            self._done = None  # an attitude found at rest is void once the vehicle moves
        oldest = t - _LEVEL_WINDOW - _FIX_AGE
        if self._level is not None and t - self._level.t < _LEVEL_AGE:
            oldest = min(self._level.t, oldest)
        self._rows.forget_before(oldest if self.bank is None else self.bank.time)

    def gnss(
        self,
        t_valid: float,
        lat: float,
        lon: float,
        alt: float,
        vel_enu: Sequence[float] | None,
        pos_sd: float,
        vel_sd: float,
        height_sd: float = 0.0,
    ) -> None:
        """One fix valid at ``t_valid`` [s].

        ``lat``, ``lon`` [rad], ``alt`` [m]; ``vel_enu`` (3,) [m/s] or None, its vertical component NaN if missing;
        ``pos_sd`` (horizontal), ``height_sd`` [m] and ``vel_sd`` [m/s] are the stated standard deviations.
        """
        if self.last_fix is not None and t_valid <= self.last_fix.t:
            return
        period = 1.0 if self.last_fix is None else min(t_valid - self.last_fix.t, 1.0)
        velocity, velocity_sd = fix_velocity(vel_enu, vel_sd, period)
        position_sd = np.array([pos_sd, pos_sd, max(VERTICAL_SHARE * pos_sd, height_sd)])
        fix = Fix(t_valid, (lat, lon, alt), velocity, position_sd, velocity_sd)
        self.last_fix = fix
        self._motion.note(fix)
        if velocity is not None:
            self.recent.append(fix)
        if t_valid <= self._now:
            self._take(fix)
        else:
            self._fixes.append(fix)

    def set_declination(self, declination: float) -> None:
        """Set the magnetic declination [rad], east positive."""
        self.settings = replace(self.settings, declination=declination)
        self.compass.declination = declination

    def go_on_without_magnetometer(self) -> None:
        """Discard the result and align again with the heading from motion alone."""
        self.compass, self._done = Compass(self.settings.declination), None

    def is_stale(self, patience: float) -> bool:
        """Whether the last fix is more than ``patience`` [s] older than the IMU."""
        return self.last_fix is not None and self._now - self.last_fix.t > patience

    # --- outcome -----------------------------------------------------------------------------------------------------

    def result(self) -> Alignment | None:
        """The alignment once it is accurate enough, else None; without a position where only GNSS is missing."""
        return self._done

    def waiting_for(self) -> str:
        """One sentence for the user: what the alignment is waiting for; empty once it is complete."""
        if self.is_complete:
            return ""
        if self._done is not None:
            return "Level and heading are known; waiting for a GNSS fix."
        if not self._rows.rows:
            return "Waiting for IMU data."
        fix = self.last_fix
        if fix is None:
            rest = "" if self._rest.at_rest else f" or rest with a magnetometer ({self._rest.why_not()})"
            return f"Waiting for a GNSS fix{rest}."
        if self.bank is not None:
            _, sd = self.bank.heading()
            limit = math.degrees(self.settings.heading_sd)
            return (
                f"Finding the heading from motion: known to {math.degrees(sd):.0f} deg, needed to {limit:.0f} deg; "
                "speed up, brake or turn."
            )
        if self._is_resting():
            return f"Level is known; heading needs motion, because there is {self.compass.doubt}."
        if self._rest.at_rest:
            return "The IMU is at rest, but GNSS reports motion; waiting for them to agree, or for acceleration."
        return "Waiting for GNSS to show the vehicle's motion."

    @property
    def is_complete(self) -> bool:
        """True once the result has a position; later samples change nothing."""
        return self._done is not None and self._done.has_position

    # --- rest --------------------------------------------------------------------------------------------------------

    def _is_resting(self) -> bool:
        return self._rest.at_rest and not self._motion.moves

    def _learn_from_rest(self) -> None:
        """Level and estimate the gyroscope bias; with a magnetic heading this is the result."""
        s = self.settings
        self.bank = None
        if self._level is not None and self._now - self._level.t < _RENEWAL * s.static_window:
            return
        q = level_attitude(self._rest.mean_force)
        rate_sd = float(max(self._rest.rate_sd)) * _NOISE_LEFT
        P = level_covariance(q, rate_sd, _RESIDUAL_RATE_SD, s.accel_bias_sd, s.static_window)
        self._level = RestLevel(self._now, q, self._rest.mean_rate, P)
        yaw = self._magnetic_yaw(q)
        if yaw is None:
            self._done = None
            return
        fix = self.last_fix
        known = fix is not None and self._now - fix.t < _FIX_AGE and self._motion.has_shown_rest
        nav, P = from_level(self._level, yaw, fix if known else None, self._rows.at(self._now), self._is_resting())
        P[PHI + 2, PHI + 2] = s.mag_heading_sd**2
        self._done = Alignment(self._now, nav, 0.5 * (P + P.T), "at rest, magnetic heading", bool(known), True)

    # --- motion ------------------------------------------------------------------------------------------------------

    def _take(self, fix: Fix) -> None:
        """Process a fix at its time of validity, which the IMU data have reached."""
        if self._is_resting() or self.is_complete:
            return
        if self._rest.at_rest:  # the IMU senses no acceleration, but the fix moves: this was a steady motion, not rest
            self._level = None
        # The heading is unobservable without acceleration, so the bank does not start while the IMU is at rest. The
        # GNSS velocity is no proof of motion: a receiver that has just been switched on may report one at rest.
        if self.bank is None and not self._rest.at_rest:
            self.bank = self._start_bank(fix)
        bank = self.bank
        if bank is None:
            return
        bank.run(self._rows.between(bank.time, fix.t))
        bank.fuse(fix.position, fix.position_sd, fix.velocity, fix.velocity_sd, self.noise)
        _, sd = bank.heading()
        scaled_sd = sd * math.sqrt(max(bank.nis, 1.0))  # as ``merged`` scales it
        if scaled_sd <= self.settings.heading_sd and fix.t - bank.began >= self.settings.min_time:
            nav, P = bank.merged()
            how = "at rest, heading from the first motion" if self._from_rest else "in motion, heading from GNSS"
            self._done = Alignment(float(fix.t), nav, 0.5 * (P + P.T), how, nis=bank.nis)
        elif not math.isfinite(sd) or (bank.updates > _LOST_UPDATES and bank.nis > _LOST_NIS):
            self.restarts += 1
            self.bank = self._level = None

    def _start_bank(self, fix: Fix) -> HeadingHypotheses | None:
        """Start the bank from the last levelling at rest, else from a level in motion; None if not yet possible."""
        s, level, turns = self.settings, self._level, None
        if level is not None and self._now - level.t < _LEVEL_AGE:
            if fix.t <= level.t:
                return None
            self._from_rest = True
            nav, P = from_level(level, 0.0, None, self._rows.at(level.t), self._is_resting())
            P[DPOS : DPOS + 3, DPOS : DPOS + 3] = np.diag((fix.position_sd + _AWAY) ** 2)
            nav[LAT : ALT + 1] = fix.position
            q = level.q
        else:
            rows = self._rows.between(fix.t - _LEVEL_WINDOW, fix.t)
            if len(rows) < 3 or rows[0, IMU_T] > fix.t - _FILLED * _LEVEL_WINDOW:
                return None
            self._from_rest = False
            if unlevel(rows, self._biases.accel) > STEEPEST:
                turns = inclined(self.recent, self._rows, fix, self._biases.accel)
            q, tilt_sd = self.outside.near(fix.t, s.tilt_sd) or (level_in_motion(rows), s.tilt_sd)
            nav, P = in_motion(q, tilt_sd, fix, self._biases, self._rows.at(fix.t), self._is_resting())
        prior = None if turns is not None else heading_prior(s, self._magnetic_yaw(q))
        return HeadingHypotheses(nav, P, s.hypotheses, self._constants, self._lever, prior, turns)

    # --- magnetometer ------------------------------------------------------------------------------------------------

    def _magnetic_yaw(self, q_level: Array) -> float | None:
        """Yaw [rad] from the magnetometer; None when its field is implausible (``compass.doubt`` says why)."""
        lat, lon = (None, None) if self.last_fix is None else self.last_fix.position[:2]
        return self.compass.yaw(self._now, q_level, lat, lon)
