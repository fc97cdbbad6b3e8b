"""Identification of IMU and GNSS noise in flight, from the drift of an unaided copy of the filter.

While GNSS is good, a copy of the filter runs without it for ten seconds at a time. The difference to the aided filter
is the copy's drift d. The error of an optimal estimate is orthogonal to its corrections, so

    E d d' = P(copy) - P(aided)

when process and measurement noise are right, and the ratio q = d'd / tr E d d' of the horizontal velocity averages one.
One-step innovations cannot show this: the errors of a receiver are correlated over seconds and hide the IMU's error of
a fifth of a second. Over seconds both show, and separately. After two seconds the drift is mostly the velocity error
that GNSS left (too much trust in the receiver). After ten it is mostly tilt and gyroscope bias (too much trust in the
IMU, including vibration and its rectification).

Each variance factor s follows the gradient of the likelihood with respect to ln s, with a normal prior on ln s centred
on zero: ``ln s += gain (q - 1 - ln s / PRIOR_VARIANCE)``. The gain decreases as one over the number of trials down to a
floor, so that the factors follow changes in flight. All noises of the IMU share one factor: the size of a drift over
ten seconds does not show which of them caused it.

No factor falls below one. In a flight calmer than the parameters say, both factors would fall together and leave the
gains as they are. Lowering one alone made the gains worse, and the first manoeuvre after a calm period would meet too
small a noise. An overstated sigma is corrected by ``bias_noise`` and the rehearsals when GNSS is lost.

Where the filter has states for the time-correlated GNSS errors, its innovations should be white. Their lag-one
autocorrelation shows how the error divides into correlated and white noise (``ErrorShares``). A positive one says that
the filter follows the correlated error too slowly, a negative one that it takes white noise for a correlated error. The
size of the innovations is not used: it would raise the trust in the receiver beyond what an IMU with an understated
noise allows.

Sources: R. Mehra, "Approaches to adaptive filtering", IEEE Trans. Automatic Control 17(5), 1972 (maximum likelihood and
covariance matching, here with predictions over many steps; whiteness of the innovations).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import memory
from nav_pose_estimator.core.numerics.imu_checks import first_after

Array = NDArray[np.float64]

PERIOD = 1.0  # s between two calls of ``note``
RECEIVER_TRIAL, IMU_TRIAL = 2, 10  # calls after which a trial is evaluated for the receiver, and for the IMU (its end)
LARGEST = 16.0  # upper bound of a variance factor: four times the standard deviation of the parameter
PRIOR_VARIANCE = 6.0  # prior variance of the logarithm of a variance factor
SMALLEST_GAIN = 0.15  # floor of the gain
_FIRST_TRIALS = 3.0  # weight of the parameters, in trials
_LARGEST_RATIO = 4.0  # limit of the ratio of one trial, against gusts and outliers
_COVARIANCE_PERIOD = 0.2  # s: covariance step of the copy, which may be coarser than the filter's
_LEAST_VARIANCE = 1e-6  # (m/s)^2: floor of the expected variance of a drift
LEAST_WHITE, LARGEST_WHITE = 0.05, 20.0  # bounds of the white factor of ``ErrorShares``
# Upper bounds of the lasting factor, for positions and velocities. That of velocities is small: with a large one the
# filter would attribute every velocity error to the receiver, and the tilt would become unobservable.
FASTEST_POSITION, LARGEST_VELOCITY = 12.0, 1.5
_SHARE_GAIN = 0.01  # step of the shares' logarithms per innovation
_SHARE_MEMORY = 100.0  # innovations over which their power is averaged
_LARGEST_PRODUCT = 2.0  # limit of the product of two consecutive innovations, relative to that power


@dataclass(slots=True)
class ErrorShares:
    """Division of the error of one kind of GNSS observation into correlated and white noise, as variance factors.

    ``lasting`` multiplies the driving noise of the time-correlated error, from one to ``largest``; ``white`` multiplies
    the noise of a single observation. A positive lag-one autocorrelation of the horizontal innovations raises the first
    and lowers the second, a negative one the reverse, until it is zero.
    """

    largest: float  # upper bound of ``lasting``
    lasting: float = 1.0
    white: float = 1.0
    _last: tuple[float, float] | None = field(default=None, init=False)
    _power: float = field(default=0.0, init=False)  # mean square of an innovation, both axes
    _count: float = field(default=0.0, init=False)

    def interrupt(self) -> None:
        """Forget the last innovation: the next one does not follow it in time."""
        self._last = None

    def note(self, innovations: Iterable[tuple[float, float]]) -> None:
        """Learn from consecutive ``innovations`` (East, North)."""
        for east, north in innovations:
            self._count = min(self._count + 1.0, _SHARE_MEMORY)
            self._power += (east * east + north * north - self._power) / self._count
            if self._last is not None and self._power > 0.0:
                product = (east * self._last[0] + north * self._last[1]) / self._power
                self._move(_SHARE_GAIN * min(max(product, -_LARGEST_PRODUCT), _LARGEST_PRODUCT))
            self._last = (east, north)

    def _move(self, step: float) -> None:
        self.lasting = min(max(self.lasting * math.exp(step), 1.0), self.largest)
        self.white = min(max(self.white * math.exp(-step), LEAST_WHITE), LARGEST_WHITE)


class NoiseIdentification:
    """Variance factors of IMU noise and GNSS noise, with the current trial."""

    def __init__(self) -> None:
        self.imu_variance = self.gnss_variance = 1.0
        self.trials = 0
        self.position, self.velocity = ErrorShares(FASTEST_POSITION), ErrorShares(LARGEST_VELOCITY)
        self._flying: Array | None = None  # the copy, a ``core.filter.memory``
        self._calls = 0  # since the trial began

    @property
    def error_shares(self) -> tuple[float, float, float, float]:
        """Lasting and white factor of positions, then of velocities."""
        return self.position.lasting, self.position.white, self.velocity.lasting, self.velocity.white

    @error_shares.setter
    def error_shares(self, shares: tuple[float, float, float, float]) -> None:
        self.position.lasting, self.position.white, self.velocity.lasting, self.velocity.white = shares

    def interrupt(self) -> None:
        """End the trial without a result: GNSS is lost, the pose was reset, or the vehicle does not fly."""
        self._flying = None
        self.position.interrupt()
        self.velocity.interrupt()

    def note(self, nav: Array, P: Array, constants: Array, rows: Array) -> bool:
        """Process the aided filter and the IMU ``rows`` (N, 7) since the last call or longer; call it every ``PERIOD``.

        Returns True when a factor may have changed.
        """
        if self._flying is None:
            self._begin(nav, P, constants)
            return False
        flying = self._flying
        rows = rows[first_after(rows, flying[memory.NAV + at.TIME]) :]
        memory.run_block(flying, rows, 0, len(rows), math.inf, np.empty((0, at.OUT_COLUMNS)))
        self._calls += 1
        if self._calls == RECEIVER_TRIAL:
            self.gnss_variance = self._moved(self.gnss_variance, self._ratio(nav, P))
        if self._calls < IMU_TRIAL:
            return self._calls == RECEIVER_TRIAL
        self.imu_variance = self._moved(self.imu_variance, self._ratio(nav, P))
        self.trials += 1
        self._begin(nav, P, constants)
        return True

    def _begin(self, nav: Array, P: Array, constants: Array) -> None:
        n = len(P)
        coarse = constants.copy()
        coarse[at.COV_PERIOD] = max(_COVARIANCE_PERIOD, constants[at.COV_PERIOD])
        flying = memory.make(coarse, 1, math.inf)
        flying[memory.NAV : memory.CONSTANTS] = nav
        flying[memory.HEAD : memory.HEAD + n * n] = P.ravel()
        memory.add_checkpoint(flying)
        self._flying, self._calls = flying, 0

    def _ratio(self, nav: Array, P: Array) -> float:
        """Squared drift of the horizontal velocity relative to its expectation."""
        assert self._flying is not None
        n = len(P)
        velocity = slice(at.DVEL, at.DVEL + 2)
        drift = self._flying[memory.NAV + at.VEL : memory.NAV + at.VEL + 2] - nav[at.VEL : at.VEL + 2]
        own = self._flying[memory.HEAD : memory.HEAD + n * n].reshape(n, n).diagonal()
        expected = float((own[velocity] - P.diagonal()[velocity]).sum())
        return float(drift @ drift) / max(expected, _LEAST_VARIANCE)

    @property
    def _gain(self) -> float:
        return max(SMALLEST_GAIN, 1.0 / (_FIRST_TRIALS + self.trials))

    def _moved(self, variance: float, ratio: float) -> float:
        step = self._gain * (min(ratio, _LARGEST_RATIO) - 1.0 - math.log(variance) / PRIOR_VARIANCE)
        return min(max(variance * math.exp(step), 1.0), LARGEST)

    def figures(self) -> dict[str, float]:
        """Status: standard deviations relative to the parameters, and the number of completed trials."""
        return {
            "noise.imu": math.sqrt(self.imu_variance),
            "noise.gnss": math.sqrt(self.gnss_variance),
            "noise.trials": float(self.trials),
        }
