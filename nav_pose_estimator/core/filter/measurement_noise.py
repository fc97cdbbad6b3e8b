"""Measurement noise: from what a sensor states to the covariance R that the filter goes by.

A model is asked when an observation acts, and told then what came of it; that is when it may learn.
What it learns are factors on the stated variances, one for each row, never below 1: errors that are correlated look
small in every innovation, and a filter that believed them would run away, while too large an R costs little.

Sources: fine alignment of inertial navigation systems by innovation detection (Chinese patent application, March 2022),
steps 10 and 11: noise from the innovations, here made robust; S. Sarkka and A. Nummenmaa, Recursive noise adaptive
Kalman filtering by variational Bayesian approximations, IEEE Trans. Automatic Control 54(3), 2009, algorithm 1.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import ClassVar, Protocol

import numpy as np
from numpy import float64
from numpy.typing import NDArray

Array = NDArray[float64]

LARGEST_FACTOR = 100.0
"""Of a variance: ten times the deviation. Worse errors are for the gate."""
_MOST_ROWS = 8
_PAUSE = 5.0  # s: after a longer one the innovations are the navigator's errors more than the sensor's ...
_SETTLING = 10  # ... for so many observations


class NoiseModel(Protocol):
    """Decides how noisy one sensor is. One that learns is a dataclass, of which copies are kept (``snapshot``)."""

    learns: ClassVar[bool]
    """Whether anything but ``factor`` is to be called."""

    @property
    def factor(self) -> float:
        """R over the stated variance, of the row where it is largest; 1 or more."""

    def expected(self, stated: Array) -> Array:
        """R (m, m) of an observation that states ``stated``, before its innovation is looked at."""

    def covariance(self, z: Array, HPH: Array, stated: Array) -> Array:
        """R (m, m) for an innovation ``z`` (m,) whose covariance is ``HPH`` + R; changes nothing."""

    def note(self, t: float, z: Array, residual: Array | None, HPH: Array, stated: Array) -> None:
        """An observation of the time ``t`` [s] has had its turn.

        ``residual`` (m,) is what it left of the innovation, None where it was not given to the filter.
        """


class Fixed:
    """What the sensor states, with the floors that its parameters put under it."""

    learns: ClassVar[bool] = False

    @property
    def factor(self) -> float:
        """Always 1."""
        return 1.0

    def expected(self, stated: Array) -> Array:
        """``stated`` as it is."""
        return stated

    def covariance(self, z: Array, HPH: Array, stated: Array) -> Array:
        """``stated`` as it is."""
        return stated

    def note(self, t: float, z: Array, residual: Array | None, HPH: Array, stated: Array) -> None:
        """Nothing is learned."""


def enlarged(stated: Array, factors: Array) -> Array:
    """``stated`` (m, m) with its variances times ``factors`` (m,), each 1 or more.

    What is missing counts as independent from row to row, so that the result less ``stated`` is never negative.
    """
    R = stated.copy()
    R[np.diag_indices(len(R))] += (factors - 1.0) * stated.diagonal()
    return R


@dataclass
class _Pauses:
    """Tells when observations follow each other closely enough to learn from."""

    _last: float = field(default=math.inf, init=False)  # s
    settling: int = field(default=0, init=False)

    def passes(self, t: float) -> bool:
        """Whether to learn from the observation at ``t`` [s]."""
        if t - self._last > _PAUSE:
            self.settling = _SETTLING
        self._last = t
        self.settling = max(self.settling - 1, 0)
        return self.settling == 0


def _ones() -> Array:
    return np.ones(_MOST_ROWS)


def _unknown() -> Array:
    return np.full(_MOST_ROWS, np.nan)


@dataclass
class _Learned:
    """Factors on the stated variances, one for each row, that earlier observations have shown."""

    learns: ClassVar[bool] = True

    _factors: Array = field(default_factory=_ones, init=False)
    _rows: int = field(default=1, init=False)
    _pauses: _Pauses = field(default_factory=_Pauses, init=False)

    @property
    def factor(self) -> float:
        """R over the stated variance, of the row where it is largest."""
        return float(self._factors[: self._rows].max())

    def expected(self, stated: Array) -> Array:
        """``stated`` by the factors that earlier observations have shown."""
        return enlarged(stated, self._factors[: len(stated)])


@dataclass
class InnovationAdaptive(_Learned):
    """The variance of what changes from one observation to the next, with exponential memory.

    The innovation less the last residual, d = z(k) - (z(k-1) - H x(k-1)), holds the noise of two observations and
    what the navigator drifted in between, which is little: its own error, and its corrections, cancel. So d^2 over the
    sum of both stated variances estimates the factor without any trust in P, and also from observations that the filter
    did not believe: a receiver that states far too little is refused most of the time.
    """

    _MEMORY: ClassVar[float] = 0.95
    _MOST: ClassVar[float] = 3.0  # factors that one observation may count for: outliers cannot open R
    _KEPT: ClassVar[float] = 0.858  # E min(x, 3) of a chi-square x with one degree of freedom

    _residual: Array = field(default_factory=_unknown, init=False)  # of the last observation
    _variance: Array = field(default_factory=_unknown, init=False)  # that it stated

    def covariance(self, z: Array, HPH: Array, stated: Array) -> Array:
        """The same: outliers are for the gate."""
        return self.expected(stated)

    def note(self, t: float, z: Array, residual: Array | None, HPH: Array, stated: Array) -> None:
        """Learn from the change since the last observation, row by row."""
        m = self._rows = len(z)
        variance = stated.diagonal()
        change = z - self._residual[:m]
        seen = change**2 / (variance + self._variance[:m])
        known = np.isfinite(seen)
        if self._pauses.passes(t):
            before = self._factors[:m]
            share = np.minimum(seen, self._MOST * before) / self._KEPT
            after = self._MEMORY * before + (1.0 - self._MEMORY) * share
            before[known] = np.clip(after[known], 1.0, LARGEST_FACTOR)
        self._residual[:], self._variance[:] = np.nan, np.nan
        self._residual[:m], self._variance[:m] = z if residual is None else residual, variance


@dataclass
class Variational(_Learned):
    """An inverse gamma distribution for the factor of each row, found together with the state (variational Bayes).

    Each innovation is explained by state and noise in turns; the state that this takes is not the filter's, which is
    corrected once, with the R that comes out. What is clamped is also remembered clamped, else the scale runs away.
    """

    _MEMORY: ClassVar[float] = 0.98
    _TURNS: ClassVar[int] = 5

    _shape: float = field(default=2.0, init=False)  # half as many observations as are remembered

    def covariance(self, z: Array, HPH: Array, stated: Array) -> Array:
        """``stated`` by the factors that this innovation and the earlier ones are best explained with."""
        return enlarged(stated, self._explained(z, HPH, stated))

    def note(self, t: float, z: Array, residual: Array | None, HPH: Array, stated: Array) -> None:
        """Keep what ``covariance`` found; what the filter did not take in is rather the filter's own error."""
        self._rows = len(z)
        if self._pauses.passes(t) and residual is not None:
            self._factors[: len(z)] = self._explained(z, HPH, stated)
            self._shape = self._MEMORY * self._shape + 0.5

    def _explained(self, z: Array, HPH: Array, stated: Array) -> Array:
        before, variance = self._factors[: len(z)], stated.diagonal()
        if self._pauses.settling > 0 or not (np.isfinite(z).all() and np.isfinite(HPH).all()):
            return before.copy()
        shape = self._MEMORY * self._shape + 0.5
        scale = self._MEMORY * self._shape * before
        factors = before
        for _ in range(self._TURNS):
            gain = np.linalg.solve(HPH + enlarged(stated, factors), HPH).T
            residual, spread = z - gain @ z, (HPH - gain @ HPH).diagonal()
            seen = (residual**2 + np.maximum(spread, 0.0)) / variance
            factors = np.clip((scale + 0.5 * seen) / shape, 1.0, LARGEST_FACTOR)
        return factors


MODELS: dict[str, Callable[[], NoiseModel]] = {
    "fixed": Fixed,
    "innovation_adaptive": InnovationAdaptive,
    "variational": Variational,
}
"""The models by the names that parameters choose them by."""
