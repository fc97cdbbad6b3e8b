"""Vibration monitor: additional IMU noise and bias uncertainty by vibration, and its warnings.

Vibration that was present while GNSS was good is part of the noise identified in flight. Vibration that begins or grows
in an outage is not: the part that sampling aliases to low frequencies integrates to velocity and attitude. How large
that part is cannot be observed. So all of the increase counts as white noise, and its rectification as a change of the
accelerometer bias. While GNSS has contradicted the gyroscope, what was identified does not explain it: in an outage all
of its vibration counts as white noise then, of which the attitude takes a random walk.
"""

from __future__ import annotations

import math

from nav_pose_estimator.engine.imu.doubt import Doubt
from nav_pose_estimator.engine.imu.seconds import ImuSecond
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.solutions import Level

# Vibration is the standard deviation from sample to sample, see ``seconds.ImuSecond``.
_BEARABLE = 5.0  # m/s^2: vibration that the noise parameters of an IMU in flight include
_BEARABLE_RATE = 0.1  # rad/s: the same of the gyroscope
_UNRESOLVED = 0.1  # fraction of the vibration beyond ``_BEARABLE`` that aliases or rectifies even if it has not risen
_NOTABLE = 0.2  # relative change of the noise below which the filter keeps the old value
_HEAVY = 15.0  # m/s^2: vibration with a warning, because rectification is likely
_RISEN = 2.0  # factor to the largest vibration with GNSS above which it has risen in an outage
_MORE = 1.2  # factor by which the rectified bias has to grow before it is charged again
_RECTIFIED = 0.002  # s^2/m: accelerometer bias by rectification, relative to the squared vibration


class Vibration:
    """The monitor. It receives every complete second of the IMU."""

    def __init__(self) -> None:
        self.force_noise = self.rate_noise = 0.0
        """m/s^2/sqrt(Hz) and rad/s/sqrt(Hz): additional noise of accelerometer and gyroscope."""
        self.is_heavy = False
        self._known, self._known_rate = 0.0, 0.0  # m/s^2, rad/s: largest vibration while GNSS was good
        self._charged = 0.0  # m/s^2: bias uncertainty already passed to the filter in this outage
        self._risen = False
        self._last = 0.0  # m/s^2: vibration of the last second

    def forget_time(self) -> None:
        """The navigator starts again: reset the additional noise."""
        self.force_noise = self.rate_noise = 0.0

    @property
    def reason(self) -> str:
        """Why the solution is less certain, one clause for the user; empty where it is not."""
        if self._risen:
            return f"the IMU vibrates by {self._last:.1f} m/s^2, at most {self._known:.1f} while GNSS was available"
        return f"the IMU vibrates by {self._last:.0f} m/s^2" if self.is_heavy else ""

    def second(
        self, second: ImuSecond, is_aided: bool, journal: Journal, stamp_ns: int, gyroscope_is_doubted: bool = False
    ) -> Doubt | None:
        """Process a second; returns the uncertainty that vibration adds without GNSS, else None."""
        force, rate = second.vibration, second.shaking
        self._last = force
        if is_aided:
            self._known, self._known_rate = max(self._known, force), max(self._known_rate, rate)
            self._charged = 0.0
        risen = not is_aided and force > max(_BEARABLE, _RISEN * self._known)
        risen_rate = not is_aided and rate > max(_BEARABLE_RATE, _RISEN * self._known_rate)
        self._report(second, risen or risen_rate, journal, stamp_ns)
        if risen:
            force_noise = _white(force, self._known, second.samples)
        else:
            force_noise = _UNRESOLVED * math.sqrt(max(force**2 - _BEARABLE**2, 0.0) / second.samples)
        rate_noise = _white(rate, self._known_rate, second.samples) if risen_rate else 0.0
        if abs(force_noise - self.force_noise) > _NOTABLE * self.force_noise:
            self.force_noise = force_noise
        if abs(rate_noise - self.rate_noise) > _NOTABLE * self.rate_noise:
            self.rate_noise = rate_noise
        tilt = _white(rate, 0.0, second.samples) if gyroscope_is_doubted and not is_aided else 0.0  # of one second
        bias = _RECTIFIED * (force**2 - self._known**2) if risen else 0.0
        if bias <= _MORE * self._charged:
            return Doubt(tilt, 0.0) if tilt else None
        doubt = Doubt(tilt, 0.0, accel_bias=math.sqrt(bias**2 - self._charged**2))
        self._charged = bias
        return doubt

    def _report(self, second: ImuSecond, risen: bool, journal: Journal, stamp_ns: int) -> None:
        heavy = second.vibration > (0.7 * _HEAVY if self.is_heavy else _HEAVY)
        if heavy and not self.is_heavy:
            text = (
                f"the IMU vibrates by {second.vibration:.0f} m/s^2 from sample to sample, mean force "
                f"{second.gravity:.1f} m/s^2: expect errors of the vertical velocity; damp its mount"
            )
            journal.say(stamp_ns, "imu.vibration", Level.WARN, text, vibration=second.vibration)
        self.is_heavy = heavy
        was_risen, self._risen = self._risen, risen
        if risen and not was_risen:
            journal.say(stamp_ns, "imu.vibration.risen", Level.WARN, f"{self.reason}: sigma grows with it")


def _white(size: float, known: float, samples: int) -> float:
    """Density per sqrt(Hz) and axis of the vibration ``size`` beyond ``known``, assumed white at ``samples`` [Hz]."""
    return math.sqrt(max(size**2 - known**2, 0.0) / (3.0 * samples))
