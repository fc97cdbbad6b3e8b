"""Monitor of GNSS velocity changes without a force on the IMU, and the uncertainty of the position after one."""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.strapdown import unaided_velocities
from nav_pose_estimator.core.gnss.unfelt_change import COLUMNS, LASTS, SPANS, UnfeltChange, add_second
from nav_pose_estimator.core.numerics.imu_checks import first_after
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import FilterView
from nav_pose_estimator.engine.samples import Vector3
from nav_pose_estimator.engine.solutions import Level

_G = 9.8  # m/s^2
_CREDIBLE = 2.0  # standard deviations that cover the position of GNSS with and without the change
_CROSS = 0.01  # scale and cross-axis errors of an uncalibrated gyroscope, relative to the rotation
_LATE = 1.0  # s after its end at which a second is evaluated, when its velocities have arrived
_ENDED = 0.5  # largest remaining fraction of the displacement, or of the speed, with which a change has ended
_LIFE = 11  # s after which an unaided velocity is replaced
_LONGEST_STEP = 1.5  # s: longest interval between two calls


class UnaidedVelocity:
    """Velocity propagated by the IMU alone from a state of the filter, with the uncertainty of its drift."""

    def __init__(self, f: FilterView) -> None:
        self._nav = f.nav.copy()
        variances = f.P.diagonal()
        self._tilt, self._heading = float(variances[at.PHI : at.PHI + 2].max()), float(variances[at.PHI + 2])  # rad^2
        self._gyro_bias = float(variances[at.D_GYRO_BIAS : at.D_GYRO_BIAS + 3].max())  # (rad/s)^2
        self._angle = np.zeros(3)  # rad: integral of the rate
        self._accel_bias = float(variances[at.D_ACCEL_BIAS : at.D_ACCEL_BIAS + 3].max())  # (m/s^2)^2
        self._trace = np.empty((0, 4))  # t and velocity of the antenna, of the last three calls
        self._lengths = 0, 0  # numbers of its rows from the last two calls
        self.age = 0
        self._seconds, self._count = np.empty((SPANS, COLUMNS)), 0

    @property
    def seconds(self) -> np.ndarray:
        """Means (N, COLUMNS) of the last consecutive seconds, ``SPANS`` at most; read only."""
        return self._seconds[: self._count]

    @property
    def time(self) -> float:
        """Time up to which the velocity is propagated [s]."""
        return float(self._nav[at.TIME])

    def propagate(self, constants: np.ndarray, rows: np.ndarray, lever: np.ndarray) -> bool:
        """Propagate over the IMU ``rows`` (N, 7) after ``time``; False where they are not another second."""
        if len(rows) == 0 or rows[-1, at.IMU_T] - self.time > _LONGEST_STEP:
            return False
        kept = sum(self._lengths)
        trace = np.empty((kept + len(rows), 4))
        trace[:kept] = self._trace[len(self._trace) - kept :]
        unaided_velocities(self._nav, constants, rows, lever, trace[kept:], self._angle)
        self._trace, self._lengths = trace, (self._lengths[1], len(rows))
        self.age += 1
        return True

    def compare(self, begin: float, received: np.ndarray) -> None:
        """Compare with the velocities ``received`` in the second from ``begin`` [s] on: time and velocity (K, 4)."""
        x, y, z = self._angle.tolist()
        angle_variance = self._gyro_bias * self.age**2 + _CROSS**2 * (x * x + y * y + z * z)
        drift_sd = math.sqrt(_G**2 * (self._tilt + angle_variance) + self._accel_bias)
        heading_sd = math.sqrt(self._heading + angle_variance)
        self._count = add_second(self._seconds, self._count, self._trace, received, begin, heading_sd, drift_sd)


class Pull:
    """Compares the receiver's velocities with those of the IMU, second by second, and integrates a change."""

    def __init__(self, journal: Journal, probation: float) -> None:
        self._journal, self._probation = journal, probation
        self._change = UnfeltChange()
        self._unaided: list[UnaidedVelocity] = []  # with different starts, so that the older is mostly long enough
        self._received: list[tuple[float, ...]] = []  # time and velocity
        self._speed, self._displacement = np.zeros(2), np.zeros(2)  # m/s, m: unexplained velocity, and its integral
        self._last = -math.inf  # s: time of the last fix
        self._until = math.inf  # s: time at which a change that has ended is forgotten
        self.is_on = False
        """Whether GNSS may be elsewhere than the vehicle."""

    def velocity(self, t: float, velocity: Vector3) -> None:
        """Add a GNSS velocity valid at ``t`` [s] whose axes are not in doubt."""
        self._received.append((t, *velocity))

    def interrupt(self) -> None:
        """Drop the comparison: the filter was reset, the IMU is in doubt, or GNSS is lost."""
        self._unaided.clear()
        self._received.clear()

    def second(self, f: FilterView, rows: np.ndarray, lever: np.ndarray, stamp_ns: int) -> None:
        """Process the aided filter at a whole second, with the IMU ``rows`` (N, 7) since the last one or longer."""
        now = float(f.nav[at.TIME])
        if self._unaided:
            rows = rows[first_after(rows, self._unaided[0].time) :]
            if not all(one.propagate(f.constants, rows, lever) for one in self._unaided):
                self.interrupt()
        end = math.floor(now + 1e-6) - _LATE
        received = np.array(self._received).reshape(-1, 4)
        for one in self._unaided:
            one.compare(end - 1.0, received)
        self._received = [one for one in self._received if one[0] >= end]
        change = self._change.find(self._unaided[0].seconds) if self._unaided else None
        if change is not None:
            self._note(now, np.array(change), stamp_ns)
        if not self._unaided or self._unaided[-1].age >= _LIFE:
            self._unaided = [*self._unaided[-1:], UnaidedVelocity(f)]

    def fix(self, t: float, offset: tuple[float, float], stamp_ns: int) -> None:
        """Process a fix at ``t`` [s] that is ``offset`` [m] (East, North) from the navigator; it may end the doubt."""
        if not self.is_on:
            return
        self._set(self._speed, self._displacement + self._speed * min(max(t - self._last, 0.0), _LATE))
        self._last = t
        away = float(self._displacement @ self._displacement)
        back = -(self._displacement[0] * offset[0] + self._displacement[1] * offset[1])
        returned = away > 0.0 and back > (1.0 - _ENDED) * away
        if returned or t > self._until:
            self.dismiss()
            self.interrupt()
            text = (
                "GNSS is back at the position by the IMU"
                if returned
                else "GNSS has agreed with the IMU for long enough"
            )
            self._journal.say(stamp_ns, "gnss.pulled.ended", Level.INFO, text)

    def dismiss(self) -> bool:
        """End the doubt, because the operator confirms GNSS; False where there was none."""
        was_on = self.is_on
        self._set(np.zeros(2), np.zeros(2))
        self._until = math.inf
        return was_on

    def _set(self, speed: np.ndarray, displacement: np.ndarray) -> None:
        self._speed, self._displacement = speed, displacement
        self.is_on = bool(speed.any() or displacement.any())

    def least_sd(self) -> tuple[float, float]:
        """Floors of the standard deviations of position [m] and velocity [m/s] on each horizontal axis."""
        if not self.is_on:
            return 0.0, 0.0
        return math.hypot(*self._displacement.tolist()) / _CREDIBLE, math.hypot(*self._speed.tolist()) / _CREDIBLE

    def reason(self) -> str:
        """Why the position is less certain than usual, one clause for the user; empty where it is not."""
        if not self.is_on:
            return ""
        return (
            f"GNSS moved off by {math.hypot(*self._speed.tolist()):.1f} m/s without a force on the IMU, "
            f"{math.hypot(*self._displacement.tolist()):.0f} m by now: spoofing, or an IMU fault"
        )

    def _note(self, t: float, change: np.ndarray, stamp_ns: int) -> None:
        was_on, before = self.is_on, self._speed
        self._set(before + change, self._displacement)
        self.interrupt()  # later data are compared with the state after the change
        if was_on and np.linalg.norm(self._speed) < _ENDED * np.linalg.norm(change):
            self._set(np.zeros(2), self._displacement)
            self._until = t + self._probation
            return
        self._until, self._last = math.inf, t
        if not was_on:
            self._set(self._speed, change * (_LATE + LASTS))  # since the change began
        self._journal.say(stamp_ns, "gnss.pulled", Level.WARN, f"{self.reason()}; its sigma grows")
