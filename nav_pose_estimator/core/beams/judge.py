"""Fault detection and noise estimation per beam: gate, parity test, latch and variational measurement noise.

Each beam is tested by its own innovation with its nominal noise, so that a faulty beam does not discard the others.

* Gate: a beam is flagged when its NIS exceeds ``GATE``.
* Parity: for the null vector c of four beam directions, c . z does not depend on the velocity, however uncertain that
  is. Where it exceeds its variance, the beam without which the others agree clearly better is flagged. The running mean
  of the innovations that passed the gate is tested in the same way. It reveals a bias too small for a single message,
  before the navigator follows it.
* Latch: a small fault passes the gate now and then, and would pull the state until nothing is flagged. A beam that is
  flagged often is excluded until it has agreed for a while.
* Noise: an inverse gamma distribution of each beam's variance, estimated jointly with the velocity from the beams in
  use.

Sources: S. Sarkka and A. Nummenmaa, Recursive noise adaptive Kalman filtering by variational Bayesian approximations,
IEEE Trans. Automatic Control 54(3), 2009, algorithm 1; J. E. Potter and M. C. Suman, Thresholdless redundancy
management with arrays of skewed instruments, AGARDograph 224, 1977 (parity).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.filter.layout import DVEL
from nav_pose_estimator.core.filter.measurements import BEAMS
from nav_pose_estimator.core.numerics.jit import kernel

Array = NDArray[np.float64]

USED, LOST, GATED, PARITY, OUT = 0, 1, 2, 3, 4
"""Verdicts: in use; no velocity; rejected by the gate; rejected by the parity test; excluded by the latch."""
GATE = 10.8
"""NIS of one beam, chi-squared with 1 degree of freedom: a sound beam exceeds it once in a thousand messages."""
_MILD = 4.0  # NIS that a sound beam exceeds once in twenty messages
_MARGIN = 4.0  # difference of NIS between the best and the second best beam to leave out
_OUT_ABOVE, _IN_BELOW = 0.35, 0.2  # flag rates at which the latch excludes a beam and takes it back
_FLAG_MEMORY, _MILD_MEMORY = 0.9, 0.95  # forgetting factors per message of the rates of flags and of mild innovations
_NOISE_MEMORY = 0.97  # forgetting factor per message of the noise estimate
_MEAN_MEMORY = 0.9  # forgetting factor per message of the mean innovation
_MEAN_SHARE = (1.0 - _MEAN_MEMORY) / (1.0 + _MEAN_MEMORY)  # variance of that mean relative to one innovation's
_MEAN_GATE = 15.0  # parity gate of the mean: larger than ``GATE``, because consecutive means are correlated
_TURNS = 4  # fixed-point iterations of the variational noise
_LEAST_FACTOR, _LARGEST_FACTOR = 0.25, 1e4  # bounds of the estimated variance, relative to the nominal one
_FLAGS, _MILDS, _IS_OUT, _SHAPE, _FACTOR, _MEAN = 0, 1, 2, 3, 4, 5  # columns of the memory of a beam
_COLUMNS = 6


class Judged(NamedTuple):
    """Result for n beams, each array (n,).

    ``verdict``; ``variance`` of the measurement noise to be used [m^2/s^2]; ``nis`` with the nominal noise;
    ``nominal`` noise variance [m^2/s^2]; ``spread``, the innovation variance H P H' + R with it [m^2/s^2].
    """

    verdict: NDArray[np.int64]
    variance: Array
    nis: Array
    nominal: Array
    spread: Array


def _new_memory() -> Array:
    memory = np.zeros((BEAMS, _COLUMNS))
    memory[:, _SHAPE], memory[:, _FACTOR] = 2.0, 1.0
    return memory


class Parts(NamedTuple):
    """Which of the tests are active; without ``noise`` each beam has its nominal noise."""

    gate: bool = True
    parity: bool = True
    latch: bool = True
    noise: bool = True


ALL_PARTS = Parts()


@dataclass
class BeamJudge:
    """The tests, with a memory of up to ``BEAMS`` beams. Points of a cloud have no history: only the gate applies."""

    parts: Parts = ALL_PARTS
    memory: Array = field(default_factory=_new_memory)

    def judge(self, z: Array, H: Array, P: Array, nominal: Array, are_beams: bool) -> Judged:
        """Test innovations ``z`` (n,) [m/s], NaN where lost, with rows ``H`` (n, states), variances ``nominal`` (n,).

        ``are_beams``: row i is always the same beam, and there are at most ``BEAMS``; otherwise the rows are points of
        a cloud, which differ from message to message.
        """
        return Judged(*_judge(z, H, P, nominal, self.memory, are_beams, *self.parts))

    @property
    def factors(self) -> Array:
        """Estimated noise variance of each beam, relative to the nominal one (BEAMS,)."""
        return self.memory[:, _FACTOR]

    @property
    def flag_rates(self) -> Array:
        """Recent rate of flags of each beam, 0 to 1 (BEAMS,)."""
        return self.memory[:, _FLAGS]

    @property
    def out(self) -> NDArray[np.bool_]:
        """Which beams the latch excludes (BEAMS,)."""
        return self.memory[:, _IS_OUT] > 0.0


@kernel
def _judge(z, H, P, nominal, memory, has_history, gates, compares, latches, adapts):
    """The fields of ``Judged``; ``memory`` (BEAMS, _COLUMNS) is updated where the beams have a history.

    The last four arguments are those of ``Parts``.
    """
    n = len(z)
    A = _spread(H, P)
    verdict = np.zeros(n, np.int64)
    nis, variance, spread = np.empty(n), nominal.copy(), np.empty(n)
    for i in range(n):
        spread[i] = A[i, i] + nominal[i]
        nis[i] = z[i] * z[i] / spread[i]
        if not nis[i] < math.inf:
            verdict[i] = LOST
        elif nis[i] > GATE and gates:
            verdict[i] = GATED
    if has_history:
        if compares:
            _check_parity(z, H, A, nominal, memory, verdict)
        for i in range(n):
            if verdict[i] != LOST and latches:
                of_mean = memory[i, _MEAN] * memory[i, _MEAN] / (A[i, i] + _MEAN_SHARE * nominal[i])
                _remember(memory[i], verdict[i] != USED, nis[i] > _MILD, of_mean > _MILD)
                if memory[i, _IS_OUT] > 0.0 and verdict[i] == USED:
                    verdict[i] = OUT
        if adapts:
            _adapt(z, A, nominal, memory, verdict, variance)
    return verdict, variance, nis, nominal, spread


@kernel
def _spread(H, P):
    """H P H' (n, n), skipping the zeros of H."""
    n, states = H.shape
    A = np.zeros((n, n))
    row = np.empty(states)
    for i in range(n):
        for k in range(states):
            row[k] = 0.0
        for j in range(states):
            h = H[i, j]
            if h != 0.0:
                for k in range(states):
                    row[k] += h * P[j, k]
        for m in range(n):
            for k in range(states):
                A[i, m] += row[k] * H[m, k]
    return A


@kernel
def _remember(beam, is_flagged, is_mild, is_biased):
    """Update the flag rates and the latch of one ``beam`` (_COLUMNS,)."""
    beam[_FLAGS] = _FLAG_MEMORY * beam[_FLAGS] + (1.0 - _FLAG_MEMORY) * (1.0 if is_flagged else 0.0)
    beam[_MILDS] = _MILD_MEMORY * beam[_MILDS] + (1.0 - _MILD_MEMORY) * (1.0 if is_mild else 0.0)
    if beam[_FLAGS] > _OUT_ABOVE:
        beam[_IS_OUT] = 1.0
    elif beam[_FLAGS] < _IN_BELOW and beam[_MILDS] < _IN_BELOW and not is_biased:
        beam[_IS_OUT] = 0.0


@kernel
def _check_parity(z, H, A, nominal, memory, verdict):
    """Flag one of four beams where the parity test fails, now or in the mean, and one beam alone explains it."""
    for i in range(len(z)):
        if verdict[i] == USED:
            memory[i, _MEAN] += (1.0 - _MEAN_MEMORY) * (z[i] - memory[i, _MEAN])
    if len(z) != BEAMS:
        return
    for i in range(BEAMS):
        if verdict[i] != USED or memory[i, _IS_OUT] > 0.0:
            return
    c = _null_vector(H)
    which = _odd_one_out(z, A, nominal, c, GATE)
    if which < 0:
        which = _odd_one_out(memory[:, _MEAN].copy(), A, _MEAN_SHARE * nominal, c, _MEAN_GATE)
    if which >= 0:
        verdict[which] = PARITY


@kernel
def _odd_one_out(z, A, noise, c, gate):
    """Index of the beam without which the innovations ``z`` (4,) of covariance A + diag(noise) agree.

    -1 where the parity ``c`` . z is within its ``gate``, or no beam is clearly the faulty one.
    """
    parity, spread = 0.0, 0.0
    for i in range(BEAMS):
        parity += c[i] * z[i]
        spread += c[i] * c[i] * noise[i]
        for j in range(BEAMS):
            spread += c[i] * A[i, j] * c[j]
    if not parity * parity > gate * spread:
        return -1
    best, second, which = math.inf, math.inf, -1
    for i in range(BEAMS):
        rest = _nis_without(z, A, noise, i)
        if rest < best:
            best, second, which = rest, best, i
        elif rest < second:
            second = rest
    return which if second - best >= _MARGIN else -1


@kernel
def _null_vector(H):
    """Parity vector c (4,): c . (velocities along four beams) = 0 for every velocity; signed triple products."""
    c = np.empty(BEAMS)
    others = np.empty((3, 3))
    for i in range(BEAMS):
        row = 0
        for j in range(BEAMS):
            if j != i:
                for k in range(3):
                    others[row, k] = H[j, DVEL + k]
                row += 1
        volume = (
            others[0, 0] * (others[1, 1] * others[2, 2] - others[1, 2] * others[2, 1])
            - others[0, 1] * (others[1, 0] * others[2, 2] - others[1, 2] * others[2, 0])
            + others[0, 2] * (others[1, 0] * others[2, 1] - others[1, 1] * others[2, 0])
        )
        c[i] = volume if i % 2 == 0 else -volume
    return c


@kernel
def _nis_without(z, A, nominal, left_out):
    """Joint NIS of all beams but one."""
    m = len(z) - 1
    S, rest = np.empty((m, m)), np.empty((m, 1))
    row = 0
    for i in range(len(z)):
        if i == left_out:
            continue
        rest[row, 0] = z[i]
        column = 0
        for j in range(len(z)):
            if j != left_out:
                S[row, column] = A[i, j] + (nominal[i] if i == j else 0.0)
                column += 1
        row += 1
    solved = rest.copy()
    _solve(S, solved)
    total = 0.0
    for i in range(m):
        total += rest[i, 0] * solved[i, 0]
    return total


@kernel
def _solve(S, B):
    """``B`` (m, k) <- S^-1 B for a positive definite ``S`` (m, m), by elimination without pivots; S is overwritten."""
    m, k = B.shape
    for i in range(m):
        for row in range(m):
            if row != i:
                ratio = S[row, i] / S[i, i]
                for j in range(i, m):
                    S[row, j] -= ratio * S[i, j]
                for j in range(k):
                    B[row, j] -= ratio * B[i, j]
    for i in range(m):
        for j in range(k):
            B[i, j] /= S[i, i]


@kernel
def _adapt(z, A, nominal, memory, verdict, variance):
    """Variational estimate of the noise of the beams in use: fixed-point iterations of velocity and variances."""
    used = np.flatnonzero(verdict == USED)
    m = len(used)
    if m == 0:
        return
    factors = memory[used, _FACTOR].copy()
    S, solved = np.empty((m, m)), np.empty((m, m + 1))  # S^-1 [z, A]
    for _ in range(_TURNS):
        for a in range(m):
            solved[a, 0] = z[used[a]]
            for b in range(m):
                S[a, b] = solved[a, b + 1] = A[used[a], used[b]]
            S[a, a] += factors[a] * nominal[used[a]]
        _solve(S, solved)
        for a in range(m):
            beam, R = used[a], factors[a] * nominal[used[a]]
            residual, left = R * solved[a, 0], R * solved[a, a + 1]  # z - A S^-1 z and A - A S^-1 A
            weight = _NOISE_MEMORY * memory[beam, _SHAPE]
            seen = (residual * residual + max(left, 0.0)) / nominal[beam]
            factor = (weight * memory[beam, _FACTOR] + 0.5 * seen) / (weight + 0.5)
            factors[a] = min(max(factor, _LEAST_FACTOR), _LARGEST_FACTOR)
    for a in range(m):
        memory[used[a], _SHAPE] = _NOISE_MEMORY * memory[used[a], _SHAPE] + 0.5
        memory[used[a], _FACTOR] = factors[a]
        variance[used[a]] = factors[a] * nominal[used[a]]
