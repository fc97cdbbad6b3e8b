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
from typing import NamedTuple

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import measurements, memory
from nav_pose_estimator.core.filter.blocks import GYRO_MATRIX, WIND, with_block
from nav_pose_estimator.core.filter.error_state import error_between
from nav_pose_estimator.core.filter.kalman import correct, innovation, log_density
from nav_pose_estimator.core.filter.mixture import blend_rows, merge
from nav_pose_estimator.engine.samples import Hypothesis, MotionEvidence

_LEAST_WEIGHT = 1e-4  # smallest probability of a hypothesis, so that it can recover
_REMEMBERED = 10.0  # s: the longest memory of checkpoints
_DRIVING_NOISE = np.r_[at.GYRO_NOISE_PSD, at.ACCEL_NOISE_PSD, at.GYRO_BIAS_PSD, at.ACCEL_BIAS_PSD, GYRO_MATRIX.psd]
_POSITION, _PLACE = slice(at.DPOS, at.DPOS + 3), slice(at.DPOS, at.DPOS + 2)
_VELOCITY = slice(at.DVEL, at.DVEL + 2)
_HAS_LEFT = 9.2  # 99 % quantile of chi-square with two degrees of freedom
_SURPRISING = 4.0  # NIS of a horizontal velocity (expected 2) above which it contradicts a regime


class _Fit(NamedTuple):
    """How well a hypothesis fits a branch, as log likelihoods: of all observations, of a transition into its regime
    here, and of the part of the velocity's NIS that is beyond chance."""

    likelihood: float
    entry: float
    contradiction: float


_IMPOSSIBLE = _Fit(-math.inf, -math.inf, 0.0)


class _Situation(NamedTuple):
    """The context of a branch. ``middle``: nominal state of the mixture, to which the evidence refers. ``lost_at``
    (3,): where GNSS was lost, None once the vehicle has left that area. ``assumed_var`` [m^2/s^2]: by how much the
    branch's velocity variance is below that of the least certain branch."""

    middle: np.ndarray
    lost_at: np.ndarray | None
    assumed_var: float


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
        self.memories = np.tile(branch, (len(evidence.hypotheses), 1))
        self.weights = np.array([h.probability for h in evidence.hypotheses])
        self.names = tuple(h.name for h in evidence.hypotheses)
        self._decisions = [(-math.inf, self.weights)]  # (time, weights from then on), as far back as checkpoints

    def probability(self, name: str) -> float:
        """Probability of the hypothesis ``name``."""
        return float(self.weights[self.names.index(name)])

    def pairs(self) -> list[tuple[np.ndarray, np.ndarray]]:
        """Nominal state and covariance of each branch, as views into its memory."""
        return [(_nav(one), _covariance(one)) for one in self.memories]

    @property
    def constants(self) -> np.ndarray:
        """Filter constants, the same for all branches."""
        return self.memories[0, memory.CONSTANTS : memory.ORIGIN]

    def run(self, rows: np.ndarray, begin: int, end: int, due: float, out: np.ndarray) -> int:
        """``memory.run_block`` for each branch; ``out`` receives the solution of the mixture."""
        own = np.empty((len(self.memories), *out.shape))
        for one, own_rows in zip(self.memories, own, strict=True):
            stop = memory.run_block(one, rows, begin, end, due, own_rows)
        first = len(out) - end
        blend_rows(own, self.weights, first + begin, first + stop, out)
        return stop

    def restore_before(self, t: float) -> float:
        """Restore the last checkpoint before ``t`` [s]; returns its time."""
        for one in self.memories:
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

    def _stacked(self) -> tuple[np.ndarray, np.ndarray]:
        n = int(self.memories[0, memory.STATES])
        Ps = self.memories[:, memory.HEAD : memory.HEAD + n * n].reshape(-1, n, n)
        return self.memories[:, memory.NAV : memory.CONSTANTS].copy(), Ps.copy()

    def decide(self, evidence: MotionEvidence) -> None:
        """Apply each hypothesis to each branch, weight the results by their likelihoods, and merge by hypothesis.

        A vehicle that travels at 7 m/s cannot hover the next moment. So the likelihood of a hypothesis is evaluated on
        each branch that it may follow, not on their mixture, whose covariance allows both.
        """
        navs, Ps = self._stacked()
        count = len(navs)
        # hypothesis, branch, ...
        after_navs, after_Ps = (np.broadcast_to(one, (count, *one.shape)).copy() for one in (navs, Ps))
        if not self._wind_is_measured:
            _relax_wind(after_navs, evidence)
        before = float(navs[0, at.TIME])
        if self._left > before and self._leaves(evidence):
            self._left = before
        self._ended = [
            ended if likely > 0.5 else min(ended, before)
            for ended, likely in zip(self._ended, self.weights, strict=True)
        ]
        joint = self._joint_weights(after_navs, after_Ps, evidence)
        if not joint.any():
            return
        weights = joint.sum(axis=1)
        for j, (nav, P) in enumerate(self.pairs()):
            if weights[j] > 0.0:
                nav[:], P[:] = merge(after_navs[j], after_Ps[j], self.constants, joint[j] / weights[j])
        weights = np.maximum(weights / weights.sum(), _LEAST_WEIGHT)
        self.weights = weights / weights.sum()
        now = float(navs[0, at.TIME])
        self._decisions = [*(d for d in self._decisions if d[0] >= now - _REMEMBERED), (now, self.weights)]

    def _leaves(self, evidence: MotionEvidence) -> bool:
        """Whether a branch is significantly farther from where GNSS was lost than its flight usually goes.

        From then on the prior on the place is dropped: on a straight flight, the growing drift would otherwise soon
        make it consistent again and pull the vehicle back.
        """
        for hypothesis, (nav, P) in zip(evidence.hypotheses, self.pairs(), strict=True):
            if hypothesis.place_var is not None:
                z, H, variances = _usual_place(nav, P, self._lost_at, hypothesis.place_var)
                if innovation(P, z, H, np.diag(variances)) > _HAS_LEFT:
                    return True
        return False

    def _joint_weights(self, navs: np.ndarray, Ps: np.ndarray, evidence: MotionEvidence) -> np.ndarray:
        """Correct ``navs``, ``Ps`` [j, i] by hypothesis j, following branch i; returns unnormalised weights [j, i]."""
        count = len(navs)
        middle, _ = merge(navs[0], Ps[0], self.constants, self.weights)
        stay = math.exp(-evidence.interval / evidence.dwell) if count > 1 else 1.0
        transition = np.full((count, count), (1.0 - stay) / max(count - 1, 1))
        np.fill_diagonal(transition, stay)
        tempered = min(evidence.interval / evidence.correlation, 1.0)
        known_to = 0.5 * np.trace(Ps[0][:, _VELOCITY, _VELOCITY], axis1=1, axis2=2)
        lost_at = self._lost_at if math.isinf(self._left) else None
        exponent = np.empty((count, count))
        for j, hypothesis in enumerate(evidence.hypotheses):
            if hypothesis.lasting is not None and math.isinf(self._ended[j]):
                hypothesis = hypothesis.lasting
            for i in range(count):
                situation = _Situation(middle, lost_at, float(known_to.max() - known_to[i]))
                fit = _act(navs[j, i], Ps[j, i], self.constants, situation, evidence, hypothesis)
                # observations within a regime are correlated and tempered; a transition into it counts in full, once
                exponent[j, i] = tempered * fit.likelihood + (i != j) * (1.0 - tempered) * fit.entry
                if hypothesis.velocity_time is not None:
                    # a contradicting velocity decorrelates faster than agreement does, so it is tempered less
                    sooner = max(evidence.interval / hypothesis.velocity_time - tempered, 0.0)
                    exponent[j, i] += sooner * fit.contradiction
        known = np.isfinite(exponent)
        if not known.any():
            return np.zeros((count, count))
        likely = np.exp(np.where(known, exponent, -np.inf) - exponent[known].max())
        return np.asarray(transition * self.weights * likely)  # the transition is symmetric


def _relax_wind(navs: np.ndarray, evidence: MotionEvidence) -> None:
    """The wind of branches (..., NAV_SIZE) goes back to its mean."""
    mean, wind = np.array(evidence.wind_mean), navs[..., WIND.estimates]
    wind[:] = mean + math.exp(-evidence.interval / evidence.wind_tau) * (wind - mean)


def _act(
    nav: np.ndarray,
    P: np.ndarray,
    constants: np.ndarray,
    situation: _Situation,
    evidence: MotionEvidence,
    hypothesis: Hypothesis,
) -> _Fit:
    """Correct one branch by a hypothesis; returns how well it fits.

    A hypothesis corrects its branch repeatedly, and the certainty that it creates is no evidence for it. So likelihoods
    of the velocity use the velocity variance of the least certain branch, which is what the IMU alone would know.
    """
    n, (middle, lost_at, assumed_var) = len(P), situation
    P[_PLACE, _PLACE] += hypothesis.doubt_psd * evidence.interval * np.eye(2)
    apart = error_between(middle, nav, constants)  # error of the branch relative to the mixture
    seen, used = [], []  # (z, H, variances): observations for the likelihood, and those that correct the branch
    likelihood, entry, contradiction = hypothesis.log_likelihood, 0.0, 0.0
    if hypothesis.velocity_var is not None:
        _, H = measurements.horizontal_velocity(nav, n, 0.0, 0.0)
        z, variances = np.array(evidence.velocity[:2]) + H @ apart, np.full(2, hypothesis.velocity_var)
        seen.append((z, H, variances + assumed_var))
        entry = -0.5 * innovation(P, z, H, np.diag(variances + evidence.unmodelled_var))
        contradiction = -0.5 * max(innovation(P, z, H, np.diag(variances)) - _SURPRISING, 0.0)
        if hypothesis.velocity_time is not None:
            # the prior on a correlated velocity discriminates at once, but its correction is spread over its time
            used.append((z, H, variances * hypothesis.velocity_time / evidence.interval))
    if evidence.air_velocity is not None and hypothesis.air_noise is not None:
        means = evidence.attitude, np.array(evidence.velocity), np.array(evidence.body_velocity)
        air_velocity = np.array(evidence.air_velocity)
        z, H = measurements.mean_air_velocity(nav, n, WIND.states(constants).start, *means, air_velocity)
        base = slice(at.BASE_STATES)  # the wind is that of the branch already
        air = z + H[:, base] @ apart[base], H, np.array(hypothesis.air_noise)
        seen.append(air)
        if hypothesis.air_corrects:
            used.append(air)
    if hypothesis.place_var is not None and lost_at is not None:
        used.append(_usual_place(nav, P, lost_at, hypothesis.place_var, hypothesis.place_time / evidence.interval))
    if seen:
        likelihood += log_density(P, *_as_one(seen))
    if used and not math.isfinite(correct(nav, P, constants, *_as_one(used))):
        return _IMPOSSIBLE
    return _Fit(likelihood, entry, contradiction)


def _usual_place(
    nav: np.ndarray, P: np.ndarray, lost_at: np.ndarray, var: float, draws: float = 1.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(z, H, variances) of the prior that flights are local: the vehicle is not far from ``lost_at``.

    ``var`` [m^2]: variance of each horizontal component; ``draws``: number of epochs that make one independent draw.
    """
    z, H = measurements.gnss_position(nav, len(P), lost_at[0], lost_at[1], nav[at.ALT], np.zeros(3))
    return z[:2], np.ascontiguousarray(H[:2]), np.full(2, var * draws)


def _as_one(observations: list[tuple[np.ndarray, np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Independent observations (z, H, variances) as one: z, H, R."""
    z, H, variances = observations[0]
    if len(observations) > 1:
        z, H, variances = (np.concatenate(parts) for parts in zip(*observations, strict=True))
    return z, H, np.diag(variances)


def _nav(branch: np.ndarray) -> np.ndarray:
    return branch[memory.NAV : memory.CONSTANTS]


def _covariance(branch: np.ndarray) -> np.ndarray:
    n = int(branch[memory.STATES])
    return branch[memory.HEAD : memory.HEAD + n * n].reshape(n, n)
