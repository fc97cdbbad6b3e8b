"""A neuro-fuzzy network that predicts the error of a faulty beam: what CN114459477B does with a Doppler log.

Inputs are the text's: innovation, its Mahalanobis distance (with the nominal noise) and the noise that it makes one
believe in; the output is the beam's error. The text collects faulty beams while GNSS is good. Faults are rare, so they
are also rehearsed: a known error is put on the innovation of a healthy beam, for some messages. Nothing of that reaches
the filter. The premises are found by particle swarm as in the text, or by conjugate gradient; one rule is ridge
regression.

All inputs are functions of the innovation, and in an outage the innovation is beam error and navigator's error in one:
the network is an influence function that cannot tell them apart.
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
_KEPT, _KEPT_HELD_OUT = 320, 160  # samples that are learnt, and that the swarm is judged by
_FIRST_FIT = 240  # samples; then whenever the number has doubled
_BLOCK, _HELD_OUT_EVERY = 30.0, 4  # s: every fourth block of time is held out
_SMALLEST, _LARGEST = 1.0, 300.0  # rehearsed errors, in deviations of the innovation
_SHORTEST, _LONGEST = 1, 60  # messages that a rehearsed fault lasts
_NOISE_MEMORY = 0.97
_STEPS = 12  # of the optimiser in a training: it runs between two messages
_STRANGE = 1.5  # novelty from which the network has no answer


@dataclass
class NoiseTrace:
    """The noise of each beam as estimated from its innovations: an inverse gamma distribution that forgets."""

    shape: Array
    scale: Array  # m^2/s^2

    @classmethod
    def of(cls, variance: Array) -> NoiseTrace:
        """The start at ``variance`` (n,) [m^2/s^2], worth four messages."""
        return cls(np.full(len(variance), 2.0), 2.0 * variance)

    def add(self, innovation: Array) -> Array:
        """The estimate (n,) [m^2/s^2] with one more ``innovation`` (n,) [m/s]; NaN where that is lost."""
        seen = np.isfinite(innovation)
        self.shape[seen] = _NOISE_MEMORY * self.shape[seen] + 0.5
        self.scale[seen] = _NOISE_MEMORY * self.scale[seen] + 0.5 * innovation[seen] ** 2
        return np.where(seen, self.scale / self.shape, np.nan)


@dataclass
class Rehearsal:
    """Errors that healthy beams are given on paper: constant or noisy, of any size, one fault after the other."""

    noise: NoiseTrace
    left: NDArray[np.int64]  # messages
    size: Array  # m/s
    is_noisy: NDArray[np.bool_]
    rng: np.random.Generator

    @classmethod
    def of(cls, variance: Array, seed: int) -> Rehearsal:
        """Nothing is wrong yet with n beams."""
        n = len(variance)
        noise, rng = NoiseTrace.of(variance), np.random.default_rng(seed)
        return cls(noise, np.zeros(n, np.int64), np.zeros(n), np.zeros(n, bool), rng)

    def errors(self, variance: Array) -> Array:
        """The errors (n,) [m/s] of the next message, whose innovations have the ``variance`` (n,)."""
        for i in np.flatnonzero(self.left == 0).tolist():
            self.left[i] = self.rng.integers(_SHORTEST, _LONGEST, endpoint=True)
            deviations = math.exp(self.rng.uniform(math.log(_SMALLEST), math.log(_LARGEST)))
            self.size[i] = self.rng.choice((-1.0, 1.0)) * deviations * math.sqrt(variance[i])
            self.is_noisy[i] = self.rng.random() < 1.0 / 3.0
            # a fault begins on a beam that has been sound
            self.noise.shape[i], self.noise.scale[i] = 2.0, 2.0 * variance[i]
        self.left -= 1
        return self.size * np.where(self.is_noisy, self.rng.standard_normal(len(self.size)), 1.0)


@dataclass
class Reservoir:
    """A random choice among all samples so far, each as likely as any other."""

    capacity: int
    rng: np.random.Generator
    rows: list[tuple[float, ...]] = field(default_factory=list)
    offered: int = 0

    def add(self, row: tuple[float, ...]) -> None:
        """Offer one more."""
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
    """Learns beam errors while GNSS is good; answers for beams that have been found faulty without it.

    ``optimizer`` and ``rules`` as of ``Anfis``. ``cautious``: it answers only while more beams are sound than faulty,
    else it would follow the navigator's own drift; it counts that drift as noise of what it answers, and a whole fault
    as one answer, since it is wrong by the same for as long as that lasts. It is trained on up to ``_KEPT`` samples
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
        self._left = (math.nan, math.nan)  # variance of what is left: constant, and per innovation squared
        self._error = math.nan  # RMS over the held-out samples, m/s

    def learn(self, evidence: BeamEvidence) -> None:
        """Real faults, with the innovation as the error, and rehearsed ones on healthy beams; train when it is time."""
        noise = self._follow(evidence)
        assert self._rehearsal is not None
        present = np.isfinite(evidence.innovation)
        healthy = present & ~evidence.flagged
        rehearsed = self._rehearsal.errors(evidence.variance)
        innovation = np.where(healthy, evidence.innovation + rehearsed, np.nan)
        believed = self._rehearsal.noise.add(innovation)
        is_held_out = int(evidence.t / _BLOCK) % _HELD_OUT_EVERY == _HELD_OUT_EVERY - 1
        reservoir = self._held_out if is_held_out else self._learnt
        for i in np.flatnonzero(present).tolist():
            if healthy[i]:
                x = _inputs(innovation[i], evidence.variance[i], believed[i])
                reservoir.add((*x, float(rehearsed[i])))
            else:
                x = _inputs(evidence.innovation[i], evidence.variance[i], noise[i])
                reservoir.add((*x, float(evidence.innovation[i])))
        if self._learnt.offered >= self._next_fit and len(self._held_out.rows) >= _FIRST_FIT // 4:
            self._fit()

    def predict(self, evidence: BeamEvidence) -> tuple[Array, Array]:
        """Errors (n,) and the variances (n,) of what is left; NaN before the first training and for what is strange."""
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
        """How many samples were seen, and how well the held-out ones are predicted."""
        return {
            "beams.compensation.samples": float(self._learnt.offered + self._held_out.offered),
            "beams.compensation.error": self._error,
        }

    def _follow(self, evidence: BeamEvidence) -> Array:
        """The noise (n,) that the innovations so far make one believe in; begins anew with another number of beams."""
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
    """Innovation [m/s], and the logarithms of Mahalanobis distance squared and noise: they span decades."""
    return innovation, math.log(1e-6 + innovation**2 / variance), math.log(noise)
