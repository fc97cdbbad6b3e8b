"""Monitoring of the IMU second by second: plausibility, consistency with GNSS, saturation, vibration, faults."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from nav_pose_estimator.core.numerics.imu_checks import first_from
from nav_pose_estimator.engine.imu import plausibility
from nav_pose_estimator.engine.imu.clipping import ClipWatch
from nav_pose_estimator.engine.imu.doubt import Doubt, DoubtMeter
from nav_pose_estimator.engine.imu.heading_monitor import HeadingMonitor
from nav_pose_estimator.engine.imu.motion_check import MotionCheck
from nav_pose_estimator.engine.imu.plausibility import Finding
from nav_pose_estimator.engine.imu.seconds import ImuSecond, second_of
from nav_pose_estimator.engine.imu.speed_doubt import SpeedDoubt
from nav_pose_estimator.engine.imu.vibration import Vibration
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.solutions import Level

SECOND = 1.0
"""s of IMU rows that each call of ``look`` evaluates; it needs one row before them."""
REACH = 1.3
"""s of buffered rows that are sure to contain them."""
_WELL = 3  # consecutive seconds without a finding, and with gravity in the mean force, that end a finding
_LEAST, _MOST = 0.6 * plausibility.G, 1.6 * plausibility.G  # m/s^2: range of a mean force that contains gravity
_STEADY_ACCELERATION = ("imu.implausible.no_gravity", "imu.implausible.in_g")
"""The first finding is not replaced by the second: with gravity removed, an acceleration of about 1 m/s^2 looks like
data in units of g. The reverse does not occur."""
_TWO_IMUS_LAST = 30  # s without a finding that end the one of two IMUs, which does not show at rest
_CLIPPED_FOR = 10  # s after saturation for which the status mentions it


class ImuPhysics:
    """All monitors of the IMU. ``refusal`` is empty, or says in one sentence why the IMU must not be used."""

    def __init__(self) -> None:
        self._seconds: deque[ImuSecond] = deque(maxlen=plausibility.MEMORY)
        self.motion = MotionCheck()
        """Consistency of IMU and GNSS velocity."""
        self._doubt, self._clips = DoubtMeter(), ClipWatch()
        self._clipped, self._clipped_for = "", 0  # clause for the status, and s for which it is still shown
        self._finding: Finding | None = None
        self._well = 0
        self.vibration, self.speed = Vibration(), SpeedDoubt()

    def forget_time(self) -> None:
        """The navigator starts again: forget the samples, keep established findings."""
        self._seconds.clear()
        self.motion.forget_time()
        self.vibration.forget_time()

    @property
    def knows_anything(self) -> bool:
        """Whether there has been a whole second of usable samples."""
        return bool(self._seconds)

    @property
    def refusal(self) -> str:
        """Why the IMU cannot be used, one sentence; empty where it can."""
        return "" if self._finding is None else f"The IMU is not plausible: {self._finding.sentence}."

    @property
    def imu_agrees(self) -> bool:
        """Whether the IMU recently measured the velocity changes that GNSS reports."""
        return self.motion.imu_agrees

    @property
    def heading(self) -> HeadingMonitor:
        """Monitor of the heading against GNSS velocity."""
        return self.motion.heading

    @property
    def as_received_reduction(self) -> float:
        """Reduction of the squared misfit by using the velocities as received instead of the corrected ones."""
        return self.motion.as_received_reduction

    def look(
        self,
        end: float,
        rows: np.ndarray,
        gyro_bias: np.ndarray | None,
        journal: Journal,
        stamp_ns: int,
        is_aided: bool = False,
        gyroscope_is_doubted: bool = False,
    ) -> Doubt | None:
        """Evaluate the second up to ``end`` (a whole second), with ``rows`` (N, 7) of it and one row before it.

        ``gyro_bias`` (3,) [rad/s] is the navigator's estimate, None before it runs; ``is_aided``: GNSS aids it;
        ``gyroscope_is_doubted``: GNSS has contradicted its rates.
        Returns the error that faulty data of this second may have caused, None for good data.
        """
        own = rows[first_from(rows, end - SECOND) :]
        with_one_more = rows[max(len(rows) - len(own) - 1, 0) :]
        self.motion.second(round(end), with_one_more, np.zeros(3) if gyro_bias is None else gyro_bias)
        doubt = self._watch_clipping(with_one_more, self._doubt.measure(with_one_more), journal, stamp_ns)
        second = second_of(own, end)
        if second is None:
            return doubt
        self._seconds.append(second)
        found = plausibility.find(list(self._seconds), gyro_bias is not None) or self.motion.finding
        self._report(found, _LEAST < second.gravity < _MOST and self._lives(second), journal, stamp_ns)
        shaken = self.vibration.second(second, is_aided or gyro_bias is None, journal, stamp_ns, gyroscope_is_doubted)
        self.motion.shakes = self.vibration.is_heavy
        return doubt if shaken is None else shaken if doubt is None else doubt.with_one_more(shaken)

    def _watch_clipping(self, rows: np.ndarray, doubt: Doubt | None, journal: Journal, stamp_ns: int) -> Doubt | None:
        """``doubt``, enlarged by saturation in the second of ``rows``."""
        self._clipped_for = max(self._clipped_for - 1, 0)
        clipped = self._clips.second(rows)
        if clipped is None:
            return doubt
        if not self._clipped_for and clipped.words != self._clipped:
            text = f"the {clipped.words}: motion beyond its range is lost, and attitude or velocity become wrong"
            journal.say(stamp_ns, "imu.clips", Level.WARN, text)
        self._clipped, self._clipped_for = clipped.words, _CLIPPED_FOR
        before = doubt or Doubt(0.0, 0.0)
        return Doubt(max(before.tilt, clipped.angle), max(before.speed, clipped.velocity), lasting=True)

    def _lives(self, second: ImuSecond) -> bool:
        """Whether all axes change again after a finding of a dead axis; True after other findings."""
        return self._finding is None or self._finding.name != plausibility.DEAD_AXIS or all(second.spread)

    def _report(self, found: Finding | None, is_well: bool, journal: Journal, stamp_ns: int) -> None:
        before = self._finding
        if found is not None:
            self._well = 0
            if before is not None and (before.name, found.name) == _STEADY_ACCELERATION:
                return
            self._finding = found
            if before is None or before.name != found.name:
                journal.say(stamp_ns, found.name, Level.ERROR, f"the IMU is not plausible: {found.sentence}")
            return
        self._well = self._well + 1 if is_well else 0
        if before is None:
            return
        if self._well >= (_TWO_IMUS_LAST if before.name == "imu.implausible.two_imus" else _WELL):
            self._finding = None
            journal.say(stamp_ns, "imu.implausible.ended", Level.INFO, "the IMU is plausible again")

    @property
    def doubt(self) -> str:
        """Why the solution is less certain, one clause for the user; empty where no monitor has a reason."""
        return f"the {self._clipped}" if self._clipped_for else self.vibration.reason or self.speed.reason

    def figures(self) -> dict[str, float]:
        """Values of the status, with keys that begin with ``imu``."""
        last = self._seconds[-1] if self._seconds else None
        return {
            "imu.vibration_m_s2": math.nan if last is None else last.vibration,
            "imu.mean_force_m_s2": math.nan if last is None else last.gravity,
            "imu.motion_misfit": self.motion.misfit,
        }
