"""Hypotheses on the vehicle's motion, each applied to each branch of the filter (``core.filter.memory``).

The evidence of an epoch and a hypothesis are vectors of the columns below; NaN: not known or not used. Frames, units
and meaning of the numbers are those of ``MotionEvidence`` and ``Hypothesis`` in ``engine.samples``.
"""

import math

import numpy as np

from nav_pose_estimator.core.filter import measurements, memory
from nav_pose_estimator.core.filter.error_state import error_between
from nav_pose_estimator.core.filter.kalman import correct, innovation, log_density
from nav_pose_estimator.core.filter.layout import ALT, BASE_STATES, DPOS, DVEL, I_WIND, NAV_SIZE, WIND
from nav_pose_estimator.core.filter.mixture import merge
from nav_pose_estimator.core.numerics.jit import kernel

# --- evidence ------------------------------------------------------------------------------------------------------
INTERVAL, DWELL, CORRELATION, UNMODELLED_VAR = 0, 1, 2, 3
WIND_DECAY = 4  # factor by which the wind's deviation from its mean decays over the interval
WIND_MEAN = 5  # 2: East, North
ATTITUDE, VELOCITY, BODY_VELOCITY, AIR_VELOCITY, EVIDENCE_SIZE = 7, 16, 19, 22, 25

# --- a hypothesis --------------------------------------------------------------------------------------------------
VELOCITY_VAR, VELOCITY_TIME, LOG_LIKELIHOOD, DOUBT_PSD = 0, 1, 2, 3
PLACE_VAR, PLACE_TIME = 4, 5
AIR_NOISE, AIR_CORRECTS, HYPOTHESIS_SIZE = 6, 9, 10

_HAS_LEFT = 9.2  # 99 % quantile of chi-square with two degrees of freedom
_SURPRISING = 4.0  # NIS of a horizontal velocity (expected 2) above which it contradicts a regime
_MOST_ROWS = 7  # of the observations that a hypothesis implies: velocity (2), air velocity (3), place (2)


@kernel
def decide(branches, weights, lost_at, evidence, hypotheses):
    """Apply hypotheses (K, HYPOTHESIS_SIZE) to branches (K, ...) of ``weights`` (K,), and merge the results by
    hypothesis.

    ``lost_at`` (3,): latitude, longitude [rad], height [m] where GNSS was lost; NaN once the vehicle has left that
    area. Returns the likelihoods (K,) of the hypotheses, by which the branches are to be weighted; their sum is zero,
    and the branches are unchanged, where none is possible.
    """
    K, n = len(branches), int(branches[0, memory.STATES])
    constants = branches[0, memory.CONSTANTS : memory.ORIGIN]
    navs, Ps = np.empty((K, K, NAV_SIZE)), np.empty((K, K, n, n))  # hypothesis, branch, ...
    for j in range(K):
        for i in range(K):
            _copy_of(branches[i], evidence, navs[j, i], Ps[j, i])
    joint = _joint_weights(navs, Ps, constants, weights, lost_at, evidence, hypotheses)
    likely = np.zeros(K)
    for j in range(K):
        for i in range(K):
            likely[j] += joint[j, i]
        if likely[j] > 0.0:
            nav, P = merge(navs[j], Ps[j], constants, joint[j] / likely[j])
            for i in range(NAV_SIZE):
                branches[j, memory.NAV + i] = nav[i]
            for i in range(n):
                for k in range(n):
                    branches[j, memory.HEAD + n * i + k] = P[i, k]
    return likely


@kernel
def has_left(branches, lost_at, hypotheses):
    """Whether a branch (K, ...) is significantly farther from ``lost_at`` than flights of its hypothesis usually go."""
    n = int(branches[0, memory.STATES])
    for k in range(len(branches)):
        if hypotheses[k, PLACE_VAR] > 0.0:
            nav = branches[k, memory.NAV : memory.CONSTANTS]
            P = branches[k, memory.HEAD : memory.HEAD + n * n].reshape(n, n)
            z, H = measurements.gnss_position(nav, n, lost_at[0], lost_at[1], nav[ALT], np.zeros(3))
            if innovation(P, z[:2], H[:2], hypotheses[k, PLACE_VAR] * np.eye(2)) > _HAS_LEFT:
                return True
    return False


@kernel
def _copy_of(branch, evidence, nav, P):
    """Copy a branch to ``nav`` and ``P``, with its wind gone back towards the mean."""
    n = len(P)
    for i in range(NAV_SIZE):
        nav[i] = branch[memory.NAV + i]
    for i in range(n):
        for k in range(n):
            P[i, k] = branch[memory.HEAD + n * i + k]
    if evidence[WIND_DECAY] < 1.0:
        for i in range(2):
            mean = evidence[WIND_MEAN + i]
            nav[WIND + i] = mean + evidence[WIND_DECAY] * (nav[WIND + i] - mean)


@kernel
def _joint_weights(navs, Ps, constants, weights, lost_at, evidence, hypotheses):
    """Correct ``navs``, ``Ps`` [j, i] by hypothesis j, following branch i; returns unnormalised weights [j, i].

    Observations within a regime are correlated and tempered; a transition into it counts in full, once. A contradicting
    velocity decorrelates faster than agreement does, so it is tempered less.
    """
    K, interval = len(weights), evidence[INTERVAL]
    middle, _ = merge(navs[0], Ps[0], constants, weights)
    known_to = np.empty(K)
    for i in range(K):
        known_to[i] = 0.5 * (Ps[0, i, DVEL, DVEL] + Ps[0, i, DVEL + 1, DVEL + 1])
    tempered = min(interval / evidence[CORRELATION], 1.0)
    exponent, largest = np.empty((K, K)), -math.inf
    for j in range(K):
        for i in range(K):
            assumed_var = known_to.max() - known_to[i]
            fit = _act(navs[j, i], Ps[j, i], constants, middle, lost_at, assumed_var, evidence, hypotheses[j])
            likelihood, entry, contradiction = fit
            exponent[j, i] = tempered * likelihood
            if i != j:
                exponent[j, i] += (1.0 - tempered) * entry
            if hypotheses[j, VELOCITY_TIME] > 0.0:
                sooner = max(interval / hypotheses[j, VELOCITY_TIME] - tempered, 0.0)
                exponent[j, i] += sooner * contradiction
            if math.isfinite(exponent[j, i]):
                largest = max(largest, exponent[j, i])
    joint = np.zeros((K, K))
    stay = math.exp(-interval / evidence[DWELL]) if K > 1 else 1.0
    for j in range(K):
        for i in range(K):
            if math.isfinite(exponent[j, i]):
                transition = stay if i == j else (1.0 - stay) / (K - 1)
                joint[j, i] = transition * weights[i] * math.exp(exponent[j, i] - largest)
    return joint


@kernel
def _act(nav, P, constants, middle, lost_at, assumed_var, evidence, hypothesis):
    """Correct one branch by a hypothesis; returns how well it fits, as three log likelihoods.

    These are that of all observations, that of a transition into the regime here, and the part of the velocity's NIS
    beyond chance. ``middle``: nominal state of the mixture, to which the evidence refers. A hypothesis corrects its
    branch repeatedly, and the certainty that it creates is no evidence for it. So likelihoods of the velocity use the
    velocity variance of the least certain branch, which is larger by ``assumed_var`` [m^2/s^2]: what the IMU alone
    would know.
    """
    n, interval = len(P), evidence[INTERVAL]
    for i in range(2):
        P[DPOS + i, DPOS + i] += hypothesis[DOUBT_PSD] * interval
    apart = error_between(middle, nav, constants)  # error of the branch relative to the mixture
    seen, used = _nothing(n), _nothing(n)  # observations for the likelihood, and those that correct the branch
    rows = used_rows = 0
    likelihood, entry, contradiction = hypothesis[LOG_LIKELIHOOD], 0.0, 0.0
    variance = hypothesis[VELOCITY_VAR]
    if variance >= 0.0:
        _, H = measurements.horizontal_velocity(nav, n, 0.0, 0.0)
        z = evidence[VELOCITY : VELOCITY + 2] + apart[DVEL : DVEL + 2]
        rows = _add(seen, rows, z, H, np.full(2, variance + assumed_var))
        entry = -0.5 * innovation(P, z, H, (variance + evidence[UNMODELLED_VAR]) * np.eye(2))
        contradiction = -0.5 * max(innovation(P, z, H, variance * np.eye(2)) - _SURPRISING, 0.0)
        if hypothesis[VELOCITY_TIME] > 0.0:
            # the prior on a correlated velocity discriminates at once, but its correction is spread over its time
            draws = hypothesis[VELOCITY_TIME] / interval
            used_rows = _add(used, used_rows, z, H, np.full(2, variance * draws))
    if math.isfinite(evidence[AIR_VELOCITY]) and hypothesis[AIR_NOISE] >= 0.0:
        z, H = _air_velocity(nav, constants, apart, evidence)
        noise = hypothesis[AIR_NOISE : AIR_NOISE + 3]
        rows = _add(seen, rows, z, H, noise)
        if hypothesis[AIR_CORRECTS] > 0.0:
            used_rows = _add(used, used_rows, z, H, noise)
    if hypothesis[PLACE_VAR] > 0.0 and math.isfinite(lost_at[0]):
        z, H = measurements.gnss_position(nav, n, lost_at[0], lost_at[1], nav[ALT], np.zeros(3))
        draws = hypothesis[PLACE_TIME] / interval
        used_rows = _add(used, used_rows, z[:2], H[:2], np.full(2, hypothesis[PLACE_VAR] * draws))
    if rows:
        likelihood += log_density(P, seen[0][:rows], seen[1][:rows], _diagonal(seen, rows))
    if used_rows:
        nis = correct(nav, P, constants, used[0][:used_rows], used[1][:used_rows], _diagonal(used, used_rows))
        if not math.isfinite(nis):
            return -math.inf, -math.inf, 0.0
    return likelihood, entry, contradiction


@kernel
def _air_velocity(nav, constants, apart, evidence):
    """(z, H) of the predicted air velocity for a branch with the error ``apart`` (n,) relative to the mixture."""
    means = evidence[ATTITUDE:VELOCITY].reshape(3, 3), evidence[VELOCITY:BODY_VELOCITY]
    body_velocity, air = evidence[BODY_VELOCITY:AIR_VELOCITY], evidence[AIR_VELOCITY:EVIDENCE_SIZE]
    wind = int(constants[I_WIND])
    z, H = measurements.mean_air_velocity(nav, len(apart), wind, means[0], means[1], body_velocity, air)
    for i in range(3):
        for k in range(BASE_STATES):  # the wind is that of the branch already
            z[i] += H[i, k] * apart[k]
    return z, H


@kernel
def _nothing(states):
    """Room for observations: z, H and variances."""
    return np.empty(_MOST_ROWS), np.empty((_MOST_ROWS, states)), np.empty(_MOST_ROWS)


@kernel
def _add(observations, rows, z, H, variances):
    """Append an independent observation to the first ``rows``; returns the new number of rows."""
    for i in range(len(z)):
        observations[0][rows + i] = z[i]
        observations[2][rows + i] = variances[i]
        for k in range(H.shape[1]):
            observations[1][rows + i, k] = H[i, k]
    return rows + len(z)


@kernel
def _diagonal(observations, rows):
    """Noise covariance (rows, rows)."""
    R = np.zeros((rows, rows))
    for i in range(rows):
        R[i, i] = observations[2][i]
    return R
