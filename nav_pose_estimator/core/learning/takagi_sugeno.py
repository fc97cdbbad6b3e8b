"""Layers of a first-order Takagi-Sugeno fuzzy network with generalised bell membership functions (Jang 1993).

Rule i reads: if x_1 is A_i1 and ... and x_n is A_in then y = theta_i [x, 1]. With u = (x - c) / a:

    layer 1   mu = 1 / (1 + |u|^(2 b))                    membership, a generalised bell
    layer 2   w_i = prod_j mu_ij                          firing strength
    layer 3   wn_i = w_i / sum_i w_i                      normalised firing strength
    layer 4   wn_i theta_i [x, 1]                         weighted consequent
    layer 5   y = sum_i wn_i theta_i [x, 1]               output

Layers 1 to 3 are computed as logarithms: a product of ten memberships underflows, their sum does not. All outputs share
the premises. Inputs arrive transposed, one row per input and one column per sample, so that every whole-array operation
runs along contiguous samples. Everything here works on standardised numbers, except ``predict_row``.
"""

import math
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.numerics.jit import inlined, kernel

_BLOCK = 16384  # numbers per temporary array: they stay in the second-level cache, three times faster than whole arrays
_TINY = 1e-24  # floor of the squared distance from a centre, so that its logarithm is finite
_HUGE = 600.0  # limit of an exponent: a membership is at least exp(-600)
_FULL = 1e40  # limit of a product before its logarithm is taken: times exp(600) it is still finite


@dataclass(frozen=True)
class Premises:
    """Membership functions of R rules on n inputs: ``centre``, ``width`` > 0, ``slope`` > 1/2, each (n, R)."""

    centre: np.ndarray
    width: np.ndarray
    slope: np.ndarray

    @property
    def rules(self) -> int:
        return self.centre.shape[1]

    @property
    def scales(self) -> np.ndarray:
        """(3, n, R): the part of the derivatives of ``log_firing`` that is the same for all samples."""
        return np.stack([2.0 * self.slope, 2.0 * self.slope, np.expm1(0.5 - self.slope)])

    def vector(self) -> np.ndarray:
        """The membership functions as unconstrained parameters (3 n R,): c, ln a, softplus^-1(b - 1/2)."""
        slope = self.slope - 0.5
        return np.stack([self.centre, np.log(self.width), slope + np.log(-np.expm1(-slope))]).ravel()

    def with_vector(self, vector: np.ndarray) -> "Premises":
        """Membership functions of the same shape from ``vector``: the inverse of ``vector()``."""
        centre, log_width, raw_slope = vector.reshape(3, *self.centre.shape)
        return Premises(centre, np.exp(log_width), 0.5 + np.logaddexp(0.0, raw_slope))


def log_firing(premises: Premises, inputs: np.ndarray, slopes: np.ndarray | None = None) -> np.ndarray:
    """Layers 1 and 2: ln w, (R, N). ``inputs`` (n, N).

    ``slopes`` (3, n, R, N) is filled with the derivatives of ln mu by c, ln a and softplus^-1(b - 1/2), divided by
    ``premises.scales``; 0 by c at x = c. With u = (x - c) / a the derivatives are 2 b (1 - mu) / (x - c), 2 b (1 - mu)
    and -d b / d raw (1 - mu) ln u^2.
    """
    (n, rules), samples = premises.centre.shape, inputs.shape[1]
    centre, slope = premises.centre[:, :, None], premises.slope[:, :, None]
    log_width2 = 2.0 * np.log(premises.width)[:, :, None]
    log_w = np.empty((rules, samples))
    block = max(32, _BLOCK // (n * rules))
    for start in range(0, samples, block):
        part = slice(start, start + block)
        distance = inputs[:, None, part] - centre
        log_u2 = np.square(distance)
        if slopes is not None and log_u2.min() <= _TINY:
            distance[np.abs(distance) <= math.sqrt(_TINY)] = np.inf
        np.log(np.maximum(log_u2, _TINY, out=log_u2), out=log_u2)
        log_u2 -= log_width2
        power = log_u2 * slope
        np.exp(np.minimum(power, _HUGE, out=power), out=power)
        total = power + 1.0
        if slopes is not None:
            by_centre, by_width, by_slope = slopes[..., part]
            complement = np.divide(power, total, out=by_width)  # 1 - mu
            np.multiply(complement, log_u2, out=by_slope)
            np.divide(complement, distance, out=by_centre)
        np.sum(np.log(total, out=total), axis=0, out=log_w[:, part])
    return np.negative(log_w, out=log_w)


def normalise_firing(log_w: np.ndarray) -> np.ndarray:
    """Layer 3 from ln w (R, N): softmax over the rules, each column sums to 1."""
    firing = np.exp(log_w - log_w.max(axis=0))
    firing /= firing.sum(axis=0)
    return firing


def with_one(inputs: np.ndarray) -> np.ndarray:
    """[x, 1] for every sample: (n, N) -> (n + 1, N)."""
    return np.vstack([inputs, np.ones(inputs.shape[1])])


def design_matrix(firing: np.ndarray, extended: np.ndarray) -> np.ndarray:
    """Transposed regressors of the consequents, (R (n + 1), N): wn_i [x, 1], rule after rule."""
    return (firing[:, None, :] * extended[None, :, :]).reshape(-1, firing.shape[1])


def outputs(premises: Premises, consequents: np.ndarray, inputs: np.ndarray) -> np.ndarray:
    """Layer 5 over N samples. ``consequents`` (R (n + 1), m), ``inputs`` (n, N) -> (m, N)."""
    firing = normalise_firing(log_firing(premises, inputs))
    return consequents.T @ design_matrix(firing, with_one(inputs))


def pack(
    premises: Premises,
    consequents: np.ndarray,
    clip: float,
    in_mean: np.ndarray,
    in_gain: np.ndarray,
    out_mean: np.ndarray,
    out_scale: np.ndarray,
) -> np.ndarray:
    """A trained network as one flat array for ``predict_row``: a single array argument makes the call fast.

    n, R, m, clip | input mean, gain (1 / sd) | output mean, scale | per rule and input c, ln a^2, b | consequents.
    """
    n, rules = premises.centre.shape
    bells = np.stack([premises.centre.T, 2.0 * np.log(premises.width.T), premises.slope.T], axis=-1)
    head = (n, rules, consequents.shape[1], clip)
    return np.concatenate([head, in_mean, in_gain, out_mean, out_scale, bells.ravel(), consequents.ravel()])


@inlined
def _scaled(packed, x, limit, z):
    """Standardised inputs ``z`` (n,), clipped to +-limit, of a sample ``x`` (n,). False if ``x`` is not finite."""
    n = int(packed[0])
    for j in range(n):
        z[j] = 0.0
        if not math.isfinite(x[j]):
            return False
        if packed[4 + n + j] > 0.0:
            z[j] = min(max((x[j] - packed[4 + j]) * packed[4 + n + j], -limit), limit)
    return True


@inlined
def _log_firing_of(packed, bell, z):
    """ln w of the rule whose membership functions begin at ``bell``, for standardised inputs ``z`` (n,)."""
    log_w, product = 0.0, 1.0  # 1 / w = product exp(-log_w): one logarithm serves several memberships
    for j in range(len(z)):
        distance = z[j] - packed[bell + 3 * j]
        log_u2 = math.log(max(distance * distance, _TINY)) - packed[bell + 3 * j + 1]
        product *= 1.0 + math.exp(min(packed[bell + 3 * j + 2] * log_u2, _HUGE))
        if product > _FULL:
            log_w -= math.log(product)
            product = 1.0
    return log_w - math.log(product)


@kernel
def predict_row(packed, x, y):
    """All layers for one sample in physical units: ``x`` (n,) -> ``y`` (m,). False if ``x`` is not finite.

    The softmax is computed in one pass: the outputs are rescaled whenever a rule fires stronger than all before it.
    """
    n, rules, m = int(packed[0]), int(packed[1]), int(packed[2])
    bell = 4 + 2 * n + 2 * m
    theta = bell + 3 * n * rules
    z = np.empty(n)
    if not _scaled(packed, x, packed[3], z):
        return False
    for o in range(m):
        y[o] = 0.0
    strongest, total = -math.inf, 0.0
    for rule in range(rules):
        log_w = _log_firing_of(packed, bell + 3 * n * rule, z)
        if log_w > strongest:
            fade = math.exp(strongest - log_w)
            strongest = log_w
            total *= fade
            for o in range(m):
                y[o] *= fade
        w = math.exp(log_w - strongest)
        total += w
        for j in range(n + 1):
            weight = w * z[j] if j < n else w
            for o in range(m):
                y[o] += weight * packed[theta]
                theta += 1
    for o in range(m):
        y[o] = packed[4 + 2 * n + o] + packed[4 + 2 * n + m + o] * (y[o] / total)
    return True


@kernel
def strongest_firing(packed, x, limit):
    """max_i ln w_i of one sample ``x`` (n,) in physical units, clipped to +-limit; NaN if ``x`` is not finite."""
    n, rules, m = int(packed[0]), int(packed[1]), int(packed[2])
    bell, strongest = 4 + 2 * n + 2 * m, -math.inf
    z = np.empty(n)
    if not _scaled(packed, x, limit, z):
        return math.nan
    for rule in range(rules):
        strongest = max(strongest, _log_firing_of(packed, bell + 3 * n * rule, z))
    return strongest


@kernel
def predict_rows(packed, x, y):
    """``predict_row`` for every row of ``x`` (N, n) into ``y`` (N, m); false if any row is not finite."""
    finite = True
    for row in range(len(x)):
        finite = predict_row(packed, x[row], y[row]) and finite
    return finite
