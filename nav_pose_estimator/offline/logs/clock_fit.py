"""How fast the clock of the log runs against GNSS time.

Times of day jump when a receiver learns of leap seconds or rolls over its week: jumps are taken out before the fit.
"""

from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.offline.logs.gnss_time import rolled
from nav_pose_estimator.offline.logs.sensors import Gnss

Array = np.ndarray
TOLERATED = 1e-3
"""Relative error of a clock up to which it is left alone. Crystals are within 1e-4."""
MIN_SPAN, MIN_EPOCHS = 10.0, 20  # s, fixes
_JUMP = 0.5  # s between two epochs that the clocks of receiver and log disagree
_SIGMAS = 3.0


@dataclass(frozen=True)
class ClockFit:
    """``rate``: seconds of GNSS time in a second of the log, deviation ``sd``; from ``span`` [s] of data.

    ``utc_us``: UTC at the time ``at_us`` of the log [µs]. ``jumps`` of the GNSS time were taken out.
    """

    rate: float
    sd: float
    span: float
    at_us: int
    utc_us: int
    jumps: int = 0

    @property
    def wrong(self) -> bool:
        """True when the clock of the log is off by more than a crystal can be."""
        return abs(self.rate - 1.0) > TOLERATED + _SIGMAS * self.sd

    def describe(self) -> str:
        """The error in words: how much, and which way."""
        error = 1.0 / self.rate - 1.0
        amount = f"{abs(error) * 100:.2f} %" if abs(error) > 1e-3 else f"{abs(error) * 1e6:.0f} ppm"
        return f"the clock of the log runs {amount} {'fast' if error > 0 else 'slow'} against GNSS time"


def fit_clock(gnss: Gnss, from_us: int, to_us: int) -> ClockFit | None:
    """Fit fixes with a known time between two times of the log; None where there are too few."""
    inside = (gnss.time_us >= from_us) & (gnss.time_us <= to_us) & (gnss.utc_us > 0) & gnss.has_fix
    log_us, utc_us = gnss.time_us[inside], rolled(gnss.utc_us[inside])
    distinct = np.concatenate([[True], np.diff(utc_us) != 0]) if len(utc_us) else np.zeros(0, bool)
    log_us, utc_us = log_us[distinct], utc_us[distinct]
    if len(log_us) < MIN_EPOCHS or log_us[-1] - log_us[0] < MIN_SPAN * 1e6:
        return None
    log, utc = (log_us - log_us[0]) * 1e-6, (utc_us - utc_us[0]) * 1e-6
    utc, jumps = _without_jumps(log, utc)
    rate, sd = _robust_slope(log, utc)
    return ClockFit(rate, sd, float(log[-1]), int(log_us[-1]), int(utc_us[-1]), jumps)


def _without_jumps(log: Array, utc: Array) -> tuple[Array, int]:
    steps, told = np.diff(log), np.diff(utc)
    usual = float(np.median(told / np.maximum(steps, 1e-6)))
    off = told - usual * steps
    jump = np.where(np.abs(off) > _JUMP, off, 0.0)
    return utc - np.concatenate([[0.0], np.cumsum(jump)]), int(np.count_nonzero(jump))


def _robust_slope(log: Array, utc: Array) -> tuple[float, float]:
    """Slope of a straight line and its deviation; a few late messages do not move it (weights by Huber)."""
    weights = np.ones(len(log))
    x = log - log.mean()
    for _ in range(5):
        mean_x, mean_y = np.average(x, weights=weights), np.average(utc, weights=weights)
        dx = x - mean_x
        spread = float(np.sum(weights * dx**2))
        slope = float(np.sum(weights * dx * (utc - mean_y))) / spread
        residual = utc - mean_y - slope * dx
        scale = max(1.4826 * float(np.median(np.abs(residual))), 1e-6)
        weights = np.minimum(1.0, 1.5 * scale / np.maximum(np.abs(residual), 1e-12))
    # neighbouring residuals go together: a tenth of them counts
    return slope, scale / np.sqrt(spread) * np.sqrt(10.0)
