"""How well a sensor's innovations agree with what the filter states of them."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence

import numpy as np

_RECENT = 300  # innovations that the 99th percentile and the autocorrelation are taken from
_AVERAGED = 10.0  # s over which the mean slides
_LEAST = 8  # innovations that have a middle
_SURE = 3.0  # deviations, about, of a middle
_LARGEST = 100.0  # a blunder is no measure of the filter


class InnovationRecord:
    """The normalised innovation squared (NIS) per degree of freedom: 1 is honest."""

    def __init__(self) -> None:
        self.mean = 0.0
        self._recent: deque[float] = deque(maxlen=_RECENT)
        self._horizontal: deque[tuple[float, float]] = deque(maxlen=_RECENT)
        self._new: deque[tuple[float, float]] = deque(maxlen=_RECENT)
        self._believed: deque[tuple[float, float]] = deque(maxlen=_RECENT)
        self._period = math.inf  # s

    def add(self, nis: float, z: Sequence[float] | np.ndarray, period: float, believed: bool = True) -> None:
        """An innovation ``z`` of two or more rows, East and North first; they come every ``period`` [s].

        ``believed``: the measurement was used as it is, neither refused nor with less weight.
        """
        if not math.isfinite(nis):
            return
        if believed:
            self._believed.append((float(z[0]), float(z[1])))
            self._period = period
        self.mean += min(period / _AVERAGED, 0.2) * (min(nis / len(z), _LARGEST) - self.mean)
        self._recent.append(nis / len(z))
        self._horizontal.append((float(z[0]), float(z[1])))
        self._new.append(self._horizontal[-1])

    def take(self) -> list[tuple[float, float]]:
        """Horizontal innovations since the last call, as many as are remembered."""
        new = list(self._new)
        self._new.clear()
        return new

    @property
    def offset(self) -> np.ndarray:
        """Mean of the horizontal innovations that were believed, East and North (2,), over the last ten seconds."""
        count = max(round(_AVERAGED / self._period), 1)
        return np.mean(list(self._believed)[-count:], axis=0) if self._believed else np.zeros(2)

    def lasting(self, seconds: float) -> float:
        """Size of the middle of all horizontal innovations of the last ``seconds`` [m], less what may be chance.

        0.0 of fewer than eight.
        """
        count = round(seconds / self._period)
        if not _LEAST <= count <= len(self._horizontal):
            return 0.0
        z = np.array(list(self._horizontal)[-count:])
        middle = np.median(z, axis=0)
        chance = _SURE * float(np.median(np.hypot(*(z - middle).T))) / math.sqrt(count)
        return max(float(np.hypot(*middle)) - chance, 0.0)

    @property
    def p99(self) -> float:
        """99th percentile of the last few hundred, NaN before the first."""
        return float(np.quantile(self._recent, 0.99)) if self._recent else math.nan

    @property
    def lag_one(self) -> float:
        """Autocorrelation of the last few hundred horizontal innovations from one to the next, NaN before the second.

        Zero for an optimal filter (Mehra 1970); the errors of a receiver that lasts for seconds show as well.
        """
        z = np.array(self._horizontal)
        power = float(np.square(z).sum())
        return float((z[1:] * z[:-1]).sum()) / power if len(z) > 1 and power > 0.0 else math.nan
