"""Statistics of a sensor's innovations: NIS, mean offset, autocorrelation."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

from nav_pose_estimator.core.numerics.jit import kernel
from nav_pose_estimator.core.numerics.order import about_median, median

_RECENT = 300  # innovations that the 99th percentile and the autocorrelation are taken from
_AVERAGED = 10.0  # s over which the mean slides
_LEAST = 8  # smallest number of innovations from which a median is taken
_SURE = 3.0  # approximate standard deviations of a median that may be due to chance
_LARGEST = 100.0  # limit of the NIS in the mean, so that an outlier does not dominate it


class InnovationRecord:
    """Record of the normalised innovation squared (NIS) per degree of freedom, 1 for a consistent filter."""

    def __init__(self) -> None:
        self.mean = 0.0
        self._recent: deque[float] = deque(maxlen=_RECENT)
        self._horizontal: deque[complex] = deque(maxlen=_RECENT)  # East + i North
        self._accepted: deque[complex] = deque(maxlen=_RECENT)
        self._new = 0  # of them since ``take``
        self._period = math.inf  # s

    def add(self, nis: float, z: Sequence[float] | np.ndarray, period: float, accepted: bool = True) -> None:
        """Add an innovation ``z`` of two or more rows, East and North first, with a ``period`` [s] between them.

        ``accepted``: the measurement was used unchanged, neither rejected nor inflated.
        """
        if not math.isfinite(nis):
            return
        horizontal = complex(z[0], z[1])
        if accepted:
            self._accepted.append(horizontal)
            self._period = period
        self.mean += min(period / _AVERAGED, 0.2) * (min(nis / len(z), _LARGEST) - self.mean)
        self._recent.append(nis / len(z))
        self._horizontal.append(horizontal)
        self._new += 1

    def take(self) -> list[tuple[float, float]]:
        """Horizontal innovations since the last call, at most ``_RECENT``."""
        count, self._new = min(self._new, len(self._horizontal)), 0
        return [(z.real, z.imag) for z in self._last(count)]

    @property
    def offset(self) -> np.ndarray:
        """Mean of the accepted horizontal innovations, East and North (2,), over the last ten seconds."""
        return self.mean_of_last(_AVERAGED)

    def mean_of_last(self, seconds: float) -> np.ndarray:
        """Mean of the accepted horizontal innovations, East and North (2,), over the last ``seconds``."""
        count = max(round(seconds / self._period), 1)
        return _pairs(list(self._accepted)[-count:]).mean(axis=0) if self._accepted else np.zeros(2)

    def change(self, count: int) -> float:
        """Largest change [unit of z] of the last ``count`` horizontal innovations, or all, from the one before."""
        count = min(count, len(self._horizontal) - 1)
        return (
            max((abs(z - self._horizontal[-1 - count]) for z in self._last(count)), default=0.0) if count > 0 else 0.0
        )

    def lasting(self, seconds: float) -> float:
        """Size of the median horizontal innovation of the last ``seconds``, minus what may be chance; in the unit of z.

        0.0 for fewer than eight innovations.
        """
        count = round(seconds / self._period)
        if not _LEAST <= count <= len(self._horizontal):
            return 0.0
        return float(beyond_chance(_pairs(self._last(count))))

    def _last(self, count: int) -> list[complex]:
        return list(self._horizontal)[-count:] if count else []

    @property
    def p99(self) -> float:
        """99th percentile of the NIS per degree of freedom, NaN before the first."""
        return float(np.quantile(self._recent, 0.99)) if self._recent else math.nan

    @property
    def lag_one(self) -> float:
        """Lag-one autocorrelation of the horizontal innovations, NaN before the second.

        Zero for an optimal filter (Mehra 1970); time-correlated errors of the receiver show as well.
        """
        z = _pairs(self._horizontal)
        power = float(np.square(z).sum())
        return float((z[1:] * z[:-1]).sum()) / power if len(z) > 1 and power > 0.0 else math.nan


def _pairs(horizontal: Sequence[complex]) -> np.ndarray:
    """East and North (N, 2)."""
    return np.array(horizontal, dtype=complex).view(float).reshape(-1, 2)


@kernel
def beyond_chance(z):
    """Size of the median of the innovations ``z`` (N, 2), minus what may be chance."""
    x, y, apart = about_median(z)
    return max(math.hypot(x, y) - _SURE * median(apart) / math.sqrt(len(z)), 0.0)
