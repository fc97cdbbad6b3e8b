"""Which beams of a message are sound, and how noisy they are: gate, parity, latch and variational noise of each beam.

Every beam is judged by its own innovation with its nominal noise, so that a faulty one takes no other with it.

* Gate: NIS above ``GATE`` flags a beam.
* Parity: the null vector c of the directions makes c . z free of the velocity, however badly that is known. Where it is
  too large for its variance, the beam whose absence explains the others clearly better is flagged. The mean of what
  the gate has passed of late is looked at in the same way: it shows a bias that no single message does, before the
  navigator has followed it.
* Latch: a small fault passes the gate now and then and would drag the state until nothing is flagged. A beam that is
  flagged often is out until it has agreed for a while.
* Noise: an inverse gamma distribution for each beam, found together with the velocity from the beams that are used.

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
"""Verdicts: in order; no velocity; refused by the gate; by parity; left out as it has been flagged too often."""
GATE = 10.8
"""NIS of one row that a sound beam exceeds once in a thousand."""
_MILD = 4.0  # NIS that a sound beam exceeds once in twenty
_MARGIN = 4.0  # of the NIS of three beams between the best and the second best explanation
_OUT_ABOVE, _IN_BELOW = 0.35, 0.2  # flag rates
_FLAG_MEMORY, _MILD_MEMORY = 0.9, 0.95
_NOISE_MEMORY = 0.97
_MEAN_MEMORY = 0.9
_MEAN_SHARE = (1.0 - _MEAN_MEMORY) / (1.0 + _MEAN_MEMORY)  # variance of that mean over that of one
_MEAN_GATE = 15.0  # NIS of a mean, of which many in a row are hardly independent
_TURNS = 4
_LEAST_FACTOR, _LARGEST_FACTOR = 0.25, 1e4  # of a variance
_FLAGS, _MILDS, _IS_OUT, _SHAPE, _FACTOR, _MEAN = 0, 1, 2, 3, 4, 5
_COLUMNS = 6


class Judged(NamedTuple):
    """Of n beams: the verdict; the variance of the noise to go by [m^2/s^2]; NIS with the nominal noise.

    ``nominal`` noise and ``spread``, the variance of the innovation with it, H P H' + R [m^2/s^2].
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
    """Which of the tests are made; without ``noise`` each beam has its nominal one."""

    gate: bool = True
    parity: bool = True
    latch: bool = True
    noise: bool = True


ALL_PARTS = Parts()


@dataclass
class BeamJudge:
    """What is remembered of each of up to ``BEAMS`` beams. Points of a cloud have no history: the gate judges them."""

    parts: Parts = ALL_PARTS
    memory: Array = field(default_factory=_new_memory)

    def judge(self, z: Array, H: Array, P: Array, nominal: Array, are_beams: bool) -> Judged:
        """Judge innovations ``z`` (n,), NaN where lost, with rows ``H`` (n, states) and variances ``nominal`` (n,).

        ``are_beams``: row i is always the same beam, and there are at most ``BEAMS``; else they are points.
        """
        return Judged(*_judge(z, H, P, nominal, self.memory, are_beams, *self.parts))

    @property
    def factors(self) -> Array:
        """Variance over the nominal one, of each beam."""
        return self.memory[:, _FACTOR]

    @property
    def flag_rates(self) -> Array:
        """How often each beam has been flagged of late, 0 to 1."""
        return self.memory[:, _FLAGS]

    @property
    def out(self) -> NDArray[np.bool_]:
        """Which beams are left out."""
        return self.memory[:, _IS_OUT] > 0.0


@kernel
def _judge(z, H, P, nominal, memory, has_history, gates, compares, latches, adapts):
    """See ``Judged``; ``memory`` (BEAMS, _COLUMNS) is brought up to date where the beams have a history.

    The last arguments are ``Parts``.
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
    """H P H' (n, n), without the zeros of H."""
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
    """Flag rates of one ``beam`` (_COLUMNS,), and whether it is out."""
    beam[_FLAGS] = _FLAG_MEMORY * beam[_FLAGS] + (1.0 - _FLAG_MEMORY) * (1.0 if is_flagged else 0.0)
    beam[_MILDS] = _MILD_MEMORY * beam[_MILDS] + (1.0 - _MILD_MEMORY) * (1.0 if is_mild else 0.0)
    if beam[_FLAGS] > _OUT_ABOVE:
        beam[_IS_OUT] = 1.0
    elif beam[_FLAGS] < _IN_BELOW and beam[_MILDS] < _IN_BELOW and not is_biased:
        beam[_IS_OUT] = 0.0


@kernel
def _check_parity(z, H, A, nominal, memory, verdict):
    """Flag one of four beams where they contradict each other, now or in the mean, and its absence explains that."""
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
    """The beam whose absence explains innovations ``z`` (4,), covariance A + diag(noise), that contradict each other.

    -1 where ``c`` . z is within its ``gate``, or none stands out.
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
    """c (4,) with c . (velocity along four beams) = 0 for every velocity: signed volumes of the other three."""
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
    """NIS of all beams but one, together."""
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
    """``B`` (m, k) <- S^-1 B for a positive definite ``S`` (m, m), which is used up: elimination needs no pivots."""
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
    """Noise of the beams that are used, by the residual and the spread that the state has with it; four turns."""
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
