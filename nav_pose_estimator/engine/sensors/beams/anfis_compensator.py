"""Neuro-fuzzy prediction of the error of a faulty beam, as in CN114459477B for a Doppler log.

The inputs are those of the source: innovation, its Mahalanobis distance with the nominal noise, and the noise estimated
from the innovations. The output is the beam's error. The source collects faulty beams while GNSS is good. Faults are
rare, so they are also simulated: a known error is added to the innovation of a healthy beam for some messages, in the
training data only. The premises are trained by particle swarm as in the source, or by conjugate gradient; one rule is
ridge regression.

All inputs are functions of the innovation. In an outage the innovation is the sum of the errors of beam and navigator,
which the network cannot separate.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.learning.anfis import Anfis

if TYPE_CHECKING:
    from nav_pose_estimator.engine.sensors.beams.compensation import BeamEvidence

Array = NDArray[np.float64]
_KEPT, _KEPT_HELD_OUT = 320, 160  # samples for training and for validation
_FIRST_FIT = 240  # samples before the first training; the next ones follow when the number has doubled
_BLOCK, _HELD_OUT_EVERY = 30.0, 4  # s: length of a block of time; every fourth block is held out for validation
_SMALLEST, _LARGEST = 1.0, 300.0  # simulated errors, in standard deviations of the innovation
_SHORTEST, _LONGEST = 1, 60  # duration of a simulated fault in messages
_NOISE_MEMORY = 0.97  # forgetting factor per message of the estimated noise
_STEPS = 12  # optimiser steps of a training, few enough to run between two messages
_STRANGE = 1.5  # novelty above which the network gives no prediction


@dataclass
class NoiseTrace:
    """Noise of each beam estimated from its innovations: an inverse gamma distribution with forgetting."""

    shape: Array
    scale: Array  # m^2/s^2

    @classmethod
    def of(cls, variance: Array) -> NoiseTrace:
        """Initial estimate ``variance`` (n,) [m^2/s^2] with the weight of four messages."""
        return cls(np.full(len(variance), 2.0), 2.0 * variance)

    def add(self, innovation: Array) -> Array:
        """Add an ``innovation`` (n,) [m/s]; returns the estimate (n,) [m^2/s^2], NaN for lost beams."""
        seen = np.isfinite(innovation)
        self.shape[seen] = _NOISE_MEMORY * self.shape[seen] + 0.5
        self.scale[seen] = _NOISE_MEMORY * self.scale[seen] + 0.5 * innovation[seen] ** 2
        return np.where(seen, self.scale / self.shape, np.nan)


@dataclass
class Rehearsal:
    """Simulated faults of healthy beams for the training data: constant or noisy, of random size and duration."""

    noise: NoiseTrace  # as estimated from the innovations with the simulated errors
    left: NDArray[np.int64]  # messages until the present fault ends
    size: Array  # m/s
    is_noisy: NDArray[np.bool_]
    rng: np.random.Generator

    @classmethod
    def of(cls, variance: Array, seed: int) -> Rehearsal:
        """The start for n beams with innovations of ``variance`` (n,), without faults."""
        n = len(variance)
        noise, rng = NoiseTrace.of(variance), np.random.default_rng(seed)
        return cls(noise, np.zeros(n, np.int64), np.zeros(n), np.zeros(n, bool), rng)

    def errors(self, variance: Array) -> Array:
        """Simulated errors (n,) [m/s] of the next message, whose innovations have ``variance`` (n,) [m^2/s^2]."""
        for i in np.flatnonzero(self.left == 0).tolist():
            self.left[i] = self.rng.integers(_SHORTEST, _LONGEST, endpoint=True)
            deviations = math.exp(self.rng.uniform(math.log(_SMALLEST), math.log(_LARGEST)))
            self.size[i] = self.rng.choice((-1.0, 1.0)) * deviations * math.sqrt(variance[i])
            self.is_noisy[i] = self.rng.random() < 1.0 / 3.0
            # each fault begins on a beam whose noise estimate is that of a sound one
            self.noise.shape[i], self.noise.scale[i] = 2.0, 2.0 * variance[i]
        self.left -= 1
        return self.size * np.where(self.is_noisy, self.rng.standard_normal(len(self.size)), 1.0)


@dataclass
class Reservoir:
    """Reservoir sampling: a uniformly random selection of all samples so far."""

    capacity: int
    rng: np.random.Generator
    rows: list[tuple[float, ...]] = field(default_factory=list)
    offered: int = 0

    def add(self, row: tuple[float, ...]) -> None:
        """Offer one more sample."""
        self.offered += 1
        if len(self.rows) < self.capacity:
            self.rows.append(row)
        elif (place := int(self.rng.integers(self.offered))) < self.capacity:
            self.rows[place] = row

    def samples(self) -> tuple[Array, Array]:
        """Inputs (N, 3) and errors (N, 1)."""
        table = np.array(self.rows)
        return table[:, :-1], table[:, -1:]


class AnfisCompensator:
    """Learns beam errors while GNSS is good, and predicts those of faulty beams without it.

    ``optimizer`` and ``rules`` as of ``Anfis``. ``cautious``: it predicts only while more beams are sound than faulty,
    since it would otherwise follow the navigator's own drift. It adds that drift to the variance of a prediction, and
    counts all messages of a fault as one, because their errors are equal. It is trained on up to ``_KEPT`` samples,
    whenever the number of samples seen has doubled.
    """

    def __init__(self, optimizer: str = "pso", rules: int = 6, seed: int = 0, cautious: bool = True) -> None:
        self.model = Anfis(rules, premise_optimizer=optimizer, iterations=_STEPS, seed=seed)
        self._seed, self._is_cautious = seed, cautious
        self._learnt = Reservoir(_KEPT, np.random.default_rng(seed))
        self._held_out = Reservoir(_KEPT_HELD_OUT, np.random.default_rng(seed + 1))
        self._next_fit = _FIRST_FIT
        self._noise: NoiseTrace | None = None
        self._rehearsal: Rehearsal | None = None
        self._left = (math.nan, math.nan)  # residual variance: constant part, and factor on the squared innovation
        self._error = math.nan  # m/s: RMS error over the held-out samples

    def learn(self, evidence: BeamEvidence) -> None:
        """Add real faults (error: the innovation) and simulated ones on healthy beams; train when it is time."""
        noise = self._follow(evidence)
        assert self._rehearsal is not None
        present = np.isfinite(evidence.innovation)
        healthy = present & ~evidence.flagged
        rehearsed = self._rehearsal.errors(evidence.variance)
        innovation = np.where(healthy, evidence.innovation + rehearsed, np.nan)
        rehearsal_noise = self._rehearsal.noise.add(innovation)
        is_held_out = int(evidence.t / _BLOCK) % _HELD_OUT_EVERY == _HELD_OUT_EVERY - 1
        reservoir = self._held_out if is_held_out else self._learnt
        for i in np.flatnonzero(present).tolist():
            if healthy[i]:
                x = _inputs(innovation[i], evidence.variance[i], rehearsal_noise[i])
                reservoir.add((*x, float(rehearsed[i])))
            else:
                x = _inputs(evidence.innovation[i], evidence.variance[i], noise[i])
                reservoir.add((*x, float(evidence.innovation[i])))
        if self._learnt.offered >= self._next_fit and len(self._held_out.rows) >= _FIRST_FIT // 4:
            self._fit()

    def predict(self, evidence: BeamEvidence) -> tuple[Array, Array]:
        """Predicted errors (n,) [m/s] and residual variances (n,); NaN before a training and for novel inputs."""
        noise = self._follow(evidence)
        error, left = np.full(len(noise), np.nan), np.full(len(noise), np.nan)
        if not self.model.trained or (self._is_cautious and not _most_are_sound(evidence)):
            return error, left
        for i in np.flatnonzero(evidence.flagged & np.isfinite(noise)).tolist():
            x = np.array(_inputs(evidence.innovation[i], evidence.variance[i], noise[i]))
            if self.model.novelty(x[None])[0] < _STRANGE:
                error[i] = self.model.predict_one(x)[0]
                left[i] = self._left[0] + self._left[1] * evidence.innovation[i] ** 2
                if self._is_cautious:
                    left[i] = _LONGEST * (left[i] + evidence.variance[i])
        return error, left

    def figures(self) -> dict[str, float]:
        """Status: number of samples, and RMS error over the held-out ones [m/s]."""
        return {
            "beams.compensation.samples": float(self._learnt.offered + self._held_out.offered),
            "beams.compensation.error": self._error,
        }

    def _follow(self, evidence: BeamEvidence) -> Array:
        """Noise (n,) [m^2/s^2] estimated from the innovations so far; restarts where the number of beams changes."""
        if self._noise is None or len(self._noise.shape) != len(evidence.innovation):
            variance = np.nan_to_num(evidence.variance, nan=1.0)
            self._noise, self._rehearsal = NoiseTrace.of(variance), Rehearsal.of(variance, self._seed)
        return self._noise.add(evidence.innovation)

    def _fit(self) -> None:
        self._next_fit = 2 * self._learnt.offered
        held_out = self._held_out.samples()
        self.model.fit(*self._learnt.samples(), *held_out)
        x, y = held_out
        missed = np.square(y - self.model.predict(x))[:, 0]
        self._error = float(np.sqrt(missed.mean()))
        squared = x[:, 0] ** 2
        weight = 1.0 / (np.median(squared) + squared)
        design = np.column_stack([weight, weight * squared])
        constant, growing = np.linalg.lstsq(design, weight * missed, rcond=None)[0].tolist()
        self._left = max(constant, 0.0), max(growing, 0.0)


def _most_are_sound(evidence: BeamEvidence) -> bool:
    return 2 * int(evidence.flagged.sum()) < int(np.isfinite(evidence.innovation).sum())


def _inputs(innovation: float, variance: float, noise: float) -> tuple[float, float, float]:
    """Inputs: innovation [m/s], and the logarithms of squared Mahalanobis distance and noise, which span decades."""
    return innovation, math.log(1e-6 + innovation**2 / variance), math.log(noise)
