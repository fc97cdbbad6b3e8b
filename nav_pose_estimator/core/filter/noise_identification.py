"""How noisy are this IMU and this receiver? Identified in flight, from short flights without GNSS.

While GNSS is good a copy of the filter goes on without it, ten seconds at a time. What the aided filter corrected in
the meantime is the copy's drift d. The error of an optimal estimate is orthogonal to its corrections, so

    E d d' = P(copy) - P(aided)

when process and measurement noise are right, and the ratio q = d'd / tr E d d' of the horizontal velocity is one on
average. One-step innovations cannot tell this: the errors of a receiver last for seconds, and what an IMU does in a
fifth of a second vanishes in them. Over seconds both show, and apart from each other: after two seconds the drift is
mostly the velocity that GNSS left (too much trust in the receiver), after ten mostly tilt and gyroscope bias (too much
trust in the IMU, vibration and its rectification included).
Each variance factor moves up the gradient of the likelihood with respect to its logarithm, drawn towards one by a
normal prior on that logarithm: ``ln s += gain (q - 1 - ln s / PRIOR_VARIANCE)``. The gain falls as one over the number
of trials to a floor, so that the factors follow a flight that changes. All noises of the IMU share one factor: what a
drift of ten seconds is made of cannot be told from its size.

No factor falls below one. A flight that is calmer than the parameters say would lower both, which leaves the gains as
they are; lowering one alone made them worse, and the first manoeuvre after a calm stretch would find too little noise.
That sigma is too large then is for ``bias_noise`` and the rehearsals to say, when GNSS is lost.

Where the filter has states for the errors of the receiver that last, innovations are to be white from one to the next,
and that tells how an error is shared between what lasts and white noise (``ErrorShares``): correlated ones say that the
filter follows what lasts too slowly, alternating ones that it takes noise for something that lasts. Their size is left
out of it: it would make the filter believe a receiver more than an IMU that it is told too little of can bear.

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

Array = NDArray[np.float64]

PERIOD = 1.0  # s between two calls of ``note``
RECEIVER_TRIAL, IMU_TRIAL = 2, 10  # calls after which a trial tells of the receiver, of the IMU and ends
LARGEST = 16.0  # factor: four times the deviation that is set
PRIOR_VARIANCE = 6.0  # of the logarithm of a variance factor
SMALLEST_GAIN = 0.15
_FIRST_TRIALS = 3.0  # trials that the defaults are worth
_LARGEST_RATIO = 4.0  # a single trial may be a gust or a glitch
_COVARIANCE_PERIOD = 0.2  # s: the copy's covariance need not be as fine as the filter's
_LEAST_VARIANCE = 1e-6  # (m/s)^2 of drift
LEAST_WHITE, LARGEST_WHITE = 0.05, 20.0  # factors of ``ErrorShares``
FASTEST_POSITION, LARGEST_VELOCITY = 12.0, 1.5  # lasting: a velocity that may err at will tells nothing of the tilt
_SHARE_GAIN = 0.01  # for each innovation
_SHARE_MEMORY = 100.0  # innovations that their power is taken from
_LARGEST_PRODUCT = 2.0  # of two innovations in parts of that power


@dataclass
class ErrorShares:
    """How the error of one kind of GNSS observation is shared, as factors of the variances that are set.

    ``lasting`` of the noise that drives what lasts, from one to ``largest``; ``white`` of the noise of a single
    observation. They move apart along the lag-one autocorrelation of the horizontal innovations, which is zero in the
    end.
    """

    largest: float  # lasting
    lasting: float = 1.0
    white: float = 1.0
    _last: tuple[float, float] | None = field(default=None, init=False)
    _power: float = field(default=0.0, init=False)  # of an innovation, both axes
    _count: float = field(default=0.0, init=False)

    def interrupt(self) -> None:
        """What comes next has nothing to do with what came last."""
        self._last = None

    def note(self, innovations: Iterable[tuple[float, float]]) -> None:
        """Learn from ``innovations``, East and North, in order of time."""
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
    """Factors of the variances of IMU noise and GNSS noise, and the trial that is under way."""

    def __init__(self) -> None:
        self.imu_variance = self.gnss_variance = 1.0
        self.trials = 0
        self.position, self.velocity = ErrorShares(FASTEST_POSITION), ErrorShares(LARGEST_VELOCITY)
        self._flying: Array | None = None  # the copy, a ``core.filter.memory``
        self._calls = 0  # since the trial began

    @property
    def error_shares(self) -> tuple[float, float, float, float]:
        """Lasting and white factors of positions, then of velocities."""
        return self.position.lasting, self.position.white, self.velocity.lasting, self.velocity.white

    @error_shares.setter
    def error_shares(self, shares: tuple[float, float, float, float]) -> None:
        self.position.lasting, self.position.white, self.velocity.lasting, self.velocity.white = shares

    def interrupt(self) -> None:
        """What happens now is no evidence: GNSS is lost, the pose was reset, or the vehicle does not fly."""
        self._flying = None
        self.position.interrupt()
        self.velocity.interrupt()

    def note(self, nav: Array, P: Array, constants: Array, rows: Array) -> bool:
        """Called every ``PERIOD`` with the aided filter and the IMU ``rows`` (N, 7) since the last call, or more.

        True when a factor may have changed.
        """
        if self._flying is None:
            self._begin(nav, P, constants)
            return False
        flying = self._flying
        rows = rows[rows[:, at.IMU_T].searchsorted(flying[memory.NAV + at.TIME], side="right") :]
        memory.run_block(flying, rows, 0, len(rows), math.inf, np.empty((len(rows), at.OUT_COLUMNS)))
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
        """Squared drift of the horizontal velocity in parts of what was to be expected."""
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
        """Deviations in parts of those that are set, and the number of trials that say so."""
        return {
            "noise.imu": math.sqrt(self.imu_variance),
            "noise.gnss": math.sqrt(self.gnss_variance),
            "noise.trials": float(self.trials),
        }
