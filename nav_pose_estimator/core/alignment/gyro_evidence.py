"""Evidence for a wrong scale of the gyroscope, from the filter's estimate of scale factors and misalignments.

The filter estimates the matrix M (``blocks.GYRO_MATRIX``) with a narrow prior of variance v about a centre c. Its
posterior N(m, P) still holds all that the observations have said about M, as the information J = P^-1 - I/v and
h = P^-1 (m - c). The same information can be weighed against a prior with wide scale factors. The Bayes factor of the
two priors is the evidence for a gyroscope of another range, sign or axis. It needs no second filter:

    narrow posterior   C = (J + I/v)^-1,  d = C h
    added scales       M = c + n + B a,  n ~ N(0, v I),  a ~ N(0, w I)
    information on a   K = B' (v I - C) B / v^2,  g = B' d / v
    log Bayes factor   -1/2 log det(I + w K) + 1/2 g' (K + I/w)^-1 g

B has one column for a scale common to all axes, or for that of one axis, or three for each axis. Without the second,
axes that have been seen to be right would count against a third that has not. The scale factors of a sound gyroscope
without calibration are wrong by some per cent, more than the filter's prior says. So a small w is an explanation by a
right gyroscope, and the evidence is against the better one of this and of w = 0.

What a second adds to J and h is divided by its variance of unit weight where that exceeds one, as noise of that
variance would do. A shock, a tumble or a late velocity gives large innovations for a moment, and little evidence.

The random walk of M takes from the information in every second: q P^-1 P^-1, q its variance in a second. The filter's
own loss is added back, and J loses q J J, what the walk takes from what has been counted. The two differ after a second
that does not count, as after an outage, whose covariance is that of the drift which rehearsals have shown: J would
become negative in directions that nothing has shown.

Source of the test: R. Kass and A. Raftery, "Bayes factors", J. Am. Stat. Assoc. 90(430), 1995; the formulas follow by
completing the square.
"""

import math

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.filter.kalman import factorise
from nav_pose_estimator.core.numerics.jit import kernel

Array = NDArray[np.float64]

SIZE = 9  # elements of M, row-major
_SCALES = (0, 4, 8)  # those on the diagonal
_WIDE = (0.3**2, 1.0)  # variances of scale factors: of a gyroscope of another range, of another sign or axis
_SMALL = 0.02**2  # the same of a sound gyroscope, beyond the narrow prior
_CHOICE = math.log(3.0)  # each single axis has a third of the prior probability
_GREW = 1.01  # growth of a variance within a second beyond the driving noise


class GyroEvidence:
    """Collects the evidence second by second.

    ``centre`` (9,) and ``variance`` are those of the narrow prior.
    """

    def __init__(self) -> None:
        self.centre, self.variance = np.zeros(SIZE), 0.0
        self.odds = 0.0
        """Log Bayes factor of wrong scale factors against those of a sound gyroscope."""
        self.yaw_odds = 0.0
        """The same of z alone against exactly right ones: clearly negative where GNSS has shown z to be right."""
        self._before, self._variances = np.zeros((SIZE + 1, SIZE)), np.zeros(SIZE)
        self._total = np.zeros((SIZE + 1, SIZE))  # J, and h in the last row
        self._skips = False

    def add(self, m: Array, P: Array, nis: float, walk: float = 0.0) -> None:
        """Add a second, at whose end the filter has the estimate ``m`` (9,) with covariance ``P`` (9, 9).

        ``nis``: largest normalised innovation squared per row of the last GNSS velocities; ``walk``: variance of the
        random walk of each element in a second.
        """
        variances = P.diagonal().copy()
        if self.variance == 0.0:
            self.centre, self.variance = m.copy(), float(variances.max())
            self._skips = True
        # only a new prior or an enlarged covariance makes a variance grow, and neither is an observation
        skips = self._skips or bool((variances > _GREW * self._variances).any())
        weight = 0.0 if skips else 1.0 / max(nis, 1.0)
        self._variances, self._skips = variances, False
        if _add_information(P, m - self.centre, weight, walk, self._before, self._total):
            self.odds, self.yaw_odds = _log_bayes_factors(self._total, self.variance)

    def begin_again(self) -> None:
        """Forget all evidence: the filter has started again with a narrow prior."""
        self.variance = self.odds = self.yaw_odds = 0.0
        self._total[:] = 0.0

    def skip(self) -> None:
        """Leave the next second out, in which the covariance changes by more than observations."""
        self._skips = True


@kernel
def _add_information(P, away, weight, walk, before, total):
    """Add ``weight`` times the new information to ``total`` (10, 9): P^-1 and P^-1 ``away`` less ``before`` (10, 9).

    The loss by the random ``walk`` is that of ``total``, not that of ``before``.
    """
    size = len(P)
    now = np.zeros((size + 1, size))
    if not _inverse(P, now):
        return False
    for i in range(size):
        for j in range(size):
            now[size, i] += now[i, j] * away[j]
    walked, counted = before.copy(), total.copy()
    for i in range(size + 1):
        for j in range(size):
            lost, lost_of_total = 0.0, 0.0
            for k in range(size):
                lost += walked[i, k] * walked[k, j]
                lost_of_total += counted[i, k] * counted[k, j]
            total[i, j] += weight * (now[i, j] - before[i, j] + walk * lost) - walk * lost_of_total
            before[i, j] = now[i, j]
    return True


@kernel
def _log_bayes_factors(total, variance):
    """Log Bayes factor of the best wide prior against the best right one, and that of z; -inf where invalid."""
    size = total.shape[1]
    precision, C = np.empty((size, size)), np.zeros((size, size))
    for i in range(size):
        for j in range(size):
            precision[i, j] = 0.5 * (total[i, j] + total[j, i])
        precision[i, i] += 1.0 / variance
    if not _inverse(precision, C):
        return -math.inf, -math.inf
    K, g = np.empty((3, 3)), np.zeros(3)
    common, slope = 0.0, 0.0
    for a in range(3):
        for j in range(size):
            g[a] += C[_SCALES[a], j] * total[size, j] / variance
        for b in range(3):
            K[a, b] = ((variance if a == b else 0.0) - C[_SCALES[a], _SCALES[b]]) / variance**2
            common += K[a, b]
        slope += g[a]
    common, best = max(common, 0.0), -math.inf
    for wide in _WIDE:
        best = max(best, _of_one_scale(common, slope, wide), _of_three_scales(K, g, wide))
        best = max(best, _of_one_axis(K, g, wide) - _CHOICE)
    sound = max(_of_one_scale(common, slope, _SMALL), _of_three_scales(K, g, _SMALL), _of_one_axis(K, g, _SMALL))
    return best - max(0.0, sound), _of_one_scale(max(K[2, 2], 0.0), g[2], _WIDE[0])


@kernel
def _of_one_scale(K, g, wide):
    """Log Bayes factor of a common scale of variance ``wide``; ``K`` and ``g`` are the information on it."""
    return -0.5 * math.log(1.0 + wide * K) + 0.5 * g**2 / (K + 1.0 / wide)


@kernel
def _of_one_axis(K, g, wide):
    """Largest log Bayes factor of a scale of variance ``wide`` of one axis; ``K`` (3, 3) and ``g`` (3,) as below."""
    best = -math.inf
    for a in range(3):
        best = max(best, _of_one_scale(max(K[a, a], 0.0), g[a], wide))
    return best


@kernel
def _of_three_scales(K, g, wide):
    """Log Bayes factor of three scales of variance ``wide``; minus infinity where invalid.

    ``K`` (3, 3) and ``g`` (3,) are the information on them.
    """
    L, whitened = K.copy(), np.empty(3)
    odds = -1.5 * math.log(wide)
    for i in range(3):
        L[i, i] += 1.0 / wide
    if not factorise(L):
        return -math.inf
    for i in range(3):
        left = g[i]
        for k in range(i):
            left -= L[i, k] * whitened[k]
        whitened[i] = left / L[i, i]
        odds += 0.5 * whitened[i] ** 2 - math.log(L[i, i])
    return odds


@kernel
def _inverse(S, out):
    """Write the inverse of the positive definite ``S`` (n, n) to the first n rows of ``out``; False where it is not."""
    size = len(S)
    L = S.copy()
    if not factorise(L):
        return False
    column = np.empty(size)
    for j in range(size):
        for i in range(size):
            left = 1.0 if i == j else 0.0
            for k in range(i):
                left -= L[i, k] * column[k]
            column[i] = left / L[i, i]
        for i in range(size - 1, -1, -1):
            left = column[i]
            for k in range(i + 1, size):
                left -= L[k, i] * out[k, j]
            out[i, j] = left / L[i, i]
    return True
