"""How well a sensor's innovations agree with what the filter states of them."""

from __future__ import annotations

import math
from collections import deque

import numpy as np

_RECENT = 300  # innovations that the 99th percentile is taken from
_AVERAGED = 10.0  # s over which the mean slides
_LARGEST = 100.0  # a blunder is no measure of the filter


class InnovationRecord:
    """The normalised innovation squared (NIS) per degree of freedom: 1 is honest."""

    def __init__(self) -> None:
        self.mean = 0.0
        self._recent: deque[float] = deque(maxlen=_RECENT)

    def add(self, nis: float, dof: int, period: float) -> None:
        """An innovation of ``dof`` rows; they come every ``period`` [s]."""
        if not math.isfinite(nis):
            return
        self.mean += min(period / _AVERAGED, 0.2) * (min(nis / dof, _LARGEST) - self.mean)
        self._recent.append(nis / dof)

    @property
    def p99(self) -> float:
        """99th percentile of the last few hundred, NaN before the first."""
        return float(np.quantile(self._recent, 0.99)) if self._recent else math.nan
