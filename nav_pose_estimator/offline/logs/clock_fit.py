"""Rate of the log's clock relative to GNSS time.

GNSS time jumps when a receiver learns of leap seconds or at a week rollover; jumps are removed before the fit.
"""

from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.numerics.order import MAD_TO_SD
from nav_pose_estimator.offline.logs.gnss_time import rolled
from nav_pose_estimator.offline.logs.sensors import Gnss

Array = np.ndarray
TOLERATED = 1e-3
"""Relative error up to which a clock is not corrected; that of crystals is within 1e-4."""
MIN_SPAN, MIN_EPOCHS = 10.0, 20  # s, and number of fixes that a fit needs
_JUMP, _DRIFT = 0.8, 0.01  # s, plus a fraction of the interval: larger steps are jumps
_NEIGHBOURS = 5  # fixes before and after of the running median in which jumps are searched
_SIGMAS = 3.0  # significance of a wrong rate


@dataclass(frozen=True)
class ClockFit:
    """``rate``: GNSS time per time of the log, with standard deviation ``sd``, from ``span`` [s] of data.

    ``utc_us``: UTC at the time ``at_us`` of the log [µs]. ``jumps``: number of removed jumps of the GNSS time.
    """

    rate: float
    sd: float
    span: float
    at_us: int
    utc_us: int
    jumps: int = 0

    @property
    def wrong(self) -> bool:
        """Whether the error of the log's clock is larger than that of any crystal."""
        return abs(self.rate - 1.0) > TOLERATED + _SIGMAS * self.sd

    def describe(self) -> str:
        """Clause with the size and the sign of the error."""
        error = self.rate - 1.0
        way = "slow" if error > 0.0 else "fast"
        if abs(error) < TOLERATED:
            return f"the clock of the log runs {abs(error) * 1e6:.0f} ppm {way} against GNSS time"
        amount = f"{abs(error) * 100:.2f} % {way}"
        return f"the clock of the log runs {amount}: a second of it lasts {self.rate:.4f} s of GNSS time"


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
    """``utc`` (N,) without permanent jumps, and their number. A late message is not a permanent jump."""
    lag = max(len(log) // 5, 1)
    usual = float(np.median((utc[lag:] - utc[:-lag]) / np.maximum(log[lag:] - log[:-lag], 1e-6)))
    padded = np.pad(utc - usual * log, _NEIGHBOURS, mode="reflect")
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * _NEIGHBOURS + 1), axis=1)
    steps = np.diff(smooth)
    jump = np.where(np.abs(steps) > _JUMP + _DRIFT * np.diff(log), steps, 0.0)
    return utc - np.concatenate([[0.0], np.cumsum(jump)]), int(np.count_nonzero(jump))


def _robust_slope(log: Array, utc: Array) -> tuple[float, float]:
    """Slope of a straight line and its standard deviation, robust against a few late messages (Huber weights)."""
    weights = np.ones(len(log))
    x = log - log.mean()
    for _ in range(5):
        mean_x, mean_y = np.average(x, weights=weights), np.average(utc, weights=weights)
        dx = x - mean_x
        spread = float(np.sum(weights * dx**2))
        slope = float(np.sum(weights * dx * (utc - mean_y))) / spread
        residual = utc - mean_y - slope * dx
        scale = max(MAD_TO_SD * float(np.median(np.abs(residual))), 1e-6)
        weights = np.minimum(1.0, 1.5 * scale / np.maximum(np.abs(residual), 1e-12))
    # neighbouring residuals are correlated, so that a tenth of their number counts
    return slope, scale / np.sqrt(spread) * np.sqrt(10.0)
