"""Multiple-model filter for outages: one branch of the filter for each hypothesis on the vehicle's motion.

The filter splits when GNSS is lost and nothing else bounds the drift: in one branch the vehicle travels as the network
predicts, in the other it hovers. Every half second each branch is corrected by what its hypothesis implies for the
velocity, and the likelihood of that observation updates its probability (interacting multiple model, Blom and
Bar-Shalom 1988). A wrong hypothesis cannot corrupt the other branch, and the output, mean and covariance of the
mixture, includes the uncertainty of the decision. Unlike the textbook's algorithm, the branches are mixed after each
hypothesis has been evaluated on each branch (generalised pseudo-Bayesian filter of second order, GPB2).
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from operator import is_
from typing import Any

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import memory
from nav_pose_estimator.core.filter.blocks import GYRO_MATRIX, WIND, with_block
from nav_pose_estimator.core.filter.mixture import blend_rows
from nav_pose_estimator.core.motion import hypotheses
from nav_pose_estimator.engine.observation import FilterView
from nav_pose_estimator.engine.samples import Hypothesis, MotionEvidence

_LEAST_WEIGHT = 1e-4  # smallest probability of a hypothesis, so that it can recover
_REMEMBERED = 10.0  # s: the longest memory of checkpoints
_DRIVING_NOISE = np.r_[at.GYRO_NOISE_PSD, at.ACCEL_NOISE_PSD, at.GYRO_BIAS_PSD, at.ACCEL_BIAS_PSD, GYRO_MATRIX.psd]
_POSITION = slice(at.DPOS, at.DPOS + 3)
_UNKNOWN = (math.nan, math.nan, math.nan)


class Branches:
    """Branches of the filter with their weights; each is a ``core.filter.memory`` with wind states and checkpoints."""

    def __init__(self, trunk: np.ndarray, slots: int, evidence: MotionEvidence) -> None:
        """Split the filter of the memory ``trunk`` into the hypotheses of ``evidence``, and add wind states from it."""
        n = int(trunk[memory.STATES])
        self._drift_variance = evidence.drift_variance
        self._lost_at = trunk[memory.NAV + at.LAT : memory.NAV + at.VEL].copy()  # where GNSS was lost
        self._left = math.inf  # s: when the vehicle clearly left that area
        self._ended = [math.inf] * len(evidence.hypotheses)  # s: when each first had a probability of at most one half
        stated = trunk[memory.HEAD : memory.HEAD + n * n].reshape(n, n)
        known = self._drift_variance * stated
        # rehearsals say nothing about the error of the position at the loss of GNSS: it keeps its stated variance
        known[_POSITION, _POSITION] += (1.0 - self._drift_variance) * stated[_POSITION, _POSITION]
        constants, P = trunk[memory.CONSTANTS : memory.ORIGIN].copy(), known
        self._wind_is_measured = WIND.is_in(constants)
        if not self._wind_is_measured:
            constants, P = with_block(constants, known, WIND, evidence.wind_cov)
            constants[WIND.psd] = 2.0 * evidence.wind_spread / evidence.wind_tau
            constants[WIND.rate] = 1.0 / evidence.wind_tau
        constants[_DRIVING_NOISE] *= evidence.drift_variance
        branch = memory.make(constants, slots, trunk[memory.PERIOD])
        branch[memory.ORIGIN : memory.STATES] = trunk[memory.ORIGIN : memory.STATES]
        branch[memory.NAV : memory.CONSTANTS] = trunk[memory.NAV : memory.CONSTANTS]
        if not self._wind_is_measured:
            _nav(branch)[WIND.estimates] = evidence.wind
        branch[memory.NAV + at.GYRO_WANDER] *= self._drift_variance
        branch[memory.HEAD : memory.HEAD + P.size] = P.ravel()
        memory.add_checkpoint(branch)
        self._hold(np.tile(branch, (len(evidence.hypotheses), 1)))
        self.weights = np.array([h.probability for h in evidence.hypotheses])
        self.names = tuple(h.name for h in evidence.hypotheses)
        self._decisions = deque([(-math.inf, self.weights)])  # (time, weights from then on), as far back as checkpoints

    def _hold(self, memories: np.ndarray) -> None:
        self.memories = memories
        self.vectors = list(memories)
        constants = memories[0, memory.CONSTANTS : memory.ORIGIN]  # the same for all branches
        self.views = [FilterView(_nav(one), _covariance(one), constants) for one in self.vectors]

    def __getstate__(self) -> dict[str, Any]:
        """The state for a copy, without views."""
        return {name: value for name, value in self.__dict__.items() if name not in ("vectors", "views")}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore a copy; its views refer to its own memories."""
        self.__dict__ = state
        self._hold(self.memories)

    def probability(self, name: str) -> float:
        """Probability of the hypothesis ``name``."""
        return float(self.weights[self.names.index(name)])

    def run(self, rows: np.ndarray, begin: int, end: int, due: float, out: np.ndarray) -> int:
        """``memory.run_block`` for each branch; ``out`` receives the solution of the mixture."""
        if len(self.vectors) == 1:
            return int(memory.run_block(self.vectors[0], rows, begin, end, due, out))
        own = np.empty((len(self.vectors), *out.shape))
        for one, own_rows in zip(self.vectors, own, strict=True):
            stop = memory.run_block(one, rows, begin, end, due, own_rows)
        first = len(out) - end
        blend_rows(own, self.weights, first + begin, first + stop, out)
        return stop

    def restore_before(self, t: float) -> float:
        """Restore the last checkpoint before ``t`` [s]; returns its time."""
        for one in self.vectors:
            memory.restore_before(one, t)
        now = float(self.memories[0][memory.NAV + at.TIME])
        while len(self._decisions) > 1 and self._decisions[-1][0] > now:
            self._decisions.pop()
        self.weights = self._decisions[-1][1]
        self._left = math.inf if self._left > now else self._left
        self._ended = [math.inf if ended > now else ended for ended in self._ended]
        return now

    def mix_into(self, trunk: np.ndarray) -> None:
        """Merge the branches into the filter of the memory ``trunk``, without the wind states that were added."""
        memory.mix(self.memories, self.weights, trunk)
        trunk[memory.NAV + at.GYRO_WANDER] /= self._drift_variance

    def decide(self, evidence: MotionEvidence) -> None:
        """Apply each hypothesis to each branch, weight the results by their likelihoods, and merge by hypothesis.

        A vehicle that travels at 7 m/s cannot hover the next moment. So the likelihood of a hypothesis is evaluated on
        each branch that it may follow, not on their mixture, whose covariance allows both.
        """
        now = float(self.memories[0, memory.NAV + at.TIME])
        # From where the vehicle has left the area on, the prior on the place is dropped: on a straight flight, the
        # growing drift would otherwise soon make it consistent again and pull the vehicle back.
        first = _table(evidence.hypotheses)
        if self._left > now and hypotheses.has_left(self.memories, self._lost_at, first):
            self._left = now
        self._ended = [
            ended if likely > 0.5 else min(ended, now) for ended, likely in zip(self._ended, self.weights, strict=True)
        ]
        lasting = [
            one.lasting if one.lasting is not None and math.isinf(ended) else one
            for one, ended in zip(evidence.hypotheses, self._ended, strict=True)
        ]
        chosen = first if all(map(is_, lasting, evidence.hypotheses)) else _table(lasting)
        lost_at = self._lost_at if math.isinf(self._left) else np.full(3, math.nan)
        said = _said(evidence, fades=not self._wind_is_measured)
        likely = hypotheses.decide(self.memories, self.weights, lost_at, said, chosen).tolist()
        if not any(likely):
            return
        self.weights = np.array(_shares([max(share, _LEAST_WEIGHT) for share in _shares(likely)]))
        while self._decisions and self._decisions[0][0] < now - _REMEMBERED:
            self._decisions.popleft()
        self._decisions.append((now, self.weights))


def _shares(values: list[float]) -> list[float]:
    """``values`` over their sum, in which numpy's calls for so few numbers would take most of the time."""
    total = 0.0
    for value in values:  # Python's ``sum`` rounds otherwise than numpy's
        total += value
    return [value / total for value in values]


def _said(evidence: MotionEvidence, fades: bool) -> np.ndarray:
    """Evidence (EVIDENCE_SIZE,) for ``core.motion.hypotheses``; ``fades``: the wind goes back to its mean."""
    decay = math.exp(-evidence.interval / evidence.wind_tau) if fades else 1.0
    head = (evidence.interval, evidence.dwell, evidence.correlation, evidence.unmodelled_var, decay)
    air = evidence.air_velocity or _UNKNOWN
    return np.array(
        [
            *head,
            *evidence.wind_mean,
            *evidence.attitude.ravel().tolist(),
            *evidence.velocity,
            *evidence.body_velocity,
            *air,
        ]
    )


def _table(assumed: Sequence[Hypothesis]) -> np.ndarray:
    """Hypotheses as rows (K, HYPOTHESIS_SIZE) for ``core.motion.hypotheses``."""
    rows = [
        (
            *(one.velocity_var, one.velocity_time, one.log_likelihood, one.doubt_psd, one.place_var, one.place_time),
            *(one.air_noise or _UNKNOWN),
            one.air_corrects,
        )
        for one in assumed
    ]
    return np.array(rows, float)  # None becomes NaN


def _nav(branch: np.ndarray) -> np.ndarray:
    return branch[memory.NAV : memory.CONSTANTS]


def _covariance(branch: np.ndarray) -> np.ndarray:
    n = int(branch[memory.STATES])
    return branch[memory.HEAD : memory.HEAD + n * n].reshape(n, n)
