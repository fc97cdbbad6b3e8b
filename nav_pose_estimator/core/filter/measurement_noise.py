"""Measurement noise models: from the variance that a sensor states to the covariance R that the filter uses.

The filter asks a model for R when it processes an observation, and then notifies it of the innovation and residual; an
adaptive model learns from these. It learns factors on the stated variances, one per row, never below 1. Time-correlated
errors look small in every innovation, and a filter that lowered R accordingly would diverge, while too large an R costs
little.

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
"""Upper bound of a factor on a variance: ten times the standard deviation. Larger errors are left to the gate."""
_MOST_ROWS = 8  # largest dimension of an observation
_PAUSE = 5.0  # s: after a longer pause the innovations show the navigator's errors rather than those of the sensor ...
_SETTLING = 10  # ... for this many observations, from which nothing is learned


class NoiseModel(Protocol):
    """Noise model of one sensor. An adaptive one is a dataclass, so that ``snapshot`` can copy it."""

    learns: ClassVar[bool]
    """Whether the model is adaptive; if not, only ``factor`` needs to be called."""

    @property
    def factor(self) -> float:
        """Largest ratio over the rows of R to the stated variance; 1 or more."""

    def expected(self, stated: Array) -> Array:
        """R (m, m) of an observation of stated covariance ``stated`` (m, m), without regard to its innovation."""

    def covariance(self, z: Array, HPH: Array, stated: Array) -> Array:
        """R (m, m) for an innovation ``z`` (m,) of covariance ``HPH`` + R; the model itself does not change."""

    def note(self, t: float, z: Array, residual: Array | None, HPH: Array, stated: Array) -> None:
        """Learn from an observation at ``t`` [s] that has been processed.

        ``residual`` (m,) is the innovation after the update, None where the filter did not use the observation.
        """


class Fixed:
    """R as the sensor states it, with the floors that its parameters set."""

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
        """Does nothing."""


def enlarged(stated: Array, factors: Array) -> Array:
    """``stated`` (m, m) with its variances multiplied by ``factors`` (m,), each 1 or more.

    The additional noise is taken as independent between rows, so that the result less ``stated`` is positive
    semidefinite.
    """
    R = stated.copy()
    R[np.diag_indices(len(R))] += (factors - 1.0) * stated.diagonal()
    return R


@dataclass
class _Pauses:
    """Suspends learning for ``_SETTLING`` observations after a pause longer than ``_PAUSE``."""

    _last: float = field(default=math.inf, init=False)  # s
    settling: int = field(default=0, init=False)  # observations still to be skipped

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
    """Base of the adaptive models: factors on the stated variances, one per row, learned from earlier observations."""

    learns: ClassVar[bool] = True

    _factors: Array = field(default_factory=_ones, init=False)
    _rows: int = field(default=1, init=False)
    _pauses: _Pauses = field(default_factory=_Pauses, init=False)

    @property
    def factor(self) -> float:
        """Largest ratio over the rows of R to the stated variance."""
        return float(self._factors[: self._rows].max())

    def expected(self, stated: Array) -> Array:
        """``stated`` enlarged by the factors learned so far."""
        return enlarged(stated, self._factors[: len(stated)])


@dataclass
class InnovationAdaptive(_Learned):
    """Noise variance from the differences of consecutive observations, with exponential forgetting.

    The innovation less the last residual, d = z(k) - (z(k-1) - H x(k-1)), contains the noise of two observations and
    the small drift of the navigator between them; the navigator's own error and its corrections cancel. So d^2 over the
    sum of the two stated variances estimates the factor without relying on P. Rejected observations count as well: a
    receiver that states far too small a variance is rejected most of the time.
    """

    _MEMORY: ClassVar[float] = 0.95  # forgetting factor per observation
    _MOST: ClassVar[float] = 3.0  # robustness: one observation counts for at most this multiple of the current factor
    _KEPT: ClassVar[float] = 0.858  # E min(x, 3) of a chi-square x with one degree of freedom: corrects for that limit

    _residual: Array = field(default_factory=_unknown, init=False)  # of the last observation
    _variance: Array = field(default_factory=_unknown, init=False)  # that it stated

    def covariance(self, z: Array, HPH: Array, stated: Array) -> Array:
        """``stated`` enlarged by the factors learned so far; outliers are left to the gate."""
        return self.expected(stated)

    def note(self, t: float, z: Array, residual: Array | None, HPH: Array, stated: Array) -> None:
        """Learn row by row from the change since the last observation."""
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
    """Inverse gamma distribution of the factor of each row, estimated jointly with the state (variational Bayes).

    Fixed-point iterations alternate between state and noise of one observation. The filter's own state is not touched:
    it is updated once, with the resulting R. A factor that reached its bound is also stored at the bound; otherwise the
    scale of its distribution would grow without limit.
    """

    _MEMORY: ClassVar[float] = 0.98  # forgetting factor per observation
    _TURNS: ClassVar[int] = 5  # fixed-point iterations

    _shape: float = field(default=2.0, init=False)  # shape parameter: half the effective number of observations

    def covariance(self, z: Array, HPH: Array, stated: Array) -> Array:
        """``stated`` enlarged by the factors that explain this innovation and the earlier ones best."""
        return enlarged(stated, self._explained(z, HPH, stated))

    def note(self, t: float, z: Array, residual: Array | None, HPH: Array, stated: Array) -> None:
        """Store the factors that ``covariance`` found; a rejected observation rather shows an error of the filter."""
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
"""The models by the names that the parameters use."""
